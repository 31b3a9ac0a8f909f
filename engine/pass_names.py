# SPDX-License-Identifier: GPL-3.0-or-later
"""Names of passes of the first surfaces (passes/first_hits.py), of light groups and of shadow catchers.

Without Warp, for registration.
"""

from __future__ import annotations

__all__ = [
    "COLOR_AOV", "FIRST_HIT_PASSES", "GROUP_PREFIX", "MATTE_KINDS", "OCCLUSION", "SHADOW", "SHADOW_CATCHER",
    "VALUE_AOV", "first_hit_channels"]

COLOR_AOV, VALUE_AOV = "Color AOV ", "Value AOV "
"""What the engine's names of shader AOVs begin with"""

GROUP_PREFIX = "Combined_"
"""Before a light group's name in that of its pass, as in Cycles"""

MATTE_KINDS = ("CryptoObject", "CryptoMaterial", "CryptoAsset")
"""What the names of Cryptomatte's passes begin with: `CryptoObject00` and so on"""

OCCLUSION, SHADOW = "Ambient Occlusion", "Shadow"

SHADOW_CATCHER = "Shadow Catcher"
"""What backgrounds are multiplied by; Combined has no shadow of its own then, as in Cycles"""

LEVELS_MAX = 16
"""Things that a pixel of Cryptomatte can hold, two in each pass"""

FIRST_HIT_PASSES = {
    "Mist": 1, "Vector": 4, OCCLUSION: 3, SHADOW: 3,
    **{f"{kind}{number:02d}": 4 for kind in MATTE_KINDS for number in range(LEVELS_MAX // 2)}}
"""Channels of each pass of the first surfaces but shader AOVs"""


def first_hit_channels(name: str) -> int:
    """Return the channels of a pass of the first surfaces, 0 for any other."""
    if name.startswith((COLOR_AOV, VALUE_AOV)):
        return 4 if name.startswith(COLOR_AOV) else 1
    return FIRST_HIT_PASSES.get(name, 0)
