"""What the tests of the workbench share: a tiny module, a viewer without OpenGL, real windows."""

from __future__ import annotations

import gc
import os
from collections.abc import Callable, Generator
from dataclasses import replace
from pathlib import Path
from time import monotonic, sleep
from typing import Any
from unittest.mock import patch

import numpy as np
import platformdirs
import pytest
from npe2 import PluginManifest
from pytestqt.qtbot import QtBot
from qtpy.QtWidgets import QApplication

os.environ.setdefault("QT_QPA_PLATFORM", "offscreen")
REAL_WINDOW = os.environ["QT_QPA_PLATFORM"] == "xcb"

from napari.settings import get_settings  # noqa: E402 (Qt reads the platform on import)

from napari_pv_inspect.application import build  # noqa: E402 (Qt reads the platform on import)
from napari_pv_inspect.docks.gallery import CellsDock  # noqa: E402
from napari_pv_inspect.docks.inspect import InspectDock  # noqa: E402
from napari_pv_inspect.napari_internals import main_window  # noqa: E402
from pv_inspect.inspection.inspection import Inspection, Step  # noqa: E402
from pv_inspect.pipeline import inspect  # noqa: E402
from pv_inspect.sequence.sequence import FrameSequence  # noqa: E402
from pv_inspect.settings import Settings, Stage  # noqa: E402
from pv_inspect.simulate import SimulationSettings, simulated, write_sequence  # noqa: E402
from tests.once import made_once  # noqa: E402
from tests.plugin.reviewing import show, stored  # noqa: E402
from tests.plugin.shared_window import SharedWindow, is_ours  # noqa: E402
from tests.waiting import LONG_MS  # noqa: E402

LEAVING_S = 60.0
"""Work that goes on in the background ends within a second; this is for a busy machine."""


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Skip what needs a real window when there is none."""
    skip = pytest.mark.skip(reason="needs a real window: run under Xvfb with QT_QPA_PLATFORM=xcb")
    for item in items:
        if item.get_closest_marker("xvfb") and not REAL_WINDOW:
            item.add_marker(skip)


class PatientBot(QtBot):
    """Waits for what must happen up to the common limit, however busy the machine is."""

    def waitUntil(self, callback: Callable[[], bool | None], *, timeout: int = LONG_MS) -> None:
        super().waitUntil(callback, timeout=timeout)

    def waitSignal(self, signal: Any, *, timeout: int = LONG_MS, **options: Any) -> Any:
        return super().waitSignal(signal, timeout=timeout, **options)


@pytest.fixture
def qtbot(qapp: Any, request: pytest.FixtureRequest) -> QtBot:
    """Take the place of pytest-qt's, which waits for 5 s."""
    return PatientBot(request)


@pytest.fixture(autouse=True)
def no_opengl(monkeypatch: pytest.MonkeyPatch) -> None:
    """Tell napari what OpenGL would: on the offscreen platform there is none to ask."""
    if REAL_WINDOW:
        return
    from napari._vispy import canvas
    from napari._vispy.layers import image, labels
    from napari._vispy.utils import gl

    for module in (gl, image):
        monkeypatch.setattr(module, "get_gl_extensions", lambda: "")
    for module in (gl, image, labels, canvas):
        monkeypatch.setattr(module, "get_max_texture_sizes", lambda: (16384, 2048))


@pytest.fixture(scope="session", autouse=True)
def nothing_of_the_user() -> Generator[None]:
    """Write no settings of napari, and look once for what plugins are installed.

    napari wrote its settings five times per window, and looked for plugins at each.
    """
    installed = list(PluginManifest.discover())
    get_settings()._save_on_change = False
    with patch.object(PluginManifest, "discover", lambda **_: iter(installed)):
        yield


@pytest.fixture(autouse=True)
def modules_are_no_garbage(request: pytest.FixtureRequest) -> Generator[None]:
    """Once a viewer was made and closed, leave out of garbage collection what is there to stay.

    napari collects all garbage several times per viewer, and each time looked through the million
    objects of the loaded modules: about a twelfth of the processor time of these tests.
    """
    yield
    if {"make_napari_viewer", "workbench"} & {*request.fixturenames} and not gc.get_freeze_count():
        gc.collect()
        gc.freeze()


@pytest.fixture(scope="session")
def windows() -> Generator[list[SharedWindow]]:
    """Hold the shared window, if there is one."""
    windows: list[SharedWindow] = []
    yield windows
    for window in windows:
        window.close()


@pytest.fixture
def viewer(
    windows: list[SharedWindow], qtbot: QtBot, request: pytest.FixtureRequest
) -> Generator[Any]:
    """Give out the shared window, empty; whatever a test does not put back fails that test.

    A test that closes it is looked at as by `make_napari_viewer`, and the next gets another one.
    """
    top_level = {id(widget) for widget in QApplication.topLevelWidgets()}
    if not windows:
        windows.append(SharedWindow())
        # See `modules_are_no_garbage`; the window stays as well.
        gc.collect()
        gc.freeze()
        top_level = {id(widget) for widget in QApplication.topLevelWidgets()}
    window = windows[0]
    with window.in_use():
        yield window.viewer
        # What pytest still holds of the test is no leak.
        request.node.funcargs.clear()
        called = getattr(request.node, "rep_call", None)
        failed = called is None or called.failed
        found: list[str] = []
        if window.is_open and not failed:
            gone = window.empty()

            def left_over() -> list[str]:
                return window.left_over(gone) + [
                    f"{widget!r} is open"
                    for widget in QApplication.topLevelWidgets()
                    if id(widget) not in top_level and (widget.isVisible() or is_ours(widget))
                ]

            # Background work may hold on to things a little longer.
            found = left_over()
            end = monotonic() + LEAVING_S
            while found and monotonic() < end:
                sleep(0.02)
                found = left_over()
            if not found:
                gc.freeze()  # What is alive now is there to stay.
                return
    windows.clear()
    window.close()
    if not failed and not found:
        window.assert_gone()
    assert not found, "left in the shared window: " + "; ".join(found)


@pytest.fixture(autouse=True)
def own_user_state(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Keep what the workbench remembers out of the user's folder."""
    folder = tmp_path / "config" / "pv-inspect"
    monkeypatch.setattr(platformdirs, "user_config_dir", lambda _: str(folder))


@pytest.fixture(scope="session")
def tiny_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Five frames 240 x 180 of a module of 3 x 4 cells."""
    settings = SimulationSettings(
        rows=3, cols=4, n_frames=5, width=240, height=180, pixels_per_unit=96, supersampling=3
    )

    def made() -> Path:
        folder = tmp_path_factory.mktemp("tiny") / "module"
        write_sequence(simulated(settings), folder)
        return folder

    return made_once(tmp_path_factory, "tiny_folder", made)


@pytest.fixture(scope="session")
def tiny_sequence(tiny_folder: Path) -> FrameSequence:
    """Return the tiny module, opened."""
    return FrameSequence.open(tiny_folder)


@pytest.fixture(scope="session")
def tiny_settings(tiny_sequence: FrameSequence) -> Settings:
    """Settings that the workbench has after opening the tiny module, made quick."""
    hint = tiny_sequence.layout_hint
    return Settings(
        rows=hint["rows"],
        cols=hint["cols"],
        cell_aspect=hint.get("cell_aspect"),
        magnification=2.0,
        max_iterations=5,
    )


@pytest.fixture(scope="session")
def tiny_inspection(
    tiny_sequence: FrameSequence,
    tiny_settings: Settings,
    tmp_path_factory: pytest.TempPathFactory,
) -> Inspection:
    """Return a whole inspection of the tiny module."""
    inspection = made_once(
        tmp_path_factory, "tiny_inspection", lambda: inspect(tiny_sequence, tiny_settings)
    )
    return replace(inspection, sequence=tiny_sequence)


@pytest.fixture
def workbench(
    request: pytest.FixtureRequest, tiny_sequence: FrameSequence, tiny_settings: Settings
) -> tuple[Any, InspectDock, CellsDock]:
    """Viewer and docks with the tiny module open; the viewer is shared, see `viewer`.

    A test that asks for `make_napari_viewer` has one of its own.
    """
    if REAL_WINDOW or "make_napari_viewer" in request.fixturenames:
        viewer = request.getfixturevalue("make_napari_viewer")()
    else:
        viewer = request.getfixturevalue("viewer")
    dock, cells = build(viewer)
    dock.workbench.model.open(tiny_sequence)
    dock.workbench.model.change_settings(magnification=2.0, max_iterations=5)
    return viewer, dock, cells


@pytest.fixture
def saved(workbench: Any, tiny_inspection: Inspection, tmp_path: Path, qtbot: QtBot) -> Any:
    """Viewer, dock and gallery in a shown window; a whole inspection is saved in ``out``."""
    viewer, dock, cells = workbench
    show(dock, tiny_inspection)
    dock.save(tmp_path / "out")
    qtbot.waitUntil(lambda: dock.workbench.review.state.storage.folder is not None)
    stored(dock, qtbot)
    main_window(viewer).resize(1280, 800)
    main_window(viewer).show()
    return viewer, dock, cells


@pytest.fixture
def replayed(monkeypatch: pytest.MonkeyPatch, tiny_inspection: Inspection) -> Generator[Replay]:
    """Replace the pipeline by a replay of the tiny inspection that goes on when it is let."""
    replay = Replay(tiny_inspection)
    monkeypatch.setattr("pv_inspect.pipeline.inspect_steps", replay.inspect_steps)
    yield replay
    replay.go_on, replay.busy = True, False


class Replay:
    """The steps of a finished inspection, without the work; holds before the last step."""

    def __init__(self, inspection: Inspection) -> None:
        self.inspection = inspection
        self.go_on = True
        self.busy = False
        """Within a long step, which a request to stop waits for."""
        self.error: Exception | None = None
        self.closed = 0
        self.starts: list[Inspection | None] = []

    def inspect_steps(
        self, _: FrameSequence, settings: Settings, start: Inspection | None = None
    ) -> Generator[Step, None, Inspection]:
        """Replay; same signature as `pipeline.inspect_steps`."""
        self.starts.append(start)
        whole = self.inspection
        parts = {
            Stage.DETECT: whole.crossings,
            Stage.CALIBRATE: whole.calibration,
            Stage.REGISTER: whole.registration,
        }
        try:
            for stage, part in parts.items():
                yield Step(stage, stage.index / 10, f"{stage} done", part)
            assert whole.reconstruction is not None
            blurred = np.asarray(whole.reconstruction.image[::2, ::2])
            yield Step(Stage.RECONSTRUCT, 0.6, "iteration 1", blurred)
            if self.error is not None:
                raise self.error
            while not self.go_on:
                sleep(0.01)
                while self.busy:
                    sleep(0.01)
                yield Step(Stage.RECONSTRUCT, 0.7, "iterating")
            yield Step(Stage.RECONSTRUCT, 0.8, "done", whole.reconstruction)
            yield Step(Stage.CELLS, 0.9, "done", whole.tiles)
            yield Step(Stage.CRACKS, 1.0, "done", whole.cracks)
            return replace(whole, settings=settings)
        finally:
            self.closed += 1
