from __future__ import annotations

import numpy as np
import pytest

from pv_inspect.cracks.flatten import CELL_PX, find_lines, flatten


def cell(side: int = 256) -> np.ndarray:
    """An even cell with a brightness slope and the dark gap around it."""
    slope = np.linspace(0.8, 1.2, side, dtype=np.float32)
    image = np.tile(slope, (side, 1))
    gap = max(side // 64, 1)
    image[:gap] = image[-gap:] = 0.05
    image[:, :gap] = image[:, -gap:] = 0.05
    return image


@pytest.mark.parametrize("value", [0.3, 1.8])
@pytest.mark.parametrize("axis", [0, 1])
def test_dark_and_bright_busbars_are_found_where_they_are(value: float, axis: int) -> None:
    image = cell()
    image[83:88] *= value
    image = image if axis == 0 else image.T
    np.testing.assert_array_equal(np.flatnonzero(find_lines(image, axis)), np.arange(83, 88))
    assert not find_lines(image, 1 - axis).any()


def test_dashed_busbars_are_found() -> None:
    image = cell()
    for start in range(20, 240, 60):
        image[83:88, start : start + 25] *= 0.3
    assert find_lines(image, 0)[84:87].all()


def test_a_diagonal_crack_is_no_line() -> None:
    image = cell()
    for k in range(30, 220):
        image[k, k // 3 + 60 : k // 3 + 63] *= 0.5
    assert not find_lines(image, 0).any()
    assert not find_lines(image, 1).any()


@pytest.mark.parametrize("scale", [0.01, 1.0, 500.0])
def test_an_even_cell_is_flat_whatever_its_brightness(scale: float) -> None:
    image = cell()
    image[83:88] *= 0.3
    flat = flatten(image * np.float32(scale))
    inside = ~flat.outside & ~flat.lines
    assert np.abs(flat.contrast[inside]).max() < 0.03
    assert flat.lines[85, 100]


@pytest.mark.parametrize("shape", [(60, 60), (130, 260), (300, 150), (37, 91)])
def test_the_longer_side_becomes_the_working_size(shape: tuple[int, int]) -> None:
    rng = np.random.default_rng(0)
    flat = flatten(rng.random(shape, dtype=np.float32))
    assert max(flat.contrast.shape) == CELL_PX
    assert flat.contrast.shape == flat.outside.shape == flat.lines.shape == flat.background.shape
    assert flat.contrast.dtype == np.float32
