from __future__ import annotations

import numpy as np
import pytest

from pv_inspect.geometry.camera import Camera
from pv_inspect.geometry.pose import Pose

K = np.array([[800.0, 0, 320], [0, 800, 256], [0, 0, 1]])


@pytest.mark.parametrize("px_per_unit", [8.0, 45.0])
def test_the_scale_is_that_of_the_middle_of_the_module(px_per_unit: float) -> None:
    size = (10.0, 6.0)
    zoom = px_per_unit / 800
    centred = np.array([[zoom, 0, -zoom * size[0] / 2], [0, zoom, -zoom * size[1] / 2], [0, 0, 1]])
    assert Pose(Camera(K, 0.0), centred).scale_px(size) == pytest.approx(px_per_unit)
    # The lens magnifies the edge, not the middle.
    assert Pose(Camera(K, -0.2), centred).scale_px(size) == pytest.approx(px_per_unit)
    tilted = centred @ np.diag([1.0, 0.5, 1.0])
    assert Pose(Camera(K, 0.0), tilted).scale_px((10.0, 12.0)) == pytest.approx(
        px_per_unit * np.sqrt(0.5)
    )
