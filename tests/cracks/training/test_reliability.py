from __future__ import annotations

import numpy as np
import pytest

from pv_inspect.cracks.features import OperatingPoint
from pv_inspect.cracks.training.labelled_maps import alarms, operating_point
from pv_inspect.cracks.training.reliability import fit_calibration, reliability


def drawn(n: int, slope: float, offset: float) -> tuple[np.ndarray, np.ndarray]:
    """Labels that occur as often as a known distortion of the probabilities says."""
    rng = np.random.default_rng(0)
    log_odds = rng.normal(0, 3, (n, n))
    true = 1 / (1 + np.exp(-(slope * log_odds + offset)))
    return (1 / (1 + np.exp(-log_odds))).astype(np.float32), rng.random((n, n)) < true


@pytest.mark.parametrize(("slope", "offset"), [(1.0, 0.0), (0.6, -1.0), (1.5, 0.7)])
def test_the_calibration_is_what_distorted_the_probabilities(slope: float, offset: float) -> None:
    assert fit_calibration([drawn(500, slope, offset)]) == pytest.approx((slope, offset), abs=0.03)


def test_reliability_is_perfect_only_where_what_is_said_happens() -> None:
    right, wrong = reliability([drawn(500, 1, 0)]), reliability([drawn(500, 0.6, -1)])
    assert right.error < 0.01 < 0.1 < wrong.error
    np.testing.assert_allclose(right.said, right.seen, atol=0.02)
    assert right.pixels.sum() == 250000


def test_the_operating_point_has_the_recall_with_the_fewest_alarms() -> None:
    mask = np.zeros((200, 200), bool)
    mask[100, 40:160] = True
    speck = np.zeros((200, 200), np.float32)
    speck[20, 20:28] = 0.9
    cells = [(0.32 * mask.astype(np.float32), mask)] * 3 + [(speck, np.zeros_like(mask))] * 3
    point = operating_point(cells)
    assert alarms(cells, point) == (1.0, 0.0)
    assert point.threshold < 0.32
    assert point.least_extent_cells > 0.04
    assert alarms(cells, OperatingPoint(0.5, 0.02)) == (0.0, 1.0)
