"""How far frames sample a module together, which is a matter of geometry alone."""

from __future__ import annotations

import numpy as np
import pytest

from pv_inspect.geometry.camera import Camera
from pv_inspect.geometry.layout import ModuleLayout
from pv_inspect.reconstruction.sampling import (
    FEW,
    STILL,
    between,
    of_more_than_one,
    sampling_of,
)
from pv_inspect.registration.registration import Registration

SHAPE = (120, 160)


def shifted(shifts: np.ndarray) -> Registration:
    """2 x 3 cells of 40 px, seen straight, with these shifts (n, 2) of the frames, LR px."""
    n = len(shifts)
    homographies = np.array(
        [[[0.4, 0, x / 100], [0, 0.4, y / 100], [0, 0, 1]] for x, y in 10 + np.asarray(shifts)]
    )
    camera = Camera(np.diag([100.0, 100.0, 1.0]), 0.0)
    ones = np.ones(n)
    return Registration(
        ModuleLayout(2, 3), camera, homographies, np.ones(n, bool), ("",) * n, ones, 0 * ones, ones
    )


def sampling(shifts: np.ndarray) -> float:
    return sampling_of(shifted(shifts), SHAPE)


def test_frames_in_one_place_are_one_frame_whatever_their_number() -> None:
    assert sampling(np.zeros((1, 2))) == 0.0
    for n in (2, 8, 50):
        assert sampling(np.zeros((n, 2))) == pytest.approx(0.0, abs=1e-3)
        # By whole pixels: the same places between them.
        assert sampling(np.arange(2 * n).reshape(n, 2) % 5) == pytest.approx(0.0, abs=1e-3)


def test_still_frames_are_known_as_such_in_spite_of_what_registration_gets_wrong() -> None:
    rng = np.random.default_rng(3)
    for n in (2, 8, 20, 50):
        assert sampling(rng.normal(0, 0.01, (n, 2))) < 0.5 * STILL
        assert of_more_than_one(sampling(rng.normal(0, 0.01, (n, 2)))) < 0.1


def test_sampling_grows_with_the_number_of_places_and_with_their_distance() -> None:
    rng = np.random.default_rng(4)
    places = rng.uniform(0, 1, (200, 8, 2))
    means = [float(np.mean([sampling(p[:n]) for p in places[:40]])) for n in (1, 2, 3, 4, 5, 8)]
    assert means == sorted(means)
    assert means[1] < FEW < means[2]
    assert means[-1] > 0.95
    wider = [sampling(scale * places[0]) for scale in (0, 0.03, 0.1, 0.2, 0.5)]
    assert wider == sorted(wider)


def test_twenty_frames_that_moved_decide_alone() -> None:
    rng = np.random.default_rng(5)
    assert all(sampling(rng.uniform(0, 3, (20, 2))) > 0.99 for _ in range(20))


def test_frames_that_are_not_used_and_places_out_of_sight_do_not_count() -> None:
    moved = shifted(np.array([[0, 0], [0.5, 0.5], [0.5, 0], [0, 0.5]]))
    assert sampling_of(moved, SHAPE) > 0.5
    alone = Registration(**{**vars(moved), "used": np.array([True, False, False, False])})
    assert sampling_of(alone, SHAPE) == 0.0
    assert sampling_of(moved, (4, 4)) == 0.0


def test_what_is_usual_gives_way_to_what_was_found() -> None:
    assert between(0.5, 0.08, 0.0) == 0.5
    assert between(0.5, 0.08, 1.0) == 0.08
    assert between(0.5, 0.08, 0.5) == pytest.approx(0.2)
