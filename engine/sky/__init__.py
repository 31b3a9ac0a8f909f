# SPDX-License-Identifier: GPL-3.0-or-later
"""Skies of the Sky Texture node as images of directions, computed on the host with NumPy."""
