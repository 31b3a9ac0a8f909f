# SPDX-License-Identifier: GPL-3.0-or-later
"""All settings, declared once: names, defaults, ranges and help.

Blender properties, panels, the command line, the table of docs/settings.md and the tests are made from these
dataclasses; nothing else in the package repeats a default or a range. Knows nothing of Blender.
"""

from __future__ import annotations

from dataclasses import Field, dataclass, field, fields
from typing import Any

from .choices import CacheKey, Device, Integrator, PixelFilter, Preset, ReflectionResolution
from .debug_views import DEBUG_VIEWS

__all__ = [
    "CacheKey", "CacheSettings", "DebugSettings", "DenoiserSettings", "Device", "DirectLightSettings",
    "FilmSettings", "Integrator", "PixelFilter", "Preset", "ProbeSettings", "ReflectionResolution",
    "ReflectionSettings", "RenderSettings", "SamplingSettings", "LightPathSettings", "PerformanceSettings",
    "FRAME_GROUPS", "setting_info"]

FRAME_GROUPS = ("light_paths", "film", "probes", "cache", "direct_light", "reflections", "denoiser")
"""Groups of RenderSettings all of which decide what frames look like"""


def setting(default: Any, help: str, *, low: Any = None, high: Any = None, soft_high: Any = None, unit: str = "",
            label: str = "", choices: dict[str, str] | None = None) -> Any:
    """Declare one setting: help, hard range, soft upper limit, unit, label; `choices` of a text with their help."""
    info = {"help": help, "low": low, "high": high, "soft_high": soft_high, "unit": unit, "label": label,
            "choices": choices}
    return field(default=default, metadata=info)


def setting_info(settings_class: type) -> dict[str, Field]:
    """Return the dataclass fields of a settings class by name (each with `metadata` as `setting` made it)."""
    return {f.name: f for f in fields(settings_class)}


@dataclass(frozen=True, kw_only=True)
class SamplingSettings:
    """How many samples, and with which random numbers."""

    integrator: Integrator = setting(Integrator.REALTIME, "How the picture is made, in viewports and final renders")
    samples: int = setting(
        128, "Samples per pixel of a final render; frames with the realtime integrator", low=1, high=1 << 24,
        soft_high=4096)
    viewport_samples: int = setting(
        1024, "Samples per pixel, or frames, after which a viewport in which nothing moves rests (0: never)", low=0,
        high=1 << 24, soft_high=4096)
    viewport_denoise: bool = setting(
        True, "Denoise path-traced samples of real-time viewports at rest by Blender's Open Image Denoise")
    viewport_preset: Preset = setting(
        Preset.CUSTOM, "Preset of viewports with the realtime integrator, instead of the settings of the final render")
    time_limit: float = setting(0.0, "Stop a final render after this time (0: no limit)", low=0.0, high=1e9,
                                soft_high=3600.0, unit="s")
    motion_steps: int = setting(
        32, "Most moments that a final render with motion blur averages: fast motion shows as many pictures side by "
        "side where there are few. Each costs an evaluation of the scene, and of what moves the update", low=1,
        high=1024, soft_high=256)
    seed: int = setting(0, "Seed of the random numbers: the same seed gives the same picture", low=0, high=2**31 - 1)


@dataclass(frozen=True, kw_only=True)
class LightPathSettings:
    """How long light is followed and what is clamped."""

    max_bounces: int = setting(
        0, "Most surfaces that a light path may meet before it ends (0: unlimited, ended by Russian roulette; "
        "Cycles' Max Bounces counts one fewer)", low=0, high=1024, soft_high=64)
    roulette_start: int = setting(
        1, "Bounce from which Russian roulette may end a path; it never biases the picture", low=1, high=1024,
        soft_high=32)
    clamp_direct: float = setting(
        0.0, "Clamp each sample of directly seen or directly reflected light (0: off); darkens, but tames noise",
        low=0.0, high=1e9, soft_high=100.0)
    clamp_indirect: float = setting(
        0.0, "Clamp each sample of indirect light (0: off); darkens, but tames noise", low=0.0, high=1e9,
        soft_high=100.0)


@dataclass(frozen=True, kw_only=True)
class FilmSettings:
    """How samples become pixels."""

    exposure: float = setting(1.0, "Factor on all light reaching the film", low=0.0, high=1e6, soft_high=10.0)
    pixel_filter: PixelFilter = setting(PixelFilter.BLACKMAN_HARRIS, "Reconstruction filter of the pixels")
    filter_width: float = setting(
        1.5, "Width of the pixel filter, as in Cycles: samples come from up to this far to each side", low=0.01,
        high=10.0, unit="px")
    transparent: bool = setting(False, "Make the world transparent, for compositing over another picture")


@dataclass(frozen=True, kw_only=True)
class PerformanceSettings:
    """What the machine may spend."""

    texture_budget: int = setting(
        4096, "Memory for textures; above it the largest are halved and named in the report", low=16, high=1 << 20,
        soft_high=65536, unit="MiB")
    texture_size_limit: int = setting(
        0, "Longest side of a texture (0: as in the file)", low=0, high=65536, soft_high=8192, unit="px")
    viewport_pixel_size: int = setting(
        0, "Screen pixels per rendered pixel while navigating (0: chosen from the measured speed)", low=0, high=16)
    frame_time: float = setting(
        0.05, "Time aimed at for one viewport picture while navigating", low=0.005, high=1.0, unit="s")
    instancing_threshold: float = setting(
        4.0, "Flatten all instances into one structure while that multiplies the unique triangles by less than this",
        low=1.0, high=1e6, soft_high=64.0)
    opacity_maps: bool = setting(
        True, "Let rays tell by themselves where leaves and grilles that an image cuts out are clear or solid, and how "
        "much half transparent things let through, instead of asking their materials: faster, for some memory. Off: "
        "ask at every hit")
    deterministic: bool = setting(
        False, "Deal the cache's cells by their keys on CUDA, where threads otherwise race for them, so that a full "
        "cache does not differ from run to run: costs half a millisecond a frame. On the processor nothing races")


@dataclass(frozen=True, kw_only=True)
class ProbeSettings:
    """Screen probes: where diffuse light from all around is gathered (GI-1.0, section 3)."""

    spawn_tile: int = setting(
        16, "One probe of 64 rays for each square of so many pixels a frame: half of it costs four times the rays and "
        "brings finer, less noisy indirect light", low=8, high=64, unit="px")
    guiding: bool = setting(
        True, "Send half of the rays where light came from before: less noise from small or distant light, at little "
        "cost")
    persistence: bool = setting(
        True, "Keep probes that leave the picture until they come back: less noise in turning views, for memory alone")
    filtering: bool = setting(
        True, "Smooth neighbouring probes where they see the same points: less noise for little time, softer indirect "
        "shadows")
    specular_rays: bool = setting(
        True, "Send some of the rays into the reflection, so that the cache has cells where reflections look: slightly "
        "more noise in diffuse light")
    update_interval: int = setting(
        4, "A probe that may wait is updated in one of so many frames while something moves, and at least in every "
        "other in pictures of up to a million pixels: 4 takes a ninth of the time off 1080p frames, for up to 1.5 % "
        "more error", low=1, high=4, unit="frames")
    half_rate: bool = setting(True, "While only the camera moves, take light from the probes for half of the pixels "
        "that know theirs, in pictures of more than a million pixels: faster, with light a frame older")
    dense_small: bool = setting(
        True, "Give pictures of 240x135 to 960x540 pixels as many rays as a 1080p frame has, on a GPU, which they "
        "leave idle otherwise: twice as many probes along each side, a reflection ray for each pixel and finer cells, "
        "less noise and sharper light for about a millisecond a frame")
    contact_detail: bool = setting(
        False, "Find indirect light and shadow between probes from nearby pixels: slightly finer corners and contacts "
        "for a search around every pixel, the dearest pass of all")
    energy_exact: bool = setting(
        True, "Weigh all directions by their solid angle, so that no light is lost or made. Off: the published "
        "estimator, for study; as fast")
    history: int = setting(
        32, "Most frames that a probe averages over while something moves: more has less noise and follows changes of "
        "light more slowly, at no cost", low=1, high=1024, unit="frames")


@dataclass(frozen=True, kw_only=True)
class CacheSettings:
    """The hash-grid radiance cache: light at points that rays hit (GI-1.0, section 4)."""

    cell_pixels: float = setting(
        32.0, "Size of a cell as seen on a screen of 1080 lines (by the root of the lines on others): smaller cells "
        "show finer shadows in indirect light, with more noise and more cells to keep", low=1.0, high=256.0,
        soft_high=64.0, unit="px")
    minimum_cell: float = setting(
        0.0, "Smallest cell (0: 1/500 of the scene's diagonal, at most 0.1 m): keeps views from near by from filling "
        "the cache", low=0.0, high=1e6, soft_high=1.0, unit="m")
    refine: bool = setting(
        True, "Halve the cells' width in pictures of up to a million pixels once rays have met them for some frames: "
        "finer indirect light, from the same rays and more cells")
    capacity: int = setting(
        20, "Room for two to the power of this many cells: one more doubles the memory; too few make indirect light "
        "noisy, never dark", low=10, high=26)
    bounces: int = setting(
        0, "Bounces of light through the cache (0: all of them): as fast, darker interiors with fewer", low=0, high=64)
    bounce_share: float = setting(
        0.3, "Share of the hits from which light is followed further each frame, once it has spread (before: all of "
        "them): costs rays; less makes indirect light noisier", low=0.0, high=1.0)
    sample_cap: int = setting(
        64, "Most samples that a cell averages over while something moves (the paper: 16): more has less noise and "
        "follows changes of light more slowly, at no cost", low=1, high=65536)
    lifetime: int = setting(
        50, "Frames after which a cell that no ray meets is freed: longer keeps light that comes back into view, for "
        "memory", low=2, high=100000, unit="frames")
    key: CacheKey = setting(CacheKey.NORMAL, "What tells cells apart; as fast either way")
    scan_all: bool = setting(
        True, "Search the whole bucket. Off: stop at the first hole, as published, and lose cells behind it; slightly "
        "faster")
    level_blend: bool = setting(
        True, "Blend adjacent levels of detail, so that nothing pops in motion, for slightly more cells")
    cone_test: bool = setting(
        True, "Shade hits closer than a cell themselves: sharp contacts and no leaks, for more noise there")
    follow_mirrors: bool = setting(
        True, "Let light come over mirrors and polished metal as they reflect it, for some time where there are any. "
        "Off: they throw it back on all sides until path tracing takes over")
    highlights: bool = setting(
        True, "Let light of lamps, suns and skies come over glossy surfaces as they reflect it, for little time. Off: "
        "they throw it back on all sides, and what they shine at is dark")
    follow_shadows: bool = setting(
        True, "Let cells and probes forget sooner where light passes what has moved of late, at no cost while nothing "
        "does: its shadow in mirrors and in indirect light goes along, with some noise. Off: it lags by tens of frames")
    ends_paths: bool = setting(
        True, "Let path-traced samples end in the cache after two bounces: less noise in the same time. From the 64th "
        "on ever fewer do, so that the limit stays path tracing's. None do where bounces are limited to fewer than 24")


@dataclass(frozen=True, kw_only=True)
class DirectLightSettings:
    """Direct light at visible surfaces by resampled importance sampling (Bitterli et al. 2020)."""

    candidates: int = setting(
        8, "Lights considered for each pixel before one shadow ray is sent: more find the brightest of many lights, "
        "each for some time", low=1, high=64, soft_high=16)
    temporal_reuse: int = setting(
        0, "Frames' worth of candidates taken over from the frame before, if a scene has more lights than that: less "
        "noise in one frame for some time, but noise that moves in patches: 0 is nearer to the truth", low=0, high=64)
    half_rate: bool = setting(True, "Trace every other pixel's shadow ray while something moves, in pictures of more "
        "than a million pixels: half of them, softer shadows in motion and more noise")
    quarter_rate: bool = setting(True, "While only the camera moves, leave half of those out where the light is known "
        "and highlights are weak: faster, with light up to twice as old")
    clear_glass: bool = setting(
        True, "Let light go on behind clear glass in straight lines: lights what is behind windows and in cases, for "
        "some time where there is glass. Off: glass casts full shadows until path tracing takes over")


@dataclass(frozen=True, kw_only=True)
class ReflectionSettings:
    """Glossy reflections and refraction: how each roughness is found (Eto et al. 2023, section 2)."""

    roughness_traced: float = setting(
        0.5, "Roughness up to which reflections are traced with rays; the paper's r_rt. Rougher ones are looked up in "
        "the probes: higher is sharper and more exact, for more rays", low=0.0, high=1.0)
    roughness_weak: float = setting(
        0.25, "Roughness up to which weak reflections are traced with rays, such as of wood and plastic seen from "
        "above: higher is sharper, for many rays that add little to the picture", low=0.0, high=1.0)
    roughness_diffuse: float = setting(
        0.6, "Roughness from which diffuse light stands in for reflections; the paper's r_diffuse. Lower saves time "
        "on rough surfaces and blurs them more", low=0.0, high=1.0)
    roughness_blend: float = setting(
        0.1, "Range of roughness over which look-ups take over from rays, and half of that over which diffuse light "
        "takes over from both: hides their borders; costs rays", low=0.0, high=0.5)
    resolution: ReflectionResolution = setting(
        ReflectionResolution.HALF, "Pixels that share a ray in each frame, in turns: fewer are sharper in motion and "
        "cost rays")
    bounces: int = setting(
        4, "Mirrors and panes of glass that a ray follows before the radiance cache answers, from two on three times "
        "as many in smooth glass: each shows mirrors in mirrors one deeper, and costs time only where there are some",
        low=0, high=32, soft_high=16)
    half_rate: bool = setting(True, "While only the camera moves, trace rays for half of the pixels whose reflection "
        "is known, rough and even, in pictures of more than a million pixels: faster, with slightly more noise")
    screen_reuse: bool = setting(
        True, "Take what the picture before shows at a ray's hit, where it shows it: less noise and fewer shadow rays, "
        "for a frame's delay")
    hit_lighting: bool = setting(
        True, "Light the hits of sharp reflections themselves and make cells there. Off: only look into the radiance "
        "cache, as published: faster, blotched, black where the cache knows nothing")
    subsurface: bool = setting(
        True, "Scatter light below surfaces, such as skin and wax, by the profile of Christensen and Burley: for a ray "
        "and a light sample where there are some. Off: they are matte until path tracing takes over")
    hair: bool = setting(
        True, "Follow light through hair over several strands, by the lobes of the Principled Hair BSDF. Off: strands "
        "are surfaces of their color until path tracing takes over, cheaper, and light does not shine through them")
    jitter: bool = setting(
        True, "Jitter look-ups in the cache and the last filter where roughness varies: hides the borders of cells and "
        "blocks, for slightly more noise")


@dataclass(frozen=True, kw_only=True)
class DenoiserSettings:
    """Filters of direct, diffuse and reflected light, and anti-aliasing."""

    direct_iterations: int = setting(
        3, "Passes of the edge-stopping filter on direct light while it is new and from wide lamps, one after that "
        "(0: none): each doubles its reach, for less noise, blurred shadows and some time", low=0, high=6)
    direct_history: int = setting(
        16, "Most frames averaged in direct light while something moves: more has less noise and shadows that lag "
        "more, at no cost", low=1, high=1024, unit="frames")
    diffuse_history: int = setting(
        64, "Most frames averaged in indirect light while something moves: more has less noise and lags more, at no "
        "cost", low=1, high=1024, unit="frames")
    diffuse_radius: int = setting(
        8, "Largest blur of indirect light, where there is no history: less noise where surfaces come into view, for "
        "some time", low=0, high=32, unit="px")
    reflection_iterations: int = setting(
        4, "Passes of the filter that spreads and upscales reflections: each doubles its reach, for less noise, softer "
        "reflections and some time", low=1, high=6)
    reflection_kernel: float = setting(
        1.0, "Scale of that filter's narrowest kernel (the paper's g_0): wider has less noise and blurs more",
        low=0.25, high=4.0)
    reflection_ratio: bool = setting(
        True, "Weigh a neighbour's ray by how likely it was here over how likely it was there, in linear light. Off: "
        "by the former alone, in compressed light, as published: darker, too narrow. As fast")
    reflection_cleanup: bool = setting(
        True, "Replace sparks and missing samples of reflections by their neighbours: removes flicker for little time, "
        "and now and then a true sparkle")
    reflection_temporal: bool = setting(
        True, "Average reflections over frames, where the surface or the mirrored thing was. Off shows each frame's")
    reflection_history: int = setting(
        32, "Most frames averaged in reflections while something moves (the paper: 8): more has less noise and lags "
        "more, at no cost", low=1, high=1024, unit="frames")
    reflection_clamp: float = setting(
        2.0, "Keep the average of reflections within so many standard deviations of this frame's neighbourhood (0: "
        "off; the paper: 1): less keeps up with changes and flickers more", low=0.0, high=16.0)
    antialiasing: bool = setting(
        True, "Average jittered frames: smooth edges for little time. Off shows each frame alone")
    supersample_small: bool = setting(
        True, "Draw frames of pictures of 240x135 to 960x540 pixels at twice the width and height, on a GPU, which "
        "they leave idle otherwise, and average: sharper edges, textures and shadows in motion for about a millisecond "
        "a frame. Needs anti-aliasing")
    depth_of_field: bool = setting(
        True, "Blur what is out of focus in each frame where the camera has depth of field, for little time. Off: "
        "path-traced samples alone have it")
    rest_frames: int = setting(
        64, "Frames at rest after which all time goes into path-traced samples, from the eighth on half of it (0: "
        "at once): they put right what frames get wrong. More frames are smoother for a while and exact later",
        low=0, high=1 << 20, unit="frames")
    path_traced_rest: bool = setting(
        True, "Go over to path tracing at rest, so that the picture becomes exact. Off: the filtered picture stays")
    rest_gather: bool = setting(
        True, "Gather indirect light for each pixel at rest: exact contacts and corners, for rays at rest alone")
    final_denoise: bool = setting(
        False, "Denoise the combined pass of final renders, all of path-traced samples, by Blender's Open Image "
        "Denoise: smooth pictures from few, for milliseconds on CUDA and a second or so on the processor")


@dataclass(frozen=True, kw_only=True)
class DebugSettings:
    """What to look at."""

    view: str = setting(
        "", "Intermediate result shown instead of the picture: for finding out where noise or an error comes from; "
        "costs one more pass", choices=DEBUG_VIEWS)


@dataclass(frozen=True, kw_only=True)
class RenderSettings:
    """Everything that decides the picture, besides the scene and the camera."""

    device: Device = setting(Device.AUTO, "Where the kernels run")
    sampling: SamplingSettings = field(default_factory=SamplingSettings)
    light_paths: LightPathSettings = field(default_factory=LightPathSettings)
    film: FilmSettings = field(default_factory=FilmSettings)
    performance: PerformanceSettings = field(default_factory=PerformanceSettings)
    probes: ProbeSettings = field(default_factory=ProbeSettings)
    cache: CacheSettings = field(default_factory=CacheSettings)
    direct_light: DirectLightSettings = field(default_factory=DirectLightSettings)
    reflections: ReflectionSettings = field(default_factory=ReflectionSettings)
    denoiser: DenoiserSettings = field(default_factory=DenoiserSettings)
    debug: DebugSettings = field(default_factory=DebugSettings)
