# SPDX-License-Identifier: GPL-3.0-or-later
"""The names of all intermediate results that can be looked at instead of the picture, in the frame's order.

A table of text, so that panels and the command line know the names before anything is rendered; each pass of the
real-time frame has the same names in its `debug_views` (a test compares them).
"""

from __future__ import annotations

__all__ = ["DEBUG_VIEWS"]

DEBUG_VIEWS: dict[str, str] = {
    "gbuffer.normal": "Shading normal in world space, -1..1 shown as 0..1",
    "gbuffer.albedo": "Diffuse albedo: the share of light that the surface reflects in all directions",
    "gbuffer.specular": "Specular albedo: the share of light that the surface mirrors, for this view",
    "gbuffer.transmitted": "Albedo of glass: the share of light that the surface lets through, for this view",
    "gbuffer.coat": "Albedo of the coat, where that is a reflection of its own beside the surface's, for this view",
    "gbuffer.roughness": "Roughness of reflections, widened where normals vary inside a pixel: black is a mirror",
    "gbuffer.depth": "Distance from the camera",
    "gbuffer.motion": "Motion in pixels since the frame before: red to the right, green upwards, grey at rest",
    "gbuffer.instance": "One colour for each instance of an object",
    "gbuffer.disocclusion": "Pixels that the frame before did not show: what is bright starts without history",
    "probes.radiance": "What each screen probe sees: its 8x8 directions, drawn into its tile",
    "probes.tiles": "Which probe each tile uses: one colour for each probe",
    "probes.age": "Frames since each tile's probe last sent rays: white after 64; bright probes live on old light",
    "probes.count": "Updates in each probe's mean, white at 1024: the more, the less noise and the slower to change",
    "probes.contact": "Light and shadow added to the probes from nearby pixels: grey is none, bright is light",
    "probes.irradiance": "Indirect diffuse light from the probes alone, before it is denoised",
    "probes.specular": "Indirect light that reflections get, by the diffuse light: grey alike, black none, white twice",
    "cache.cells": "Cells of the radiance cache: one colour for each",
    "cache.levels": "Level of detail of the cache's cells: each level is twice as large",
    "cache.light": "Light kept in the cache at what the camera sees",
    "cache.samples": "Samples averaged in each cell of the cache: black has none",
    "direct.diffuse": "Direct diffuse light of this frame, without albedo, before it is denoised",
    "direct.specular": "Direct specular light of this frame, without albedo, before it is denoised",
    "direct.light": "Which light each pixel chose in this frame: one colour for each light",
    "direct.weight": "Weight of each pixel's chosen light: evenly grey where the choice was good",
    "direct.visibility": "Shadow rays of this frame: white reached the light, black did not, blue pixels have none",
    "direct.history": "Frames averaged in direct light: black where it started anew, white from 1024 on",
    "direct.variance": "Error left in the mean of direct light, relative to it: white from 100 % on",
    "diffuse.history": "Frames averaged in indirect light: black where it started anew, white from 1024 on",
    "diffuse.blur": "Radius of the blur of indirect light: white at the largest, black where history replaces it",
    "reflections.classes": "How each reflection is found: blue by a ray, light blue if sharp, green in the probes, "
    "grey from diffuse light",
    "reflections.hits": "What reflection rays found: blue the world, white a light; of surfaces green the picture "
    "before, yellow a shadow ray of their own, purple the cache alone",
    "reflections.radiance": "Reflected light of this frame's samples, without the surfaces' colours, before it is "
    "denoised",
    "reflections.distance": "Length of the way to what is reflected, over mirrors and glass: white is the world",
    "reflections.filtered": "Reflections of this frame after their filter, before they are averaged over frames",
    "reflections.history": "Samples averaged in reflections: black where it started anew, white from 1024 on",
    "reflections.variance": "Error left in the mean of reflections, relative to it: white from 100 % on",
    "reflections.marked": "Reflection samples that are replaced: sparks red, missing ones blue",
    "composite.direct": "Emission and direct light with the surfaces' colours",
    "composite.indirect": "Indirect light with the surfaces' colours",
    "composite.reflection": "Indirect light that the surfaces reflect, with their colours",
    "composite.history": "Frames averaged by anti-aliasing: dark where it started anew",
    "depth_of_field.radius": "Circles of confusion of a camera with depth of field: white is in focus, red in front of "
    "it, blue behind; darkest where 64 of 1080 lines wide",
    "fog.light": "Light that fog adds before each pixel's surface",
    "fog.passing": "Share of light that fog lets through between each pixel's surface and the camera",
    "rest.weight": "Share of the finest detail that comes from path-traced samples, once the picture has been at rest "
                   "for some frames: white is all",
}
"""Help by name; a name is its pass and what it shows"""
