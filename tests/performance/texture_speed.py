# SPDX-License-Identifier: GPL-3.0-or-later
"""Time texture lookups: Burnish's flat arrays against Warp's hardware textures (wp.Texture2D). Run by hand.

    python tests/performance/texture_speed.py [--device cuda:0] [--count 4194304] [--textures 16] [--size 2048]

Prints nanoseconds for each lookup (time of the launch by number of lookups) for texture coordinates in scan order and
at random, each with a random texture of several, on level 0 and between levels. The two give almost the same values,
not the same: see kernels/texture.py for what hardware textures can't do.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import warp as wp

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
import conftest  # noqa: E402, F401  (makes `burnish` this checkout)
from burnish.engine.texels import make_texels  # noqa: E402
from burnish.engine.texture_arrays import TextureArrays  # noqa: E402
from burnish.kernels import texture  # noqa: E402
from burnish.kernels.types import Textures  # noqa: E402

wp.set_module_options({"enable_backward": False, "default_grid_stride": False})


@wp.kernel
def sample_flat(
    # In:
    textures: Textures, indices: wp.array[int], uv: wp.array[wp.vec2], width: float,
    # Out:
    rgba_out: wp.array[wp.vec4],
):
    """Look up through flat arrays, sRGB decoding included."""
    i = wp.tid()
    rgba_out[i] = texture.sample_texture(textures, indices[i], uv[i], width, texture.EXTENSION_REPEAT,
                                         texture.INTERPOLATION_LINEAR)


@wp.kernel
def sample_hardware(
    # In:
    textures: wp.array[wp.Texture2D], indices: wp.array[int], uv: wp.array[wp.vec2], lod: float,
    # Out:
    rgba_out: wp.array[wp.vec4],
):
    """Look up through hardware textures, sRGB decoding included."""
    i = wp.tid()
    at = wp.vec2(uv[i][0], 1.0 - uv[i][1])
    c = wp.texture_sample(textures[indices[i]], at, dtype=wp.vec4, lod=lod)
    rgba_out[i] = wp.vec4(texture.srgb_to_linear(c[0]), texture.srgb_to_linear(c[1]), texture.srgb_to_linear(c[2]),
                          c[3])


def nanoseconds(launch: Callable[[], None], count: int, device: str) -> float:
    """Return the best of five launches, after one that builds and warms up."""
    launch()
    times = []
    for _ in range(5):
        with wp.ScopedTimer("", print=False, synchronize=True) as timer:
            launch()
            wp.synchronize_device(device)
        times.append(timer.elapsed * 1e6 / count)
    return min(times)


def main() -> None:
    """Print one line for each way of looking up."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--device", default="cuda:0" if wp.is_cuda_available() else "cpu")
    parser.add_argument("--count", type=int, default=1 << 22)
    parser.add_argument("--textures", type=int, default=16)
    parser.add_argument("--size", type=int, default=2048)
    options = parser.parse_args()
    device, count, size, rng = options.device, options.count, options.size, np.random.default_rng(0)

    images = [rng.integers(0, 256, (size, size, 4), np.uint8) for _ in range(options.textures)]
    for image in images:
        image[..., 3] = 255
    arrays = TextureArrays(device)
    arrays.change({i: make_texels(image, srgb=True, alpha=0) for i, image in enumerate(images)})
    kept = [wp.Texture2D(image, address_mode=wp.TextureAddressMode.WRAP, num_mip_levels=0, device=device)
            for image in images]
    hardware = wp.array(kept, dtype=wp.Texture2D, device=device)
    result = wp.zeros(count, dtype=wp.vec4, device=device)

    side = int(np.sqrt(count))
    y, x = np.divmod(np.arange(count), side)
    scan = np.stack([(x + 0.5) / side, (y + 0.5) / side], axis=-1).astype(np.float32)
    orders = {"scan order": (scan, np.zeros(count, np.int32)),
              "random": (rng.random((count, 2), np.float32), rng.integers(0, options.textures, count, np.int32))}
    print(f"{wp.get_device(device).name}: {count} lookups, {options.textures} textures of {size} x {size}, 8-bit sRGB")
    for order, (coordinates, chosen) in orders.items():
        uv = wp.array(coordinates, dtype=wp.vec2, device=device)
        indices = wp.array(chosen, dtype=int, device=device)
        for label, lod in (("level 0", 0.0), ("level 3.5", 3.5)):
            width = 2.0**lod / size if lod > 0.0 else 0.0
            found = []
            for way, kernel, inputs in (("flat arrays", sample_flat, [arrays.struct(), indices, uv, width]),
                                        ("wp.Texture2D", sample_hardware, [hardware, indices, uv, lod])):
                time = nanoseconds(lambda kernel=kernel, inputs=inputs: wp.launch(
                    kernel, count, inputs=inputs, outputs=[result], device=device), count, device)
                found.append(result.numpy().copy())
                print(f"{order:10} {label:9} {way:12} {time:8.3f} ns a lookup")
            print(f"{order:10} {label:9} mean difference {np.abs(found[0] - found[1]).mean():.5f}")


if __name__ == "__main__":
    main()
