"""Evenly spaced dark lines are found in their direction, whatever else a frame shows."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from pv_inspect.detection.even_lines import even_lines

SIDE = 200
CENTRE = (100.0, 100.0)


def _lined(degrees: float, period: float, offset: float, noise: float) -> NDArray[np.float32]:
    turn = np.radians(degrees)
    y, x = np.mgrid[:SIDE, :SIDE].astype(float)
    from_line = (np.cos(turn) * x + np.sin(turn) * y - offset + period / 2) % period - period / 2
    image = 1 - 0.3 * np.exp(-0.5 * from_line**2)
    grain = np.random.default_rng(0).normal(0, noise, image.shape)
    return np.asarray(image + grain, np.float32)


@pytest.mark.parametrize("degrees", [-6.0, 0.0, 5.0])
def test_noise_does_not_draw_the_direction_to_that_of_the_pixels(degrees: float) -> None:
    # A window that is not turned is not interpolated: its noise is the sharpest.
    best = even_lines(_lined(degrees, 31.0, 12.0, 0.06), CENTRE, 90, upright=True)[0]
    assert np.degrees(np.arctan2(*best.normal[::-1])) == pytest.approx(degrees, abs=2.0)
    assert best.period == pytest.approx(31.0, abs=1.0)
    apart = (best.offset - 12.0 + 31.0 / 2) % 31.0 - 31.0 / 2
    assert abs(apart) < 2.5


def test_fewer_lines_are_not_preferred_to_all_of_them() -> None:
    found = even_lines(_lined(90.0, 31.0, 12.0, 0.02), CENTRE, 90, upright=False)
    assert found[0].period == pytest.approx(31.0, abs=1.0)
    assert any(lines.period == pytest.approx(62.0, abs=2.0) for lines in found[1:])


def test_the_same_lines_are_told_once() -> None:
    found = even_lines(_lined(0.0, 31.0, 12.0, 0.02), CENTRE, 90, upright=True)
    near = [one for one in found if abs(one.period / 31 - 1) < 0.02]
    assert len(near) == 1
