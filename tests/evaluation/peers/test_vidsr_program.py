"""vidsr on frames of a known picture: it finds the motion, and the result lies in its place."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from pv_inspect.evaluation.peers.vidsr_program import _fused

vidsr = pytest.importorskip(
    "vidsr", reason="vidsr is not installed: pip install 'pv-inspect[peers]'"
)
SHIFTS = np.array([[0.0, 0.0], [0.4, -0.3], [1.3, 0.6], [-0.7, 1.2]])
SCALE = 2


def picture(x: NDArray[np.float64], y: NDArray[np.float64]) -> NDArray[np.float64]:
    waves = [(0.9, 0.2, 0.0), (0.1, 0.8, 1.0), (0.5, -0.6, 2.0), (0.25, 0.3, 0.5)]
    return np.asarray(0.5 + sum(0.08 * np.sin(a * x + b * y + c) for a, b, c in waves))


def test_the_result_lies_in_its_place_and_has_less_noise() -> None:
    rng = np.random.default_rng(0)
    y, x = np.mgrid[:56, :60].astype(np.float64)
    frames = [
        (picture(x - dx, y - dy) + 0.02 * rng.normal(size=x.shape)).astype(np.float32)
        for dx, dy in SHIFTS
    ]
    asked = vidsr.build_parser().parse_args(
        ["sr", "f", "--out", "o", "--rl", "0", "--unsharp", "0"]
    )
    found, corner = _fused(vidsr, asked, frames, 0, (18, 16, 24, 22), SCALE)
    assert corner == (15, 13)
    assert found.shape == (SCALE * 28, SCALE * 30)
    v, u = np.mgrid[: found.shape[0], : found.shape[1]]
    expected = picture(*((w + 0.5) / SCALE - 0.5 + c for w, c in zip((u, v), corner, strict=True)))
    inside = np.s_[6:-6, 6:-6]
    assert np.sqrt(np.mean((found - expected)[inside] ** 2)) < 0.02
    dy, dx = np.gradient(expected)
    terms = np.stack([part[inside].ravel() for part in (dx, dy)], axis=-1)
    moved = np.linalg.lstsq(terms, (found - expected)[inside].ravel(), rcond=None)[0]
    assert np.abs(moved).max() / SCALE < 0.05
