from __future__ import annotations

import cv2
import numpy as np
import pytest

from pv_inspect.cracks.classes import CRACK
from pv_inspect.cracks.network import CELL_PX, normalised
from pv_inspect.cracks.training.augmentation import Augmentation, prepared


def cell() -> tuple[np.ndarray, np.ndarray]:
    image, label = np.full((400, 400), 180, np.uint8), np.zeros((400, 400), np.uint8)
    for drawn, value in ((image, 60), (label, CRACK)):
        cv2.line(drawn, (60, 90), (330, 300), value, 3)
    return image, label


def test_a_prepared_cell_keeps_its_thin_cracks() -> None:
    image, label = prepared(*cell())
    assert image.shape == label.shape == (CELL_PX, CELL_PX)
    n_parts = cv2.connectedComponents((label == CRACK).astype(np.uint8), connectivity=8)[0] - 1
    assert n_parts == 1
    assert (label == CRACK).sum() == pytest.approx((cell()[1] == CRACK).sum() * 0.64**2, rel=0.3)


@pytest.mark.parametrize("seed", range(12))
def test_the_label_moves_with_the_image(seed: int) -> None:
    seen, label = Augmentation(degrade=False)(*prepared(*cell()), np.random.default_rng(seed))
    on, off = seen[label == CRACK].mean(), seen[label != CRACK].mean()
    assert on < off - 0.6


@pytest.mark.parametrize("seed", range(20))
def test_degraded_cells_are_valid_inputs(seed: int) -> None:
    image, label = prepared(*cell())
    half = np.ascontiguousarray(image[:128]), np.ascontiguousarray(label[:128])
    for pair in ((image, label), half):
        seen, classes = Augmentation()(*pair, np.random.default_rng(seed))
        assert seen.dtype == np.float32
        assert seen.shape == classes.shape
        assert sorted(seen.shape) == sorted(pair[0].shape)
        assert np.isfinite(seen).all()
        assert -1 <= seen.min() < seen.max() <= 2
        assert set(np.unique(classes)) <= {0, CRACK}


def test_the_same_seed_gives_the_same_cell() -> None:
    once, again = (Augmentation()(*prepared(*cell()), np.random.default_rng(5)) for _ in "ab")
    np.testing.assert_array_equal(once[0], again[0])


def test_the_input_does_not_depend_on_the_exposure() -> None:
    image = np.random.default_rng(0).random((40, 40)).astype(np.float32)
    np.testing.assert_allclose(normalised(image), normalised(7 * image), atol=1e-5)
