"""Frames by daylight in the workbench: the list, the caption, the control."""

from __future__ import annotations

from dataclasses import replace

from pytestqt.qtbot import QtBot

from napari_pv_inspect.io.opener import open_again
from napari_pv_inspect.layers.frames import frame_caption
from napari_pv_inspect.models.frame_table import frame_rows
from napari_pv_inspect.widgets.three_way import ThreeWay
from pv_inspect.sequence.differences import Pair
from pv_inspect.sequence.lock_in import LockIn
from pv_inspect.sequence.sequence import FrameSequence
from pv_inspect.settings import Settings

WHY = "without current: subtracted from frame_000.tif"


def by_day(sequence: FrameSequence) -> FrameSequence:
    rest = {k: Pair(1) for k in range(len(sequence)) if k != 1}
    return replace(sequence, lock_in=LockIn(rest, {1: WHY}))


def test_a_frame_without_current_stands_in_the_list_with_its_reason(
    tiny_sequence: FrameSequence,
) -> None:
    rows = frame_rows(by_day(tiny_sequence), None, Settings())
    assert (rows[1].used, rows[1].status, rows[1].wanted) == (False, WHY, False)
    assert rows[0].used is None
    assert WHY in frame_caption(by_day(tiny_sequence), None, 1)


def test_the_frames_are_read_again_as_they_are(tiny_sequence: FrameSequence) -> None:
    opened = open_again(by_day(tiny_sequence), Settings(lock_in=False))
    assert opened.sequence is not None
    assert opened.sequence.lock_in is None
    assert opened.reading == (None, None, False)


def test_a_box_of_three_tells_what_the_user_chooses(qtbot: QtBot) -> None:
    box = ThreeWay("as seen", ("Differences", ""), ("As they are", ""))
    qtbot.addWidget(box)
    told: list[object] = []
    box.changed.connect(told.append)
    box.show_value(True)
    assert told == []
    box.setCurrentIndex(2)
    box.setCurrentIndex(0)
    assert told == [False, None]
