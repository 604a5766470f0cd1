"""Image metrics against closed forms and an independent implementation."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray
from skimage.metrics import peak_signal_noise_ratio

from pv_inspect.evaluation.image_metrics import (
    displacement,
    fitted,
    fourier_ring_correlation,
    image_score,
    ring_cutoff,
)

Image = NDArray[np.float32]


def scene(seed: int = 0, size: int = 96, sigma: float = 1.5) -> Image:
    rng = np.random.default_rng(seed)
    rough = cv2.GaussianBlur(rng.normal(size=(size, size)), (0, 0), sigma)
    return np.asarray(0.5 + 0.1 * rough / rough.std(), np.float32)


def test_a_method_that_returns_the_truth_has_no_error() -> None:
    cells = [scene(seed) for seed in range(3)]
    score = image_score([(cell, cell) for cell in cells], 4.0)
    assert score.psnr_db > 100
    assert score.ssim == pytest.approx(1.0, abs=1e-6)
    assert score.frc_cutoff == pytest.approx(2.0, abs=0.05)  # Nyquist of the grid
    assert np.abs(score.shift_px).max() < 0.01


def test_gain_and_offset_of_an_image_do_not_count() -> None:
    truth = scene()
    noisy = truth + np.random.default_rng(1).normal(0, 0.01, truth.shape).astype(np.float32)
    plain = image_score([(noisy, truth)], 4.0)
    scaled = image_score([(3 * noisy + 0.7, truth)], 4.0)
    assert scaled.psnr_db == pytest.approx(plain.psnr_db, abs=1e-3)
    assert scaled.flat_psnr_db == pytest.approx(plain.flat_psnr_db, abs=1e-3)


def test_psnr_is_that_of_scikit_image() -> None:
    truth = scene()
    noisy = truth + np.random.default_rng(2).normal(0, 0.02, truth.shape).astype(np.float32)
    peak = float(np.percentile(truth, 99.9))
    expected = peak_signal_noise_ratio(
        truth.astype(np.float64), fitted(noisy, truth), data_range=peak
    )
    assert image_score([(noisy, truth)], 4.0).psnr_db == pytest.approx(expected, abs=1e-6)


def test_the_fit_is_that_of_least_squares() -> None:
    rng = np.random.default_rng(3)
    image, truth = (rng.normal(size=(20, 30)).astype(np.float32) for _ in range(2))
    columns = np.stack([image.ravel(), np.ones(image.size)], axis=1).astype(np.float64)
    best = np.linalg.lstsq(columns, truth.ravel().astype(np.float64), rcond=None)[0]
    assert fitted(image, truth).ravel() == pytest.approx(columns @ best, abs=1e-6)


def test_slow_brightness_does_not_count_in_the_flat_figure() -> None:
    truth = scene()
    fall = np.linspace(0.9, 1.1, truth.shape[1], dtype=np.float32)
    score = image_score([(truth * fall, truth)], 4.0)
    assert score.flat_psnr_db > score.psnr_db + 6


@pytest.mark.parametrize("noise", [0.5, 1.0, 2.0])
def test_ring_correlation_of_white_images_is_their_closed_form(noise: float) -> None:
    """Of s + n1 and s + n2 with one variance of s: 1 / (1 + noise^2) at all frequencies."""
    rng = np.random.default_rng(4)
    pairs = []
    for _ in range(80):
        common = rng.normal(size=(64, 64))
        pairs.append(tuple(common + noise * rng.normal(size=(64, 64)) for _ in range(2)))
    _, found = fourier_ring_correlation(pairs, 1.0)  # type: ignore[arg-type]
    assert found[8:-2].mean() == pytest.approx(1 / (1 + noise**2), abs=0.02)


def test_the_cutoff_lies_between_the_rings_around_a_seventh() -> None:
    frequency = np.linspace(0, 1, 11)
    line = 1.0 - frequency  # a straight line stays itself under the smoothing
    assert ring_cutoff(frequency, line) == pytest.approx(1 - 1 / 7, abs=1e-9)
    assert ring_cutoff(frequency, np.ones(11)) == 1.0


def test_blur_lowers_the_cutoff() -> None:
    truth = np.random.default_rng(5).normal(size=(128, 128)).astype(np.float32)
    noise = np.random.default_rng(6).normal(size=truth.shape).astype(np.float32)
    cutoffs = [
        image_score([(cv2.GaussianBlur(truth, (0, 0), s) + 0.05 * noise, truth)], 4.0).frc_cutoff
        for s in (0.8, 1.6)
    ]
    assert cutoffs[0] > 1.5 * cutoffs[1]


@pytest.mark.parametrize("shift", [(0.5, 0.0), (-1.25, 0.75)])
def test_a_known_displacement_is_found(shift: tuple[float, float]) -> None:
    truth = scene(7, sigma=3.0)
    move = np.array([[1, 0, shift[0]], [0, 1, shift[1]]], np.float64)
    moved = cv2.warpAffine(
        truth, move, truth.shape[::-1], flags=cv2.INTER_CUBIC, borderMode=cv2.BORDER_REFLECT
    )
    assert displacement(np.asarray(moved, np.float32), truth) == pytest.approx(shift, abs=0.08)


def test_a_cell_of_one_value_has_no_displacement() -> None:
    assert np.isnan(displacement(np.full((40, 40), 0.5, np.float32), scene(size=40))).all()
