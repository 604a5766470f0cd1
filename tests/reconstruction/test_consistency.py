"""Residuals of the frames, gathered on the module."""

from __future__ import annotations

import numpy as np
import pytest

from pv_inspect.geometry.grid import HrGrid
from pv_inspect.geometry.layout import ModuleLayout
from pv_inspect.reconstruction.consistency import Consistency

GRID = HrGrid(ModuleLayout(1, 1), 100.0, (10.0, 10.0), (120, 130), 4.0)


def positions(shape: tuple[int, int] = (30, 32)) -> np.ndarray:
    y, x = np.mgrid[: shape[0], : shape[1]].astype(np.float64)
    return np.stack([4.0 * x + 1.0, 4.0 * y + 1.5], axis=-1)


def test_noise_of_the_right_size_reads_one() -> None:
    rng = np.random.default_rng(1)
    gathered = Consistency(GRID)
    for _ in range(40):
        residual = rng.standard_normal((30, 32)).astype(np.float32)
        rms = gathered.add(positions(), residual, np.ones((30, 32), bool))
        assert rms == pytest.approx(1.0, abs=0.15)
    assert gathered.map() == pytest.approx(1.0, abs=0.25)
    assert gathered.map().shape == GRID.shape
    assert gathered.map().mean() == pytest.approx(1.0, abs=0.02)


def test_a_contradiction_is_shown_in_its_place() -> None:
    rng = np.random.default_rng(2)
    gathered = Consistency(GRID)
    for _ in range(10):
        residual = rng.standard_normal((30, 32)).astype(np.float32)
        residual[12:15, 20:23] += 6.0
        gathered.add(positions(), residual, np.ones((30, 32), bool))
    shown = gathered.map()
    y, x = np.unravel_index(shown.argmax(), shown.shape)
    assert abs(y - (4 * 13 + 1.5)) < 5
    assert abs(x - (4 * 21 + 1.0)) < 5
    assert shown[20, 20] < 1.6


def test_pixels_that_do_not_count_say_nothing() -> None:
    gathered = Consistency(GRID)
    used = np.zeros((30, 32), bool)
    rms = gathered.add(positions(), np.full((30, 32), 99.0, np.float32), used)
    assert np.isnan(rms)
    assert (gathered.map() == 0).all()


def test_frames_may_come_in_any_order() -> None:
    rng = np.random.default_rng(3)
    frames = [rng.standard_normal((30, 32)).astype(np.float32) for _ in range(5)]
    used = np.ones((30, 32), bool)
    one, two = Consistency(GRID), Consistency(GRID)
    for residual in frames:
        one.add(positions(), residual, used)
    for residual in reversed(frames):
        two.add(positions(), residual, used)
    np.testing.assert_allclose(one.map(), two.map(), rtol=1e-6)
