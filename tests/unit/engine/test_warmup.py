# SPDX-License-Identifier: GPL-3.0-or-later
"""Warming up builds what a picture needs before it, and everything that is ever launched in the end."""

from __future__ import annotations

import json
import threading
import time
from pathlib import Path

import pytest
from burnish.engine import warmup
from burnish.engine.device import hear_of_builds, load_module, loaded_modules, start_warp
from burnish.engine.errors import KernelBuildFailed
from burnish.engine.settings import Integrator
from burnish.engine.warmup import FIRST_MODULES, HOST_MODULES, KERNEL_MODULES, SHARED_MODULES, build_rest, warm_up

DRAWN = """
import json
from burnish.engine.device import loaded_modules
from burnish.engine.settings import Integrator, RenderSettings, SamplingSettings
from tests import scenes
from burnish.engine.scene import LightKind
from burnish.engine.session import Session

def names():
    return sorted(loaded_modules("cpu"))

settings = RenderSettings(device="cpu", sampling=SamplingSettings(integrator=Integrator(sys.argv[1])))
session = Session(settings)
first = names()
floor = scenes.material("PRINCIPLED", color=0.7, roughness=0.3, metallic=0.5)
meshes = {"floor": scenes.quad(3.0), "box": scenes.box(0.3)}
objects = [("floor", scenes.place(), "white"), ("box", scenes.place(z=0.3), "white")]
lamps = [scenes.lamp(LightKind.POINT, 50.0, scenes.place(1.0, 1.0, 2.0), radius=0.2)]
session.update(scenes.delta(meshes, objects, {"white": floor}, lamps, 0.2))
session.configure(settings, scenes.camera_above(3.0, 1.0, orthographic=False), 32, 18)
session.step(12)
session.read("Combined")
print(json.dumps([first, names()]))
"""


@pytest.fixture
def fresh(monkeypatch: pytest.MonkeyPatch) -> set[tuple[str, str]]:
    """Let no module be loaded, and load none: return what is asked for."""
    loads: set[tuple[str, str]] = set()

    def load(name: str, device: str) -> None:
        assert (name, device) not in loads
        loads.add((name, device))

    monkeypatch.setattr(warmup, "_load", load)
    monkeypatch.setattr(warmup, "loaded_modules", lambda device: {name for name, where in loads if where == device})
    return loads


def test_all_kernels_are_warmed_up():
    """Name each module of kernels that has a kernel, once."""
    folder = Path(__file__).resolve().parents[3] / "kernels"
    owners = {path.stem for path in folder.glob("*.py") if "@wp.kernel" in path.read_text("utf-8")}
    owners -= {"albedo_tables", "white_share"}  # The processor alone runs them: tables.py, the stress test's furnaces.
    named = [module.__name__.rpartition(".")[2] for module in (*KERNEL_MODULES, *HOST_MODULES)]
    assert set(named) == owners and len(named) == len(owners)
    assert set(SHARED_MODULES) <= set(KERNEL_MODULES)
    for modules in FIRST_MODULES.values():
        assert set(modules) <= {*KERNEL_MODULES, *HOST_MODULES} and len(modules) == len(set(modules))


@pytest.mark.parametrize("integrator", [None, Integrator.REALTIME])
@pytest.mark.parametrize("device", ["cpu", "cuda:7"])
def test_the_processor_has_its_own(
    device: str, integrator: Integrator | None, fresh: set[tuple[str, str]],
) -> None:
    """Build for the processor what it runs beside any device, everything once, and tell how far that is."""
    told: list[tuple[str, int, int]] = []
    seconds = warm_up(device, lambda *step: told.append(step), integrator)
    if device == "cpu" and integrator is not None:
        assert fresh == {(module.__name__, "cpu") for module in FIRST_MODULES[integrator]}
    else:
        beside = {(module.__name__, "cpu") for module in (*HOST_MODULES, *SHARED_MODULES)}
        assert fresh == {(module.__name__, device) for module in KERNEL_MODULES} | beside
    assert seconds > 0.0 and {count for _, _, count in told} == {len(fresh)}
    assert [number for _, number, _ in told] == sorted(number for _, number, _ in told)
    assert told[-1][1] == len(fresh)
    assert warm_up(device, None, integrator) == 0.0


def test_who_listens_is_told(fresh: set[tuple[str, str]]) -> None:
    """Tell the thread's own listener of modules where nobody else is told, and only who has to wait."""
    heard: list[str] = []
    with hear_of_builds(heard.append):
        warm_up("cpu", None, Integrator.REFERENCE)
        assert set(heard) == {module.__name__.rpartition(".")[2] for module in FIRST_MODULES[Integrator.REFERENCE]}
        with warmup._lock:  # as while another thread builds
            assert warm_up("cpu", None, Integrator.REFERENCE) == 0.0


@pytest.mark.slow
@pytest.mark.parametrize("integrator", [Integrator.REFERENCE, Integrator.REALTIME])
def test_a_plain_scene_waits_for_no_other_kernels(integrator: Integrator, run_python) -> None:
    """Find all that a floor, a box and a lamp need among what is built first, and hardly anything else in it."""
    root = str(Path(__file__).resolve().parents[3])
    done = run_python(f"sys.path.insert(0, {root!r})\n" + DRAWN, integrator.value)
    assert done.returncode == 0, done.stderr
    first, all_loaded = (set(names) for names in json.loads(done.stdout.splitlines()[-1]))
    wanted = {module.__name__ for module in FIRST_MODULES[integrator]}
    assert first == wanted
    assert all_loaded <= wanted | {"burnish.kernels.albedo_tables"}, all_loaded - wanted


def test_a_build_that_is_cancelled_ends(fresh: set[tuple[str, str]], monkeypatch: pytest.MonkeyPatch) -> None:
    """Build no more modules once the one who is told about them has had enough."""
    load = warmup._load

    def slowly(name: str, device: str) -> None:
        time.sleep(0.01)
        load(name, device)

    monkeypatch.setattr(warmup, "_load", slowly)
    def cancel(name: str, number: int, count: int) -> None:
        if number == 5:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        warm_up("cpu", cancel)
    assert 5 <= len(fresh) < len(KERNEL_MODULES)


def test_a_module_that_fails_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    """Say which kernels could not be built, and where."""
    def fail(name: str, device: str) -> bool:
        raise RuntimeError("no compiler")

    monkeypatch.setattr(warmup, "load_module", fail)
    monkeypatch.setattr(warmup, "loaded_modules", lambda device: set())
    with pytest.raises(KernelBuildFailed, match="could not be built for cpu: no compiler"):
        warm_up("cpu")


def test_the_rest_is_built_meanwhile(fresh: set[tuple[str, str]], monkeypatch: pytest.MonkeyPatch) -> None:
    """Build in a thread what the first picture did not need, once, and on a processor alone."""
    monkeypatch.setattr(warmup, "_rest", None)
    monkeypatch.setattr(warmup.atexit, "register", lambda call: None)
    warm_up("cpu", None, Integrator.REFERENCE)
    build_rest("cuda:0")
    assert warmup._rest is None
    build_rest("cpu")
    thread = warmup._rest
    build_rest("cpu")
    thread.join(10.0)
    assert warmup._rest is thread and not thread.is_alive()
    assert fresh == {(module.__name__, "cpu") for module in (*KERNEL_MODULES, *HOST_MODULES)}


def test_threads_share_a_load() -> None:
    """Load a module once where several threads need it; tell those that wait, who may give up."""
    def cancel(title: str) -> None:
        raise RuntimeError(f"cancelled before {title}")

    start_warp()
    name, heard, results = "burnish.kernels.mip_levels", [], []
    threads = [threading.Thread(target=lambda: results.append(load_module(name, "cpu"))) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert results == [True] * 4 and name in loaded_modules("cpu")
    with hear_of_builds(heard.append):
        assert load_module(name, "cpu")
        assert not heard
        with pytest.raises(RuntimeError, match="cancelled"), hear_of_builds(cancel):
            load_module("burnish.kernels.no_such_kernels", "cpu")
