from __future__ import annotations

import cv2
import numpy as np
import pytest

from pv_inspect.cracks.training.scores import average_precision, coarse_score, pixel_score, roc_auc


def line(y: int) -> np.ndarray:
    mask = np.zeros((64, 64), np.uint8)
    cv2.line(mask, (0, y), (63, y), 1, 1)
    return mask > 0


def test_a_map_that_is_the_label_is_perfect() -> None:
    score = pixel_score([(line(20).astype(np.float32), line(20))])
    assert (score.ap, score.f1) == (pytest.approx(1), pytest.approx(1))


@pytest.mark.parametrize(("shift", "found"), [(1, True), (2, True), (3, False)])
def test_two_pixels_beside_the_label_are_right_and_three_are_not(shift: int, found: bool) -> None:
    score = pixel_score([(line(20 + shift).astype(np.float32), line(20))])
    assert score.f1 == pytest.approx(1.0 if found else 0.0, abs=0.05)


def test_half_found_and_half_wrong() -> None:
    p = 0.9 * line(20).astype(np.float32) + 0.9 * line(40)
    truth = line(20) | line(55)
    score = pixel_score([(p, truth)])
    assert score.f1 == pytest.approx(0.5)
    assert score.ap == pytest.approx(0.25)  # half of the precision up to half of the recall


def test_average_precision_is_the_textbook_one() -> None:
    score = np.array([0.9, 0.8, 0.7, 0.6])
    truth = np.array([True, False, True, False])
    assert average_precision(score, truth) == pytest.approx((1 + 2 / 3) / 2)
    # equal scores are one level: any order of them is the same
    assert average_precision(np.ones(4), truth) == pytest.approx(0.5)


def test_roc_auc_counts_pairs() -> None:
    truth = np.array([True, True, False, False])
    assert roc_auc(np.array([4.0, 2, 3, 1]), truth) == pytest.approx(0.75)
    assert roc_auc(np.zeros(4), truth) == pytest.approx(0.5)


def test_coarse_blocks_hide_small_shifts_and_count_instances() -> None:
    truth = line(5) | line(50)
    p = line(9).astype(np.float32) + line(34)
    score = coarse_score([(p, truth)], level=0.5)
    assert score.f1 == pytest.approx(0.5)
    assert score.instance_precision == pytest.approx(0.5)
    assert score.instance_recall == pytest.approx(0.5)
    assert score.instance_f1 == pytest.approx(0.5)
