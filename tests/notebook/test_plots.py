from __future__ import annotations

import builtins
import sys
from collections.abc import Generator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
import pytest
from matplotlib.collections import LineCollection
from matplotlib.patches import Rectangle

import pv_inspect
from pv_inspect.errors import InspectionError
from pv_inspect.inspection.inspection import Inspection
from pv_inspect.notebook import plots
from pv_inspect.sequence.frame import Frame
from tests.handmade import REASON, FakeSequence, made_inspection


@dataclass(frozen=True, eq=False)
class Shown(FakeSequence):
    """Frames that are all ramps."""

    def frame(self, index: int) -> Frame:
        y, x = np.mgrid[:60, :80]
        return Frame((x + 2 * y + index).astype(np.float32), np.ones((60, 80), bool))


@pytest.fixture(autouse=True)
def no_window() -> Generator[None]:
    plt.switch_backend("agg")
    yield
    plt.close("all")


@pytest.fixture
def inspection() -> Inspection:
    sequence: Any = Shown()
    return made_inspection(sequence=sequence)


def without(inspection: Inspection, *stages: str) -> Inspection:
    return replace(inspection, **dict.fromkeys(stages))


def legend(ax: Any) -> list[str]:
    return [text.get_text() for text in ax.get_legend().get_texts()]


def lines(ax: Any) -> dict[str, np.ndarray]:
    return {line.get_label(): line.get_xydata() for line in ax.lines}


def test_plots_go_where_they_are_told_to(inspection: Inspection) -> None:
    for plot in (plots.grid, plots.cells, plots.residuals):
        _, ax = plt.subplots()
        assert plot(inspection, ax=ax) is ax
        n_figures = len(plt.get_fignums())
        assert plot(inspection) is not ax
        assert len(plt.get_fignums()) == n_figures + 1


def test_the_grid_is_drawn_over_its_frame_in_its_pixels(inspection: Inspection) -> None:
    ax = plots.grid(inspection, 2)
    np.testing.assert_array_equal(ax.images[0].get_array(), inspection.sequence.frame(2).image)
    assert (ax.get_xlim(), ax.get_ylim()) == ((-0.5, 79.5), (59.5, -0.5))
    assert (ax.get_xlabel(), ax.get_ylabel()) == ("x [LR px]", "y [LR px]")
    (grid,) = (c for c in ax.collections if isinstance(c, LineCollection))
    segments = grid.get_segments()
    assert len(segments) == 3 + 4  # borders of 2 rows and 3 columns
    drawn = np.concatenate(segments)
    assert inspection.registration is not None
    for crossing in inspection.registration.crossings_px(2):
        assert np.hypot(*(drawn - crossing).T).min() < 1e-9
    assert inspection.crossings is not None
    measured = lines(ax)["measured crossing"]
    np.testing.assert_array_equal(measured, inspection.crossings.frames[2].points_px)


def test_a_crossing_that_was_not_measured_is_drawn_where_the_fit_expects_it(
    inspection: Inspection,
) -> None:
    crossings, registration = inspection.crossings, inspection.registration
    assert crossings is not None
    assert registration is not None
    seen = crossings.frames[0].measured.copy()
    seen[4] = False
    frames = (replace(crossings.frames[0], measured=seen), *crossings.frames[1:])
    ax = plots.grid(replace(inspection, crossings=replace(crossings, frames=frames)), 0)
    np.testing.assert_allclose(lines(ax)["predicted crossing"], registration.crossings_px(0)[[4]])
    assert len(lines(ax)["measured crossing"]) == 11
    assert legend(ax) == ["fitted grid", "measured crossing", "predicted crossing"]


def test_a_frame_that_is_not_used_has_its_reason_and_no_grid(inspection: Inspection) -> None:
    ax = plots.grid(inspection, 1)
    assert REASON in ax.get_title()
    assert not ax.collections


def test_the_first_used_frame_is_shown_if_none_is_named(inspection: Inspection) -> None:
    registration = inspection.registration
    assert registration is not None
    used = replace(registration, used=np.array([False, False, True]))
    ax = plots.grid(replace(inspection, registration=used))
    assert ax.get_title() == "frame_2.tif"
    found_only = without(inspection, "registration", "calibration")
    assert plots.grid(found_only).get_title() == "frame_0.tif"


def test_the_cells_are_the_module_image_in_cell_widths(inspection: Inspection) -> None:
    reconstruction = inspection.reconstruction
    assert reconstruction is not None
    ax = plots.cells(inspection)
    image, overlay = ax.images
    np.testing.assert_array_equal(image.get_array(), reconstruction.image)
    left, right, bottom, top = image.get_extent()
    grid = reconstruction.grid
    x0, y0 = grid.origin_px
    ppu = grid.pixels_per_unit
    # The outer corner of the first pixel lies half a pixel before its centre.
    assert (left, top) == pytest.approx(((-0.5 - x0) / ppu, (-0.5 - y0) / ppu))
    assert (right - left, bottom - top) == pytest.approx(
        (reconstruction.image.shape[1] / ppu, reconstruction.image.shape[0] / ppu)
    )
    assert [tick.get_text() for tick in ax.get_xticklabels()] == ["1", "2", "3"]
    assert [tick.get_text() for tick in ax.get_yticklabels()] == ["1", "2"]
    assert inspection.cracks is not None
    np.testing.assert_array_equal(
        overlay.get_array()[..., 3] > 0, inspection.cracks.probability > 0.5
    )


def test_only_a_suspected_cell_is_outlined(inspection: Inspection) -> None:
    ax = plots.cells(inspection)
    (box,) = (patch for patch in ax.patches if isinstance(patch, Rectangle))
    centre = np.array(box.get_xy()) + np.array([box.get_width(), box.get_height()]) / 2
    np.testing.assert_allclose(centre, [1.5, 0.5])  # row 1, column 2
    assert ax.get_title().startswith("cracks suspected in 1 of 6 cells, 5 clean")
    assert inspection.cracks is not None
    (label,) = ax.texts
    assert label.get_text().endswith(f"{inspection.cracks.cells[1].crack_length_cells:.2f}")
    unread = plots.cells(without(inspection, "cracks"))
    assert len(unread.images) == 1
    assert not unread.patches


def test_half_cells_keep_their_shape() -> None:
    from pv_inspect.geometry.grid import HrGrid
    from pv_inspect.geometry.layout import ModuleLayout

    inspection = made_inspection(tiles=None, cracks=None)
    assert inspection.reconstruction is not None
    grid = HrGrid.covering(ModuleLayout(4, 3, 2.0), 20.0, 4.0)
    image = np.random.default_rng(0).random(grid.shape, dtype=np.float32)
    made = replace(inspection.reconstruction, grid=grid, image=image)
    ax = plots.cells(replace(inspection, reconstruction=made))
    np.testing.assert_allclose(ax.get_yticks(), [0.25, 0.75, 1.25, 1.75])
    assert ax.get_aspect() == 1.0


def bars(ax: Any) -> Mapping[int, float]:
    return {round(b.get_x() + b.get_width() / 2): b.get_height() for b in ax.patches}


@pytest.mark.parametrize(
    ("gone", "expected", "unit"),
    [
        ((), {0: 1.0, 2: 1.2}, "noise"),
        (("reconstruction",), {0: 1.25, 2: 1.25}, "noise"),
        (("reconstruction", "registration"), {0: 0.1, 1: 0.1, 2: 0.1}, "LR px"),
    ],
)
def test_residuals_are_those_of_the_last_stage_that_looked_at_the_frames(
    inspection: Inspection, gone: Sequence[str], expected: dict[int, float], unit: str
) -> None:
    ax = plots.residuals(without(inspection, *gone))
    assert bars(ax) == pytest.approx(expected)
    assert f"[{unit}]" in ax.get_ylabel()
    assert ("noise alone" in legend(ax)) == (unit == "noise")
    assert ("not used" in legend(ax)) == (len(expected) < 3)
    if len(expected) < 3:
        np.testing.assert_array_equal(lines(ax)["not used"], [[1.0, 0.0]])


def test_what_is_not_there_yet_is_said_in_one_sentence(inspection: Inspection) -> None:
    empty = without(inspection, "crossings", "calibration", "registration", "reconstruction")
    for plot, stage in (
        (plots.grid, "detect"),
        (plots.cells, "reconstruct"),
        (plots.residuals, "calibrate"),
    ):
        with pytest.raises(InspectionError, match=f"run it at least to .* '{stage}'"):
            plot(empty)
    for frame in (-1, 3):
        with pytest.raises(InspectionError, match=f"no frame {frame} in a sequence of 3: give 0"):
            plots.grid(inspection, frame)
    assert not plt.get_fignums()


def test_without_matplotlib_one_sentence_names_the_extra(
    inspection: Inspection, monkeypatch: pytest.MonkeyPatch
) -> None:
    real = builtins.__import__

    def without_matplotlib(name: str, *rest: Any, **named: Any) -> Any:
        if name.split(".")[0] == "matplotlib":
            raise ImportError(name)
        return real(name, *rest, **named)

    monkeypatch.delitem(sys.modules, "pv_inspect.notebook.plots", raising=False)
    monkeypatch.setattr(builtins, "__import__", without_matplotlib)
    with pytest.raises(InspectionError, match=r"pip install 'pv-inspect\[notebook\]'"):
        pv_inspect.plots.cells(inspection)
