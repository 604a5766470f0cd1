from __future__ import annotations

import numpy as np
import pytest

from pv_inspect.cracks import novelty_of
from pv_inspect.cracks.looks import STATISTICS, KnownLooks, look_of
from pv_inspect.cracks.network import NetworkDetector
from pv_inspect.cracks.ridge import RidgeDetector


def grainy(seed: int, side: int = 200) -> np.ndarray:
    rng = np.random.default_rng(seed)
    coarse = np.kron(rng.normal(0.6, 0.06, (side // 10, side // 10)), np.ones((10, 10)))
    return np.asarray(coarse + rng.normal(0, rng.uniform(0.005, 0.03), coarse.shape), np.float32)


def combed(seed: int) -> np.ndarray:
    tile = grainy(seed)
    tile[:, ::4] *= np.float32(0.5)
    return tile


@pytest.fixture(scope="module")
def known() -> KnownLooks:
    looks = np.array([look_of(grainy(seed)) for seed in range(80)])
    return KnownLooks.of(looks[:60], looks[60:], quantile=0.995, margin=1.6)


def test_a_look_does_not_depend_on_brightness_or_orientation() -> None:
    tile = grainy(1)
    for other in (tile * 7, tile[::-1], tile[:, ::-1], np.rot90(tile)):
        assert look_of(np.ascontiguousarray(other)) == pytest.approx(look_of(tile), abs=0.02)


def test_a_comb_that_was_never_seen_is_novel_and_another_seed_is_not(known: KnownLooks) -> None:
    assert all(known.novelty(grainy(seed)) < 1 for seed in range(100, 110))
    assert all(known.novelty(combed(seed)) > 1 for seed in range(100, 110))


def test_known_looks_of_another_size_are_refused() -> None:
    with pytest.raises(ValueError, match=str(STATISTICS)):
        KnownLooks(np.zeros(3), np.eye(3), 1.0)


def test_a_detector_that_does_not_know_its_looks_says_nothing() -> None:
    assert np.isnan(novelty_of(RidgeDetector(), grainy(0)))
    assert np.isnan(NetworkDetector("weak").novelty(grainy(0)))
