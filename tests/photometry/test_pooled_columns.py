"""The pattern of a camera's columns is pooled over sequences, and acts as a prior."""

from __future__ import annotations

import numpy as np
import pytest

from pv_inspect.photometry.fixed_pattern import columns_of_halves, fixed_columns
from pv_inspect.photometry.pooled_columns import column_outliers, pooled_columns
from tests.photometry.test_fixed_pattern import NOISE, SECOND, SHAPE, N, sums_of, white

OFFSET, GAIN = white(5, 0.004, SHAPE[1]), white(6, 0.01, SHAPE[1])
"""About the noise of a mean over a column."""


def sums_of_sequence(seed: int, offset: np.ndarray, gain: np.ndarray) -> np.ndarray:
    """Sums over a column as `sums_of` gives them, with noise of this sequence."""
    sums = sums_of(offset, gain).of_columns(SECOND)
    count, light, light2 = sums[0, 0], sums[0, 1], sums[0, 2]
    rng = np.random.default_rng(seed)
    # The noise of MISFIT and PRODUCT has the covariance [[w, wp], [wp, wpp]].
    a, b = rng.normal(size=(2, 2, SHAPE[1]))
    sums[:, 3] += 3 * np.sqrt(count) * a
    sums[:, 4] += 3 * (light / np.sqrt(count) * a + np.sqrt(light2 - light**2 / count) * b)
    return sums.astype(np.float32)


@pytest.fixture(scope="module")
def each() -> list[np.ndarray]:
    return [sums_of_sequence(seed, OFFSET, GAIN) for seed in range(8)]


def test_many_sequences_know_the_columns_better_than_one(each: list[np.ndarray]) -> None:
    light = each[0][0, 1] / each[0][0, 0]
    truth = OFFSET + GAIN * light
    truth -= np.convolve(truth, np.ones(41) / 41, "same")
    errors = []
    for sums in (each[:1], each):
        found = pooled_columns(sums)
        assert found is not None
        errors.append(np.std(found.level - truth))
        # As large as it says, apart from the mean over the columns around.
        assert 0.5 < errors[-1] / np.sqrt((found.level_error**2).mean()) < 2.5
    assert errors[1] < 0.6 * errors[0]


def test_sequences_without_a_common_pattern_have_none() -> None:
    flat = np.zeros(SHAPE[1])
    assert pooled_columns([sums_of_sequence(k, flat, flat) for k in range(4)]) is None
    assert pooled_columns([]) is None


def test_a_sequence_of_another_camera_is_told(each: list[np.ndarray]) -> None:
    other = sums_of_sequence(20, white(30, 0.004, SHAPE[1]), white(31, 0.01, SHAPE[1]))
    assert column_outliers([*each[:4], other, *each[4:]]) == (4,)
    assert column_outliers(each) == ()
    assert column_outliers([*each[:2], other]) == ()


def test_a_known_pattern_is_refined_within_its_uncertainty_and_corrected_beyond(
    each: list[np.ndarray],
) -> None:
    known = pooled_columns(each)
    assert known is not None
    # Taken out of frames that have it, hardly anything is left.
    same = sums_of(OFFSET, GAIN)
    same.take_out_columns(known.offset, known.gain)
    offset, gain = fixed_columns(same, SECOND, known)
    assert np.std(offset + gain * known.light) < 1.5 * np.sqrt((known.level_error**2).mean())
    assert (offset + gain * known.light).any()
    # Another camera: the data take it back.
    another = sums_of()
    another.take_out_columns(known.offset, known.gain)
    offset, gain = fixed_columns(another, SECOND, known)
    left = known.level + offset + gain * known.light
    assert np.std(left) < 0.2 * np.std(known.level)


def test_a_pattern_that_is_not_there_leaves_what_was_given() -> None:
    halves = sums_of().of_columns(SECOND)
    found = columns_of_halves(halves)
    assert not found.level.any()
    assert not found.level_error.any()
    certain = pooled_columns([sums_of_sequence(k, OFFSET, GAIN) for k in range(2)])
    assert certain is not None
    again = columns_of_halves(halves, certain)
    noise = NOISE / np.sqrt(N * SHAPE[0])
    # The posterior of a prior and a measurement is narrower than both.
    assert (again.level_error < noise * 1.01).all()
    assert (again.level_error < certain.level_error).all()
