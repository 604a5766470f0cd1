from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from pv_inspect.reconstruction.preconditioner import Spectral

Image = NDArray[np.floating]
SHAPE = (70, 94)


def blurred_twice(f: Image) -> Image:
    return np.asarray(gaussian_filter(gaussian_filter(f, 1.2), 1.2) + 0.02 * f, f.dtype)


def weights() -> Image:
    return np.random.default_rng(3).uniform(0.5, 2.0, SHAPE)


def test_it_is_symmetric_and_positive() -> None:
    root = weights()
    spectral = Spectral.of(blurred_twice, root)
    rng = np.random.default_rng(4)
    for _ in range(5):
        a, b = rng.standard_normal((2, *SHAPE))
        ab, ba = np.vdot(a, spectral.apply(b, root)), np.vdot(b, spectral.apply(a, root))
        assert ab == pytest.approx(ba, abs=1e-9 * np.linalg.norm(a) * np.linalg.norm(b))
        assert np.vdot(a, spectral.apply(a, root)) > 0


def test_it_inverts_a_convolution_away_from_the_border() -> None:
    f = np.zeros(SHAPE)
    f[25:45, 30:60] = np.random.default_rng(5).standard_normal((20, 30))
    f = gaussian_filter(f, 1.0)
    ones = np.ones(SHAPE)
    back = Spectral.of(blurred_twice, ones).apply(blurred_twice(f), ones)
    assert np.linalg.norm(back - f) < 0.25 * np.linalg.norm(f)


def test_it_is_the_same_every_time_and_keeps_float32() -> None:
    root = weights().astype(np.float32)
    r = np.random.default_rng(6).standard_normal(SHAPE).astype(np.float32)
    one, two = (Spectral.of(blurred_twice, root).apply(r, root) for _ in range(2))
    assert one.dtype == np.float32
    np.testing.assert_array_equal(one, two)


def test_an_operator_that_loses_frequencies_leaves_it_finite() -> None:
    ones = np.ones(SHAPE)
    out = Spectral.of(lambda f: gaussian_filter(f, 4.0), ones).apply(weights(), ones)
    assert np.isfinite(out).all()
