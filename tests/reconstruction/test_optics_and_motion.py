"""What of the blur of the frames is the optics, and what is motion."""

from __future__ import annotations

import numpy as np
import pytest

from pv_inspect.reconstruction.optics_and_motion import common_moment, contradicted_frames


def test_the_sharpest_frames_tell_the_optics_from_motion() -> None:
    rng = np.random.default_rng(4)
    motion = np.where(rng.random(24) < 0.5, 0.0, rng.uniform(0.0, 0.9, 24))
    moments = 0.2 + motion**2 / 12 + 0.004 * rng.standard_normal(24)
    covariance = np.diag(np.full(24, 0.004**2))
    moment, error = common_moment(moments, covariance, np.zeros(24))
    assert moment == pytest.approx(0.2, abs=0.006)
    assert 0.0005 < error < 0.005


def test_a_motion_that_was_found_is_taken_off() -> None:
    motion = np.linspace(0.6, 1.6, 6)
    covariance = np.diag(np.full(6, 0.005**2))
    moment, _ = common_moment(0.25 + motion**2 / 12, covariance, motion)
    assert moment == pytest.approx(0.25, abs=0.02)
    # The first frame stands still and the others do not look it: their motions are false.
    false = common_moment(np.full(6, 0.25), covariance, np.array([0.0] + [1.4] * 5))
    assert false[0] == pytest.approx(0.25, abs=0.03)


def test_an_error_that_all_frames_share_is_not_averaged_out() -> None:
    moments = np.full(20, 0.25)
    alone = np.diag(np.full(20, 0.01**2))
    _, small = common_moment(moments, alone, np.zeros(20))
    _, large = common_moment(moments, alone + 0.02**2, np.zeros(20))
    assert small < 0.005
    assert large > 0.019


def test_a_motion_along_which_borders_are_sharp_is_contradicted() -> None:
    rng = np.random.default_rng(1)
    pairs = np.arange(16)
    motion = np.zeros((8, 2))
    motion[:4] = [1.2, 0.2]
    seen = np.zeros((8, 2))
    seen[2:4] = motion[2:4]
    moments = 0.25 + seen.ravel() ** 2 / 12 + 0.005 * rng.standard_normal(16)
    covariance, lengths = np.diag(np.full(16, 0.008**2)), np.hypot(*motion.T)
    found = contradicted_frames(pairs, moments, covariance, motion.ravel(), lengths)
    assert found.tolist() == [0, 1]
    # What is not known well contradicts nothing.
    vague = contradicted_frames(pairs, moments, covariance * 100, motion.ravel(), lengths)
    assert vague.tolist() == []


def test_a_frame_that_may_have_moved_along_the_other_axis_is_not_contradicted() -> None:
    sharp, exact = np.full(6, 0.25), np.diag(np.full(6, 0.005**2))
    along, pairs = np.array([0.0, 0.0, 1.0, 1.0, 1.0, 1.0]), 2 * np.arange(6)
    found = contradicted_frames(pairs, sharp, exact, along, 1.05 * along)
    assert found.tolist() == [2, 3, 4, 5]
    assert contradicted_frames(pairs, sharp, exact, along, 3.9 * along).tolist() == []
