from __future__ import annotations

import numpy as np
import pytest

from pv_inspect.photometry.residual_sums import (
    BAND_ROWS,
    COUNT,
    LIGHT2,
    PRODUCT,
    ResidualSums,
    halves_along,
)

SHAPE = (40, 24)


def frames(n: int) -> list[tuple[np.ndarray, np.ndarray, np.ndarray]]:
    rng = np.random.default_rng(1)
    return [
        tuple(a.astype(np.float32) for a in (p, r, w))  # type: ignore[misc]
        for p, r, w in zip(
            rng.uniform(0, 1, (n, *SHAPE)),
            rng.normal(0, 0.01, (n, *SHAPE)),
            rng.uniform(0, 2, (n, *SHAPE)),
            strict=True,
        )
    ]


def summed(parts: list[tuple[np.ndarray, np.ndarray, np.ndarray]]) -> ResidualSums:
    sums = ResidualSums.empty(len(parts), SHAPE)
    for k, (p, r, w) in enumerate(parts):
        sums.add(k, k % 2 == 1, p, r, w)
    return sums


def test_bands_and_halves_add_up_to_the_direct_sums() -> None:
    parts = frames(4)
    sums = summed(parts)
    p, r, w = (np.array(a) for a in zip(*parts, strict=True))
    np.testing.assert_allclose(sums.pixels[1, LIGHT2], (w * p * p)[1::2].sum(0), rtol=1e-5)
    assert sums.bands.shape == (4, 5, 3, SHAPE[1])
    np.testing.assert_allclose(sums.bands[2, COUNT, 2], w[2, 2 * BAND_ROWS :].sum(0), rtol=1e-5)
    np.testing.assert_allclose(
        sums.bands[:, PRODUCT].sum((0, 1)), sums.pixels[:, PRODUCT].sum((0, 1)), atol=1e-4
    )
    assert (w * p * r).sum() == pytest.approx(float(sums.bands[:, PRODUCT].sum()), abs=1e-3)


def test_taking_columns_out_of_the_sums_is_taking_them_out_of_the_residuals() -> None:
    parts = frames(4)
    rng = np.random.default_rng(2)
    offset, gain = rng.normal(0, 0.1, SHAPE[1]), rng.normal(0, 0.1, SHAPE[1])
    corrected = [(p, (r - offset - gain * p).astype(np.float32), w) for p, r, w in parts]
    left, expected = summed(parts), summed(corrected)
    left.take_out_columns(offset, gain)
    np.testing.assert_allclose(left.bands, expected.bands, atol=1e-4)
    np.testing.assert_allclose(left.pixels, expected.pixels, atol=1e-4)


def test_offsets_of_single_frames_leave_their_bands_only() -> None:
    parts = frames(4)
    offset = np.random.default_rng(3).normal(0, 0.1, (4, SHAPE[1]))
    corrected = [
        (p, (r - o).astype(np.float32), w) for (p, r, w), o in zip(parts, offset, strict=True)
    ]
    left = summed(parts)
    left.take_out_columns(offset, np.zeros(SHAPE[1]))
    np.testing.assert_allclose(left.bands, summed(corrected).bands, atol=1e-4)
    np.testing.assert_array_equal(left.pixels, summed(parts).pixels)


def test_halves_lie_on_either_side_of_the_motion() -> None:
    positions = np.column_stack([np.arange(6.0), np.zeros(6)])[[3, 0, 5, 1, 4, 2]]
    second, distance = halves_along(positions, np.array([1.0, 0.0]))
    np.testing.assert_array_equal(second, [True, False, True, False, True, False])
    assert distance == pytest.approx(3.0)
    assert halves_along(positions, np.array([0.0, 1.0]))[1] == 0.0
