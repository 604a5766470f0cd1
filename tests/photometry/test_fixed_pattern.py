"""A pattern is found within what its uncertainty says, and where there is none none is made."""

from __future__ import annotations

import numpy as np
import pytest

from pv_inspect.photometry.fixed_pattern import (
    Estimate,
    columns_of_frames,
    fixed_columns,
    pixel_gains,
    shrink,
)
from pv_inspect.photometry.residual_sums import ResidualSums

SHAPE = (96, 160)
NOISE = 0.01
N = 12
SECOND = np.arange(N) % 2 == 1


def sums_of(
    offset: np.ndarray | float = 0.0,
    gain: np.ndarray | float = 0.0,
    of_frames: np.ndarray | None = None,
    scene_error: np.ndarray | None = None,
) -> ResidualSums:
    """Noise and pattern under a module of dark gaps that moves; an error that moves with it."""
    rng = np.random.default_rng(4)
    y, x = np.mgrid[: SHAPE[0], : SHAPE[1]]
    sums = ResidualSums.empty(N, SHAPE)
    for i in range(N):
        shift = 3 * i
        p = np.where((x + shift) % 20 < 2, 0.05, 0.4) * np.where((y + i) % 20 < 2, 0.3, 1.0)
        r = offset + gain * p + rng.normal(0, NOISE, SHAPE)
        if of_frames is not None:
            r += of_frames[i]
        if scene_error is not None:
            r += scene_error[shift : shift + SHAPE[1]]
        sums.add(
            i,
            bool(SECOND[i]),
            p.astype(np.float32),
            r.astype(np.float32),
            np.full(SHAPE, NOISE**-2, np.float32),
        )
    return sums


def white(seed: int, sigma: float, *shape: int) -> np.ndarray:
    return np.random.default_rng(seed).normal(0, sigma, shape)


def test_two_halves_of_noise_give_nothing() -> None:
    rng = np.random.default_rng(0)
    for _ in range(20):
        a, b = (Estimate(rng.normal(0, 1, 500), np.ones(500)) for _ in range(2))
        assert not shrink(a, b).any()


def test_shrinking_is_the_posterior_mean() -> None:
    rng = np.random.default_rng(1)
    truth = rng.normal(0, 1, 20000)
    a, b = (Estimate(truth + rng.normal(0, 2, truth.size), np.full(20000, 0.25)) for _ in range(2))
    shrunk = shrink(a, b)
    mean = (a.value + b.value) / 2
    # Variance 1 against the mean's 4 / 2.
    np.testing.assert_allclose(shrunk, mean / 3, atol=0.06 * np.abs(mean).max())
    assert ((shrunk - truth) ** 2).mean() == pytest.approx(2 / 3, rel=0.05)


def test_halves_that_differ_by_more_than_they_claim_are_trusted_less() -> None:
    rng = np.random.default_rng(2)
    truth = rng.normal(0, 1, 20000)
    values = [truth + rng.normal(0, 2, truth.size) for _ in range(2)]
    honest = shrink(*(Estimate(v, np.full(v.size, 0.25)) for v in values))
    boastful = shrink(*(Estimate(v, np.full(v.size, 25.0)) for v in values))
    np.testing.assert_allclose(boastful, honest, atol=0.1)


def test_too_few_columns_tell_nothing() -> None:
    few = Estimate(np.arange(10.0), np.ones(10))
    assert not shrink(few, few).any()


def test_offset_and_gain_of_columns_are_found_within_the_noise() -> None:
    offset, gain = white(5, 0.01, SHAPE[1]), white(6, 0.02, SHAPE[1])
    found_offset, found_gain = fixed_columns(sums_of(offset, gain), SECOND)
    # N * height pixels, p spreads by 0.13: the mean over columns around takes a little as well.
    assert (found_gain - gain).std() < 2.0 * NOISE / np.sqrt(N * SHAPE[0]) / 0.13
    level, truth = found_offset + 0.33 * found_gain, offset + 0.33 * gain
    assert (level - truth).std() < 0.25 * truth.std()
    assert np.corrcoef(level, truth)[0, 1] > 0.97


def test_a_sensor_without_pattern_is_left_alone() -> None:
    sums = sums_of()
    for estimate in (*fixed_columns(sums, SECOND), columns_of_frames(sums), pixel_gains(sums)):
        assert not estimate.any()


def test_columns_of_single_frames_are_found_within_the_noise() -> None:
    of_frames = white(7, 0.004, N, SHAPE[1])
    found = columns_of_frames(sums_of(of_frames=of_frames))
    error = NOISE / np.sqrt(SHAPE[0])
    assert (found - of_frames).std() < 1.5 * error


def test_gains_of_pixels_reduce_the_error_as_the_posterior_promises() -> None:
    gain = white(8, 0.01, *SHAPE)
    found = pixel_gains(sums_of(gain=gain))
    variance = NOISE**2 / (N * 0.33**2)
    expected = np.sqrt(1e-4 * variance / (1e-4 + variance))
    assert (found - gain).std() < 1.3 * expected < gain.std()


def test_an_error_that_moves_with_the_scene_is_no_pattern() -> None:
    error = white(9, 0.01, SHAPE[1] + 3 * N)
    sums = sums_of(scene_error=error)
    # Halves that have seen the scene at different places.
    apart = np.arange(N) >= N // 2
    offset, gain = fixed_columns(sums, apart)
    assert np.abs(offset + 0.33 * gain).max() < 0.3 * 0.01
