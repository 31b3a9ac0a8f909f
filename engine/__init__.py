# SPDX-License-Identifier: GPL-3.0-or-later
"""The renderer without Blender: usable from a script or a test.

Submodules are imported by name (`from burnish.engine.session import Session`); importing this package loads neither
Warp nor NumPy.
"""
