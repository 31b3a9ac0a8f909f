# SPDX-License-Identifier: GPL-3.0-or-later
"""Warp kernels and the functions they share: everything that runs on the device. Imports only warp."""

from .registration import skip_references

skip_references()
