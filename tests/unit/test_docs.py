# SPDX-License-Identifier: GPL-3.0-or-later
"""The documentation: its links, the tables that plots are made from, and that plots and the README agree with them."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest

from tests.performance import plot_tables as tables
from tests.performance import plots

ROOT = Path(__file__).resolve().parents[2]
README = ROOT / "README.md"
PAGES = [README, *sorted((ROOT / "docs").glob("*.md")), ROOT / "sample_blends" / "README.md"]
PLOTS = ("at_rest", "equal_time_640", "equal_time_1080", "equal_time_processor", "flights", "frame_time", "waterfall",
         "stress_energy")
LINK = re.compile(r"\]\(([^)\s]+)\)")


def anchors(page: Path) -> set[str]:
    """Return the places in a page that links may name, as GitHub makes them of headings."""
    titles = re.findall(r"^#+ (.*)$", page.read_text("utf-8"), re.M)
    return {re.sub(r"[^\w\- ]", "", title.lower()).replace(" ", "-") for title in titles}


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_links_lead_somewhere(page: Path) -> None:
    """Find the file, and the heading in it, of every link; pictures in out/ are drawn by `make figures`."""
    broken = []
    for link in LINK.findall(page.read_text("utf-8")):
        name, _, anchor = link.partition("#")
        if re.match(r"[a-z]+:", link) or name.startswith("../out/"):
            continue
        target = page.parent / name if name else page
        if not target.exists() or anchor and anchor not in anchors(target):
            broken.append(link)
    assert not broken, ", ".join(broken)


def test_every_page_is_linked_from_the_readme() -> None:
    """Reach every page and every plot of docs/ from the README or from a page of docs/."""
    linked = {(page.parent / link.partition("#")[0]).resolve()
              for page in PAGES for link in LINK.findall(page.read_text("utf-8"))}
    lost = [path for path in [*PAGES[1:], *(ROOT / "docs" / "plots").glob("*")] if path.resolve() not in linked]
    assert not lost, ", ".join(path.name for path in lost)


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_lines_are_short(page: Path) -> None:
    """Keep lines outside of tables within 120 columns."""
    long = [number for number, line in enumerate(page.read_text("utf-8").splitlines(), 1)
            if len(line) > 120 and not line.startswith("|")]
    assert not long, f"lines {long}"


def test_plots_are_listed() -> None:
    """Test all plots that there are."""
    assert set(plots.CATALOGUE) == set(PLOTS)
    assert {path.stem for path in tables.PLOTS.glob("*.svg")} == set(PLOTS)


@pytest.mark.parametrize("name", PLOTS)
def test_plot_shows_its_table(name: str) -> None:
    """Read a plot's table, and find in its file what the table says (else: `make plots`)."""
    read = plots.CATALOGUE[name][0]
    data = json.loads(tables.description(read()))
    assert data
    assert tables.shown_by((tables.PLOTS / f"{name}.svg").read_text("utf-8")) == data


@pytest.mark.parametrize("name", PLOTS)
def test_plot_can_be_drawn(name: str) -> None:
    """Draw a plot, where matplotlib is installed."""
    pytest.importorskip("matplotlib")
    read, draw, title = plots.CATALOGUE[name]
    assert draw(read(), title).axes


def test_readme_has_the_tables_of_its_pages() -> None:
    """Find each marked table of the README, word for word, in a page of docs/."""
    marked = tables.named_tables(README.read_text("utf-8"))
    assert marked
    for name, rows in marked.items():
        assert rows == tables.table(name), name


def test_readme_counts_cells_at_equal_time() -> None:
    """Find in the README in how many cells of the table Burnish is ahead of Cycles."""
    ahead = judged = 0
    for points in tables.equal_time("equal-time-640").values():
        for _, *errors in points:
            ours, theirs = ([error for error in half if error is not None] for half in (errors[:2], errors[2:]))
            judged += bool(theirs)
            ahead += bool(theirs) and bool(ours) and min(ours) < min(theirs)
    assert f"{ahead} of {judged} cells" in README.read_text("utf-8")


def test_tables_of_a_frame_agree() -> None:
    """End the list of changes with the frame's times, and judge these by their goals."""
    times = tables.frame_time()
    for scene, values in tables.waterfall()["ms"].items():
        assert values[-1] == times[scene][0], scene
    for name in ("frame-1080", "stress-energy"):
        assert {row["met"] for row in tables.table(name)} <= {"yes", "no"}
    for row in tables.table("frame-1080"):
        assert (row["met"] == "yes") == (float(row["ms a frame"]) <= float(row["goal"])), row["scene"]


def test_gains_are_of_their_table() -> None:
    """Find the measured gain of each change as its row and the one before tell it."""
    data, rows = tables.waterfall(), tables.table("waterfall")
    for step in range(1, len(rows)):
        pairs = [(values[step - 1], values[step]) for values in data["ms"].values()
                 if values[step - 1] is not None and values[step] is not None]
        gain = sum(now - before for before, now in pairs)
        milliseconds, share = rows[step]["measured"].removesuffix(" %").split(", ")
        assert float(milliseconds) == pytest.approx(gain / len(pairs), abs=0.051), rows[step]["change"]
        assert float(share) == pytest.approx(100.0 * gain / sum(before for before, _ in pairs), abs=0.51)


@pytest.mark.parametrize("text", ["", "| a | b |\n|---|---|\n", "| a | b |\n|---|---|\n| 1 |\n"])
def test_unreadable_tables_are_told(text: str) -> None:
    """Name a table that is missing, empty or ragged."""
    with pytest.raises(tables.TableError, match="some-name"):
        tables.named_tables(f"<!-- table: some-name -->\n\n{text}")


def test_unreadable_cells_are_told() -> None:
    """Name the table of a cell that holds no number, or not as many as there should be."""
    with pytest.raises(tables.TableError, match="some-name"):
        tables.number("some-name", "fast")
    with pytest.raises(tables.TableError, match="some-name"):
        tables.numbers("some-name", ".1 / -", " / ", 4)
