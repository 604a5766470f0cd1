from __future__ import annotations

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from pv_inspect.sequence.sensor import (
    black_level,
    column_offsets,
    defective_pixels,
    effective_depth,
    fill_pixels,
    flat_field,
    temporal_median,
)

SHAPE = (128, 160)
FULL_SCALE = 4095.0


def textured_stack(
    count: int, step: float, psf_sigma: float = 0.5, seed: int = 0
) -> NDArray[np.uint16]:
    """Fine random detail seen through optics and pixel aperture, moved ``step`` px per frame."""
    rng = np.random.default_rng(seed)
    k = 8  # samples per pixel
    height, width = SHAPE
    # Single bright and dark points, the hardest detail there is, on a smooth bright ground.
    points = np.zeros(((height + 8) * k, (width + 60) * k), np.float32)
    at = rng.integers(0, points.size, 250)
    points.ravel()[at] = rng.choice([-1.0, 1.0], at.size) * 1200 * k * k
    blurred = cv2.GaussianBlur(points, (0, 0), psf_sigma * k)
    frames = []
    for i in range(count):
        shift = round(i * step * k)
        cut = blurred[:, shift : shift + width * k][: height * k]
        pixels = cut.reshape(height, k, width, k).mean(axis=(1, 3))
        clean = np.clip(1500.0 + pixels, 64.0, 4000.0)
        frames.append(np.rint(clean + rng.normal(0.0, 8.0, SHAPE)).astype(np.uint16))
    return np.stack(frames)


# -- bit depth ------------------------------------------------------------------------------


@given(st.sampled_from([10, 12, 14, 16]), st.booleans())
def test_the_depth_of_a_saturated_camera_is_found_in_either_alignment(
    depth: int, left: bool
) -> None:
    shift = 16 - depth if left else 0
    full = (2**depth - 1) << shift
    assert effective_depth(full, full, 16) == (depth, float(full))


def test_left_aligned_values_below_saturation_keep_the_full_scale_of_their_depth() -> None:
    assert effective_depth(50_000 & ~15, 0xFFF0, 16) == (12, 65520.0)


@pytest.mark.parametrize(
    ("maximum", "used_bits", "stored", "expected"),
    [
        (200, 255, 8, (8, 255.0)),
        (0, 0, 8, (8, 255.0)),
        (0, 0, 16, (16, 65535.0)),
        (250, 255, 16, (8, 255.0)),
        (3900, 4095, 16, (12, 4095.0)),
        (4096, 8191, 16, (14, 16383.0)),
        (640, 640, 16, (10, 1023.0)),
        (65535, 65535, 16, (16, 65535.0)),
    ],
)
def test_the_depth_is_the_smallest_that_holds_the_values(
    maximum: int, used_bits: int, stored: int, expected: tuple[int, float]
) -> None:
    assert effective_depth(maximum, used_bits, stored) == expected


# -- black level ----------------------------------------------------------------------------


def test_black_is_the_night_around_the_module() -> None:
    image = np.full(SHAPE, 70.0, np.float32)
    image[30:100, 30:130] = 1800.0
    image += np.random.default_rng(1).normal(0.0, 2.0, SHAPE).astype(np.float32)
    assert black_level(image) == pytest.approx(70.0, abs=2.0)


def test_an_image_full_of_module_does_not_turn_negative() -> None:
    y, x = np.mgrid[: SHAPE[0], : SHAPE[1]]
    image = (1500.0 + 300.0 * np.sin(x / 9.0) * np.cos(y / 7.0)).astype(np.float32)
    assert float((image < black_level(image)).mean()) < 0.03


def test_single_dead_pixels_do_not_set_the_black_level() -> None:
    image = np.full(SHAPE, 100.0, np.float32)
    image[::6, ::6] = 0.0
    assert black_level(image) == pytest.approx(100.0)


def test_the_temporal_median_is_that_of_numpy_for_large_stacks_too() -> None:
    stack = np.random.default_rng(2).integers(0, 4096, (9, 700, 800)).astype(np.uint16)
    np.testing.assert_array_equal(temporal_median(stack), np.median(stack, axis=0))


# -- column pattern -------------------------------------------------------------------------


def night_and_module(columns: NDArray[np.float64]) -> NDArray[np.uint16]:
    rng = np.random.default_rng(7)
    frames = np.full((10, *SHAPE), 80.0)
    for i in range(10):
        frames[i, 40:90, 30 + i : 110 + i] = 1500.0 + 200.0 * rng.standard_normal((50, 80))
    noisy: NDArray[np.uint16] = (frames + columns + rng.normal(0, 5, frames.shape)).astype(
        np.uint16
    )
    return noisy


def test_the_offsets_of_the_columns_are_read_off_the_night() -> None:
    truth = np.random.default_rng(8).normal(0.0, 8.0, SHAPE[1])
    truth[::25] += 60.0
    found = column_offsets(night_and_module(truth), FULL_SCALE)
    error = found - truth
    # What is left is slow: streaks are gone.
    assert float(np.diff(error).std()) < 0.1 * float(np.diff(truth).std())
    assert found.dtype == np.float32


def test_without_a_pattern_or_without_night_no_column_is_touched() -> None:
    assert not column_offsets(night_and_module(np.zeros(SHAPE[1])), FULL_SCALE).any()
    columns = np.random.default_rng(9).normal(0.0, 8.0, SHAPE[1])
    module = textured_stack(6, 2.3) + columns
    rows = 400.0 * np.sin(np.arange(SHAPE[0]) / 6.0)[:, None]
    full = np.clip(module + rows, 0, 4095).astype(np.uint16)
    assert not column_offsets(full, FULL_SCALE).any()


# -- defective pixels -----------------------------------------------------------------------


@pytest.mark.parametrize("step", [0.0, 0.2, 2.3])
@pytest.mark.parametrize("count", [1, 2, 3, 12])
@pytest.mark.parametrize("psf_sigma", [0.4, 0.7])
def test_no_real_detail_is_called_defective(count: int, step: float, psf_sigma: float) -> None:
    stack = textured_stack(count, step, psf_sigma)
    share = float(defective_pixels(stack, FULL_SCALE).mean())
    assert share <= 1e-4


@pytest.mark.parametrize("count", [5, 20])
def test_hot_and_dead_pixels_are_found_in_moving_detail(count: int) -> None:
    stack = textured_stack(count, 2.3)
    rng = np.random.default_rng(3)
    truth = np.zeros(SHAPE, bool)
    truth.ravel()[rng.choice(truth.size, 40, replace=False)] = True
    rows, cols = np.nonzero(truth)
    hot = np.arange(rows.size) % 2 == 0
    stack[:, rows[hot], cols[hot]] += 800
    stack[:, rows[~hot], cols[~hot]] = 0
    found = defective_pixels(stack, FULL_SCALE)
    assert int((found & truth).sum()) >= 38
    assert int((found & ~truth).sum()) <= 2


def test_extremes_are_found_in_a_single_frame() -> None:
    stack = np.full((1, *SHAPE), 1000, np.uint16)
    stack += np.random.default_rng(4).integers(0, 30, stack.shape).astype(np.uint16)
    stack[0, 40, 40], stack[0, 60, 90] = 4095, 0
    assert np.argwhere(defective_pixels(stack, FULL_SCALE)).tolist() == [[40, 40], [60, 90]]


def test_extremes_on_lines_and_edges_are_found_in_a_single_frame() -> None:
    """A busbar and the border of a cell carry a part of the deviation to the neighbours."""
    rng = np.random.default_rng(6)
    light = np.full(SHAPE, 1600.0)
    light[40] = light[:, 80] = 900.0
    light[:, 120:] = 300.0
    frame = rng.normal(cv2.GaussianBlur(light, (0, 0), 0.6), 8.0).astype(np.uint16)
    bad = [(20, 119), (40, 30), (60, 80), (90, 120)]
    for k, at in enumerate(bad):
        frame[at] = 0 if k % 2 == 0 else 4095
    assert np.argwhere(defective_pixels(frame[None], FULL_SCALE)).tolist() == [list(a) for a in bad]


def test_two_hot_neighbours_are_both_found() -> None:
    stack = textured_stack(8, 2.3)
    stack[:, 50, 50:52] = 3900
    found = defective_pixels(stack, FULL_SCALE)
    assert found[50, 50:52].all()


def test_columns_and_edges_are_no_defects() -> None:
    rng = np.random.default_rng(5)
    stack = rng.normal(1000.0, 6.0, (8, *SHAPE))
    stack[:, :, 50] += 300.0
    stack[:, 70, :] -= 300.0
    stack[:, 100:, 100:] += 1500.0
    assert not defective_pixels(stack.astype(np.uint16), FULL_SCALE).any()


# -- filling --------------------------------------------------------------------------------


def test_filled_pixels_take_the_mean_of_valid_neighbours_and_others_stay() -> None:
    y, x = np.mgrid[:20, :30]
    plane = (0.01 * x + 0.02 * y).astype(np.float32)
    bad = np.zeros(plane.shape, bool)
    bad[10, 15] = bad[0, 0] = bad[4, 4] = bad[4, 5] = True
    image = np.where(bad, 9.0, plane).astype(np.float32)
    filled = fill_pixels(image, bad, ~bad)
    np.testing.assert_array_equal(filled[~bad], plane[~bad])
    assert filled[10, 15] == pytest.approx(plane[10, 15], abs=1e-6)
    np.testing.assert_allclose(filled, plane, atol=0.03)
    assert image[10, 15] == 9.0


def test_a_pixel_without_valid_neighbours_keeps_its_value() -> None:
    image = np.full((20, 20), 0.5, np.float32)
    bad = np.zeros(image.shape, bool)
    bad[10, 10] = True
    filled = fill_pixels(image, bad, np.zeros(image.shape, bool))
    np.testing.assert_array_equal(filled, image)


# -- flat field -----------------------------------------------------------------------------


def test_a_flat_field_is_the_response_over_its_bright_median() -> None:
    x = np.linspace(-1.0, 1.0, SHAPE[1])
    response = np.broadcast_to(1.0 - 0.3 * x**2, SHAPE)
    black = np.full(SHAPE[1], 64.0, np.float32)
    flat = np.rint(64.0 + 2000.0 * response).astype(np.uint16)
    flat[7, 9] = 64
    found = flat_field(flat, black, FULL_SCALE)
    assert found[7, 9] == 0.0
    assert np.median(found) == pytest.approx(1.0, abs=5e-3)
    seen = found > 0
    np.testing.assert_allclose(found[seen] / found.max(), response[seen], atol=1e-3)


@pytest.mark.parametrize(
    ("level", "dark_share", "why"),
    [
        (0.0, 0.0, "is too dark"),
        (150.0, 0.0, "is too dark"),
        (4095.0, 0.0, "100 % saturated"),
        (2000.0, 0.1, "is dark in 10 % of its pixels"),
    ],
)
def test_what_is_no_flat_field_is_refused(level: float, dark_share: float, why: str) -> None:
    flat = np.full(SHAPE, level, np.uint16)
    flat[: round(dark_share * SHAPE[0])] = 0
    with pytest.raises(ValueError, match=why):
        flat_field(flat, np.zeros(SHAPE[1], np.float32), FULL_SCALE)
