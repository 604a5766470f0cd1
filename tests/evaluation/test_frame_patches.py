"""Enlarging a frame and rectifying it afterwards puts every pixel where it belongs."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from pv_inspect.evaluation.frame_patches import FramePatch


@pytest.mark.parametrize("scale", [1, 3, 4])
def test_an_enlarged_patch_is_sampled_without_a_shift(scale: int) -> None:
    """Half a pixel of the wrong convention would move the picture by (scale - 1) / (2 scale)."""
    y, x = np.mgrid[:24, :30].astype(np.float64)
    ramp = (0.01 * x + 0.02 * y).astype(np.float32)
    target = np.stack(np.meshgrid(np.linspace(8, 20, 40), np.linspace(6, 15, 30)), axis=-1)
    corner = (100, 50)
    patch = FramePatch(ramp, corner, target + corner, 1.0)
    size = (scale * ramp.shape[1], scale * ramp.shape[0])
    enlarged = np.asarray(cv2.resize(ramp, size, interpolation=cv2.INTER_CUBIC), np.float32)
    found = patch.rectified(enlarged, scale)
    assert found == pytest.approx(0.01 * target[..., 0] + 0.02 * target[..., 1], abs=2e-3)


def test_the_scale_of_the_frame_comes_back() -> None:
    patch = FramePatch(np.linspace(0, 2, 12, dtype=np.float32).reshape(3, 4), (0, 0), None, 4.0)  # type: ignore[arg-type]
    unit = patch.scaled_to_unit()
    assert unit.image.max() == pytest.approx(0.5)
    assert unit.back(unit.image) == pytest.approx(patch.image)
