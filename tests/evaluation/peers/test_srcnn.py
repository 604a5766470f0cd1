"""SRCNN: the convolutions against SciPy, and what the network does to a picture."""

from __future__ import annotations

import cv2
import numpy as np
from scipy.ndimage import correlate

from pv_inspect.evaluation.peers.convolution import convolved
from pv_inspect.evaluation.peers.srcnn import srcnn


def test_a_layer_is_a_sum_of_correlations() -> None:
    rng = np.random.default_rng(0)
    maps = rng.normal(size=(3, 40, 21)).astype(np.float32)
    weights = rng.normal(size=(2, 3, 5, 5)).astype(np.float32)
    bias = np.array([0.5, -1.0], np.float32)
    found = convolved(maps, weights, bias, "edge")
    for k in range(2):
        terms = [correlate(m, w, mode="nearest") for m, w in zip(maps, weights[k], strict=True)]
        assert np.allclose(found[k], np.sum(terms, axis=0) + bias[k], atol=1e-4)


def test_a_picture_of_one_value_nearly_stays_itself() -> None:
    found = srcnn(np.full((20, 24), 0.5, np.float32), 3)
    assert found.shape == (60, 72)
    assert np.abs(found[12:-12, 12:-12] - 0.5).max() < 0.02


def test_an_edge_becomes_sharper_and_does_not_move() -> None:
    fine = np.zeros((90, 90), np.float32)
    fine[:, 45:] = 0.8
    fine += 0.1
    coarse = cv2.resize(fine, (30, 30), interpolation=cv2.INTER_AREA)
    plain = cv2.resize(coarse, (90, 90), interpolation=cv2.INTER_CUBIC)
    found = srcnn(np.asarray(coarse, np.float32), 3)
    errors = [((image - fine)[20:70, 20:70] ** 2).mean() for image in (plain, found)]
    assert errors[1] < errors[0]
    profile = found[45]
    assert abs(np.interp(0.5, profile[40:50], np.arange(40, 50)) - 44.5) < 0.15
