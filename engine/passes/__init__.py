# SPDX-License-Identifier: GPL-3.0-or-later
"""Render passes: each owns its buffers and says how it runs on the device."""
