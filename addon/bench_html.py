# SPDX-License-Identifier: GPL-3.0-or-later
"""The benchmark's report: one HTML file with everything in it, and the plots as files of their own. Knows no bpy.

Pictures are JPEGs inside the file, made coarser until they fit; two of them are compared under the pointer.
"""

from __future__ import annotations

import base64
import html
import json
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

from ..engine.read import read_exr
from .bench_plots import encode_jpeg, error_maps, mean_plot, pass_bars, time_plot
from .bench_report import LEGEND, METRICS, SceneResult, Table, scene_tables, truth_text, verdicts
from .bench_store import ENGINES, MOVING, write_bytes, write_text

__all__ = ["save_report", "summary_tables"]

PICTURE_BYTES = 7 << 20
"""All pictures of a report together; base64 makes them a third larger"""
QUALITIES = ((92, 1), (85, 1), (70, 1), (50, 1), (70, 2), (50, 3))
"""JPEG quality and whole factor of reduction, tried one after the other"""

Read = Callable[[Path], np.ndarray]

STYLE = """
body{font:15px/1.45 system-ui,sans-serif;margin:2em auto;max-width:1240px;padding:0 1em;color:#1c1c1c;background:#fff}
table{border-collapse:collapse;font-size:13px;margin:.4em 0 1.4em}
th,td{border-bottom:1px solid #ddd;padding:2px 8px;text-align:right;white-space:nowrap}
th:first-child,td:first-child{text-align:left}td.why{text-align:left;color:#777}
tr.won td:last-child{color:#0a7d28;font-weight:600}tr.lost td:last-child{color:#b3261e;font-weight:600}
.scroll{overflow-x:auto}.viewer{margin:1em 0}
.stage{position:relative;max-width:960px;cursor:col-resize;user-select:none;touch-action:none;background:#222}
.stage img{display:block;width:100%;image-rendering:pixelated}.stage img+img{position:absolute;left:0;top:0}
.stage i{position:absolute;top:0;bottom:0;width:1px;background:#fff;mix-blend-mode:difference}
.viewer select{max-width:48%;font-size:13px}.viewer p{margin:.3em 0;font-size:13px;color:#444}
img.plot{max-width:100%}h2{border-top:2px solid #1c1c1c;padding-top:.6em;margin-top:2em}p.fail{color:#b3261e}
nav a{margin-right:1em}details{margin:.6em 0}summary{cursor:pointer}
"""

SCRIPT = """
document.querySelectorAll('.viewer').forEach(v => {
  const pictures = JSON.parse(v.querySelector('script').textContent), stage = v.querySelector('.stage');
  const [a, b] = stage.querySelectorAll('img'), bar = stage.querySelector('i');
  const [left, right] = v.querySelectorAll('select'), note = v.querySelector('p');
  pictures.forEach((p, i) => [left, right].forEach(s => s.add(new Option(p.label, i))));
  left.value = v.dataset.left; right.value = v.dataset.right;
  let split = 50, truth = false;
  function draw() {
    const l = pictures[left.value], r = pictures[right.value];
    a.src = truth ? pictures[0].src : l.src; b.src = truth ? pictures[0].src : r.src;
    b.style.clipPath = `inset(0 0 0 ${split}%)`; bar.style.left = split + '%';
    note.textContent = `left: ${l.label} ${l.text} | right: ${r.label} ${r.text}`;
  }
  stage.addEventListener('pointermove', e => {
    const box = stage.getBoundingClientRect();
    split = Math.max(0, Math.min(100, 100 * (e.clientX - box.left) / box.width)); draw();
  });
  stage.addEventListener('pointerdown', e => { truth = true; e.preventDefault(); draw(); });
  window.addEventListener('pointerup', () => { truth = false; draw(); });
  [left, right].forEach(s => s.addEventListener('input', draw)); draw();
});
"""


def embedded(content: bytes, kind: str) -> str:
    """Return a file's content as a data URI."""
    return f"data:image/{kind};base64,{base64.b64encode(content).decode()}"


def html_table(table: Table) -> str:
    """Return a table as HTML; a row of two cells is a label and why there is nothing."""
    caption, head, rows = table
    lines = [f"<p>{html.escape(caption)}</p><div class=scroll><table><tr>",
             "".join(f"<th>{html.escape(name)}</th>" for name in head) + "</tr>"]
    for row in rows:
        texts = [html.escape(cell) for cell in row]
        last = row[-1].partition(":")[0]
        kind = f" class={last}" if last in ("won", "lost") else ""
        if len(row) == 2 and len(head) > 2:
            lines.append(f"<tr><td>{texts[0]}</td><td class=why colspan={len(head) - 1}>{texts[1]}</td></tr>")
        else:
            lines.append(f"<tr{kind}>" + "".join(f"<td>{text}</td>" for text in texts) + "</tr>")
    return "\n".join([*lines, "</table></div>"])


def summary_tables(results: list[SceneResult]) -> Iterator[Table]:
    """Yield what holds over all scenes: how often Burnish is better, and the times of a frame and of a sample."""
    outcomes: dict[tuple[str, float, str], list[tuple[str, str]]] = {}
    for result in results:
        for each in verdicts(result):
            outcomes.setdefault((each.clock, each.budget, each.metric), []).append((result.name, each.text))
    rows = []
    for (clock, budget, metric), found in sorted(outcomes.items(), key=lambda item: (item[0][0] != "warm", item[0])):
        counts = [sum(text.startswith(word) for _, text in found) for word in ("won", "lost", "no")]
        lost = ", ".join(name for name, text in found if text.startswith("lost"))
        rows.append([clock, f"{budget:g} s", METRICS[metric], *(str(count) for count in counts), lost])
    if rows:
        yield ("Scenes in which Burnish's best engine has a lower error than the best rival with the same time:",
               ["clock", "budget", "error", "won", "lost", "not compared", "lost in"], rows)
    rows = []
    for result in results:
        moving = next((row for row in result.rows if row.get("clock") == MOVING and row.get("parts")), None)
        rest, cycles = result.engines.get("realtime"), result.engines.get("cycles")
        denoised = result.engines.get("cycles+oidn")
        values = [rest["per_frame"] if rest else None, moving["parts"]["device frames"] if moving else None,
                  moving["parts"]["read-back"] if moving else None, cycles["per_sample"] if cycles else None,
                  denoised["denoise"] if denoised else None]
        if any(value is not None for value in values):
            rows.append([result.name, *("" if value is None else f"{1e3 * value:.2f}" for value in values)])
    if rows:
        yield ("Milliseconds of one frame and of one sample:",
               ["scene", "frame, mean of the first second", "frame in motion", "its read-back", "Cycles sample",
                "Cycles denoising"], rows)


def pictures_of(result: SceneResult, output: Path, read: Read) -> Iterator[tuple[dict[str, str], np.ndarray]]:
    """Yield label and text of each picture of a scene, the truth's first, with the picture."""
    truth = output / result.truth_file
    if not result.truth_file or not truth.is_file():
        return
    yield {"label": "Truth", "text": f"({result.truth})"}, read(truth)
    for row in result.rows:
        if row.get("errors") and row.get("file"):
            errors = row["errors"]
            text = f"FLIP {errors['flip']:.3f}, relMSE {errors['relative_mse']:.3g}"
            if row.get("seconds"):
                text += f", {row['seconds']:.3g} s"
            yield {"label": row["label"], "text": f"({text})"}, read(output / row["file"])


def encode_pictures(results: list[SceneResult], output: Path, read: Read) -> list[list[dict[str, str]]]:
    """Return each scene's pictures with labels and data URIs, as coarse as they must be to fit together."""
    for quality, shrink in QUALITIES:
        total, scenes = 0, []
        for result in results:
            entries = []
            for entry, picture in pictures_of(result, output, read):
                content = encode_jpeg(picture, result.exposure, quality, shrink)
                total += len(content)
                entries.append({**entry, "src": embedded(content, "jpeg")})
            scenes.append(entries)
        if total <= PICTURE_BYTES:
            break
    return scenes


def viewer(entries: list[dict[str, str]]) -> str:
    """Return the comparison of two pictures at a time."""
    if len(entries) < 2:
        return ""
    labels = [entry["label"] for entry in entries]
    own = next((i for i, label in enumerate(labels) if label.startswith(ENGINES["realtime"] + " ")), 0)
    rival = next((i for i, label in enumerate(labels) if label.startswith(ENGINES["cycles+oidn"])), len(labels) - 1)
    # "</" would end the script element.
    data = json.dumps(entries).replace("</", "<\\/")
    return (f"<div class=viewer data-left={own} data-right={rival}><script type=application/json>{data}</script>"
            "<select aria-label='left picture'></select> <select aria-label='right picture'></select>"
            "<div class=stage><img alt='left picture'><img alt='right picture'><i></i></div><p></p>"
            "<p>Move the pointer to shift the border; hold the button for the truth.</p></div>")


def scene_plots(result: SceneResult, output: Path, read: Read) -> Iterator[tuple[str, bytes]]:
    """Yield the plots of a scene with their file names."""
    plots = {f"{result.name}_{clock}.png": time_plot(result, clock) for clock in ("warm", "cold")}
    plots[f"{result.name}_passes.png"] = pass_bars(result)
    if result.truth_file:
        truth = read(output / result.truth_file)
        plots[f"{result.name}_errors.jpg"] = error_maps(result, truth, lambda row: read(output / row["file"]))
    yield from ((name, plot) for name, plot in plots.items() if plot is not None)


def plot_image(name: str, content: bytes, output: Path) -> str:
    """Save a plot among the results and return it as part of the page."""
    write_bytes(output / "plots" / name, content)
    kind = "jpeg" if name.endswith("jpg") else "png"
    return f"<img class=plot alt='{html.escape(name)}' src='{embedded(content, kind)}'>"


def save_report(output: Path, results: list[SceneResult], machine: dict[str, str], options: dict[str, Any],
                read: Read = read_exr) -> None:
    """Write report.html and the folder `plots`.

    Args:
        output: Folder of the results; files that rows name are relative to it.
        results: Of all scenes.
        machine: What was measured on.
        options: Of the command.
        read: Gives a file's picture [h, w, 3], scene-linear, bottom row first.
    """
    pictures = encode_pictures(results, output, read)
    facts = "; ".join(f"{name} {value}" for name, value in machine.items())
    parts = ["<!doctype html><html lang=en><meta charset=utf-8><title>Burnish benchmark</title>",
             f"<style>{STYLE}</style><h1>Burnish benchmark</h1><p>{html.escape(facts)}.</p>"]
    if any(engine == "eevee" for result in results for engine in result.engines):
        device = next(result.engines["eevee"]["device"] for result in results if "eevee" in result.engines)
        parts.append(f"<p>EEVEE rasterizes on: {html.escape(str(device))}. Data-centre GPUs, and drivers without "
                     "hardware, are slow at rasterizing.</p>")
    parts.append("<nav>" + "".join(f"<a href='#scene{i}'>{html.escape(result.name)}</a>"
                                   for i, result in enumerate(results)) + "</nav>")
    parts += [html_table(table) for table in summary_tables(results)]
    for clock in ("warm", "cold"):
        plot = mean_plot(results, clock)
        if plot is not None:
            parts.append(plot_image(f"mean_{clock}.png", plot, output))
    for index, (result, entries) in enumerate(zip(results, pictures, strict=True)):
        parts.append(f"<h2 id=scene{index}>{html.escape(result.name)}</h2>")
        if result.failure:
            parts.append(f"<p class=fail>{html.escape(result.failure)}</p>")
            continue
        parts.append(f"<p>{result.size[0]} x {result.size[1]} on {html.escape(result.device)}. "
                     f"{html.escape(truth_text(result))}.</p>")
        if result.interrupted:
            parts.append("<p class=fail>The run was interrupted: rows are missing.</p>")
        parts.append(viewer(entries))
        parts += [plot_image(name, content, output) for name, content in scene_plots(result, output, read)]
        parts += [html_table(table) for table in scene_tables(result)]
    settings = json.dumps(options, indent=1, default=str)
    parts.append(f"<p>{html.escape(LEGEND)}</p><details><summary>Options</summary><pre>{html.escape(settings)}</pre>"
                 f"</details><script>{SCRIPT}</script></html>")
    write_text(output / "report.html", "\n".join(parts) + "\n")
