"""Frames none of which shows the whole module were put together by the detection already."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pv_inspect.module_choice.choice import _parts_only
from tests.handmade import made_calibration

SHAPE = (60, 80)


@pytest.mark.parametrize(("cells", "only"), [(0.0, False), (0.2, False), (0.6, True)])
def test_only_frames_that_clearly_cut_the_module_count_as_parts(cells: float, only: bool) -> None:
    made = made_calibration(2)
    left = made.crossings_px(0)[:, 0].min()
    # Moved to the left until the module lies so many cells outside of the frame.
    by = (left + cells * 20) / 100
    move = np.array([[1, 0, -by], [0, 1, 0], [0, 0, 1]])
    moved = replace(made, homographies=np.array([move @ H for H in made.homographies]))
    assert _parts_only(moved, [0, 1], SHAPE) is only
