from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest
from pytestqt.qtbot import QtBot

from napari_pv_inspect.live.layout_guess import LayoutGuesser
from napari_pv_inspect.models.workbench import WorkbenchModel
from pv_inspect.detection.layout_guess import LayoutGuess
from pv_inspect.geometry.layout import ModuleLayout
from pv_inspect.sequence.sequence import FrameSequence


def test_another_module_of_the_frames_is_guessed_anew_until_a_person_confirms(
    tiny_sequence: FrameSequence, qtbot: QtBot, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[Any] = []

    def guess(_: FrameSequence, settings: Any, inside: Any) -> LayoutGuess:
        asked.append((settings.rows, inside))
        return LayoutGuess(ModuleLayout(3, 4 if inside is None else 7), 0.9, ())

    monkeypatch.setattr("napari_pv_inspect.live.layout_guess.guess_layout", guess)
    model = WorkbenchModel()
    guesser = LayoutGuesser(model)
    model.open(replace(tiny_sequence, layout_hint={}))
    qtbot.waitUntil(lambda: model.settings.cols == 4)
    model.change_settings(module_at=(30.0, 40.0))
    assert model.guessing
    qtbot.waitUntil(lambda: model.settings.cols == 7)
    assert not model.guessing
    model.confirm_layout()
    model.change_settings(module_at=None)
    qtbot.wait(50)
    assert asked == [(None, None), (None, (30.0, 40.0))]
    guesser.close()


def test_a_guess_that_fails_unexpectedly_ends_all_the_same(
    tiny_sequence: FrameSequence, qtbot: QtBot, monkeypatch: pytest.MonkeyPatch
) -> None:
    def guess(*_: Any) -> LayoutGuess:
        raise ZeroDivisionError("nobody thought of this")

    monkeypatch.setattr("napari_pv_inspect.live.layout_guess.guess_layout", guess)
    model = WorkbenchModel()
    guesser = LayoutGuesser(model)
    model.open(replace(tiny_sequence, layout_hint={}))
    assert model.guessing
    qtbot.waitUntil(lambda: not model.guessing)
    guesser.close()
