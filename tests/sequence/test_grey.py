from __future__ import annotations

import cv2
import numpy as np
import pytest

from pv_inspect.errors import InspectionError
from pv_inspect.sequence.grey import grey_of
from tests.image_files.making import scene


@pytest.mark.parametrize("dtype", ["uint8", "uint16", "float32"])
def test_equal_channels_are_the_picture_itself(dtype: str) -> None:
    image = scene(dtype)
    grey, tinted = grey_of(np.dstack([image] * 4), "x")
    np.testing.assert_array_equal(grey, image)
    assert not tinted
    assert grey_of(image, "x")[0] is image


@pytest.mark.parametrize("dtype", ["uint8", "uint16"])
def test_a_white_balance_of_some_levels_is_averaged(dtype: str) -> None:
    image = scene(dtype)
    warm = [np.asarray(image * gain).astype(dtype) for gain in (0.97, 1.0, 0.99)]
    grey, tinted = grey_of(np.dstack(warm), "x")
    assert tinted
    assert grey.dtype == image.dtype
    assert np.abs(grey - np.mean(warm, axis=0)).max() <= 0.5


def test_where_one_channel_is_cut_off_the_frame_is_saturated() -> None:
    image = np.full((40, 50, 3), 250, np.uint8)
    image[..., 2] = 255
    assert (grey_of(image, "x")[0] == 255).all()


def test_a_small_coloured_mark_does_not_make_a_colour_image() -> None:
    image = np.dstack([scene("uint8", (100, 100))] * 3)
    image[:3, :3] = (0, 0, 255)
    assert grey_of(image, "x")[1]


@pytest.mark.parametrize("colours", [cv2.COLORMAP_JET, cv2.COLORMAP_INFERNO, cv2.COLORMAP_BONE])
@pytest.mark.parametrize("bright", [1.0, 0.2])
def test_a_colour_map_is_refused(colours: int, bright: float) -> None:
    image = cv2.applyColorMap(scene("uint8"), colours)
    for dtype, scale in (("uint8", 1), ("uint16", 16)):
        dark = (image * bright * scale).astype(dtype)
        with pytest.raises(InspectionError, match="x is a colour image"):
            grey_of(dark, "x")
