from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from pv_inspect.common.work import result_of
from pv_inspect.detection.detect import detect
from pv_inspect.detection.filled_frame import module_to_the_edge
from pv_inspect.detection.outline import OutlineError
from pv_inspect.detection.single_frame import RUNS_OVER, find_module
from pv_inspect.geometry.layout import ModuleLayout
from pv_inspect.sequence.sequence import FrameSequence
from pv_inspect.simulate import SimulationSettings, simulated

LAYOUT = ModuleLayout(4, 6)
Image = NDArray[np.float32]


@pytest.fixture(scope="module")
def photograph() -> tuple[Image, NDArray[np.float64]]:
    """A photograph with dark around the module, and its crossing points (5, 7, 2)."""
    settings = SimulationSettings(
        seed=4, rows=4, cols=6, n_frames=1, width=320, height=240, kappa=-0.05, tilt_deg=2,
        roll_deg=0.5, fill=0.85, pixels_per_unit=80, supersampling=2, dark_cell_share=0.0,
        busbars=6, busbar_style="dashed",
    )  # fmt: skip
    true = simulated(settings)
    image = (true.frames[0].astype(np.float32) - 64) / 4031
    return image, true.crossings_px(0).reshape(5, 7, 2)


def _cropped(image: Image, low: NDArray[np.float64], high: NDArray[np.float64]) -> Image:
    (x0, y0), (x1, y1) = np.round(low).astype(int), np.round(high).astype(int)
    return np.ascontiguousarray(image[y0 : y1 + 1, x0 : x1 + 1])


@pytest.mark.parametrize("margin", [0.0, 2.5])
def test_a_module_that_fills_the_image_is_found(
    photograph: tuple[Image, NDArray[np.float64]], margin: float
) -> None:
    image, points = photograph
    points = points.reshape(-1, 2)
    low, high = points.min(axis=0) - margin, points.max(axis=0) + margin
    cropped = _cropped(image, low, high)
    found = module_to_the_edge(cropped, LAYOUT).crossings
    error = found.points_px + np.round(low) - points
    turned = found.points_px[::-1] + np.round(low) - points
    squares = min(np.square(e)[found.measured].sum(axis=1).mean() for e in (error, turned))
    assert found.measured.mean() > 0.4
    assert np.sqrt(squares) < 0.5
    with pytest.raises(OutlineError):
        find_module(cropped, LAYOUT)


@pytest.mark.parametrize("missing", [0.3, 0.6, 1.0])
@pytest.mark.parametrize("axis", [0, 1])
def test_a_module_that_goes_on_outside_of_the_image_is_none(
    photograph: tuple[Image, NDArray[np.float64]], missing: float, axis: int
) -> None:
    image, points = photograph
    every = points.reshape(-1, 2)
    low, high = every.min(axis=0) - 1, every.max(axis=0) + 1
    cell = (points[1, 0, 1] - points[0, 0, 1], points[0, 1, 0] - points[0, 0, 0])[axis]
    high[1 - axis] -= missing * cell
    cut = _cropped(image, low, high)
    with pytest.raises(OutlineError, match=RUNS_OVER):
        module_to_the_edge(cut, LAYOUT)
    if missing < 1:  # the rows that are whole, beside a part of the next one
        fewer = ModuleLayout(3, 6) if axis == 0 else ModuleLayout(4, 5)
        with pytest.raises(OutlineError, match=RUNS_OVER):
            module_to_the_edge(cut, fewer)


@pytest.mark.parametrize(("rows", "cols"), [(3, 6), (5, 6), (4, 5), (4, 7)])
def test_other_rows_and_columns_are_not_found(
    photograph: tuple[Image, NDArray[np.float64]], rows: int, cols: int
) -> None:
    image, points = photograph
    points = points.reshape(-1, 2)
    cropped = _cropped(image, points.min(axis=0) - 3, points.max(axis=0) + 3)
    with pytest.raises(OutlineError, match=RUNS_OVER):
        module_to_the_edge(cropped, ModuleLayout(rows, cols))


def test_a_photograph_without_surround_goes_through_the_stage(
    photograph: tuple[Image, NDArray[np.float64]], tmp_path: Path
) -> None:
    image, points = photograph
    points = points.reshape(-1, 2)
    cropped = _cropped(image, points.min(axis=0), points.max(axis=0))
    cv2.imwrite(str(tmp_path / "photograph.png"), (60000 * cropped.clip(0, 1)).astype(np.uint16))
    (frame,) = result_of(detect(FrameSequence.open(tmp_path), LAYOUT)).frames
    assert frame.why == ""
