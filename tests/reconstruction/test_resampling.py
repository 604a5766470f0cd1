"""An image on another grid shows the same place of the module in the same place."""

from __future__ import annotations

import numpy as np
import pytest

from pv_inspect.geometry.grid import HrGrid
from pv_inspect.geometry.layout import ModuleLayout
from pv_inspect.reconstruction.resampling import resampled

LAYOUT = ModuleLayout(2, 3)


def ramp(grid: HrGrid) -> np.ndarray:
    """The module's own coordinates, 2 x + y, as an image."""
    rows, cols = np.indices(grid.shape)
    at = grid.to_module(np.stack([cols, rows], axis=-1).astype(float))
    return (2 * at[..., 0] + at[..., 1]).astype(np.float32)


@pytest.mark.parametrize("magnification", [1.0, 3.0, 3.3, 4.0])
def test_a_ramp_stays_where_it_is(magnification: float) -> None:
    known, grid = (HrGrid.covering(LAYOUT, 20.0, m) for m in (2.0, magnification))
    found = resampled(ramp(known), known, grid)
    inner = slice(5, -5)
    # OpenCV's cubic (a = -0.75) bends a ramp by some hundredths of a pixel per axis.
    bound = (2 + 1) * 0.05 / known.pixels_per_unit
    np.testing.assert_allclose(found[inner, inner], ramp(grid)[inner, inner], atol=bound)


def test_a_window_is_cut_out_as_it_is() -> None:
    known = HrGrid.covering(LAYOUT, 20.0, 2.0)
    image = np.random.default_rng(3).random(known.shape, np.float32)
    part = (slice(4, 31), slice(7, 50))
    np.testing.assert_array_equal(resampled(image, known, known.window(*part)), image[part])
