from __future__ import annotations

from pathlib import Path

from pv_inspect.inspection.doubts import left_out, not_used_sentence
from pv_inspect.inspection.summary import summary
from tests.handmade import made_inspection


def test_a_frame_left_out_is_told_once_and_no_warning_is_swallowed() -> None:
    made = made_inspection()
    tricky = "this name is not used.tif is a copy of frame_0.tif and is counted once."
    warned = made_inspection(
        warnings=(tricky, *(not_used_sentence(*frame) for frame in left_out(made)))
    )
    text = summary(warned, Path("out"), 1.0)
    assert f"warning   {tricky}" in text
    assert text.count("frame_1 & <i>.tif") == 1
