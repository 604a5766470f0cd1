"""Trials of the tuning."""

from __future__ import annotations

import numpy as np

from napari_pv_inspect.models.cell_picture import CellPicture
from napari_pv_inspect.models.history import History
from napari_pv_inspect.models.trials import Tuning, what_differs
from napari_pv_inspect.models.workbench import WorkbenchModel
from pv_inspect.sequence.sequence import FrameSequence
from pv_inspect.settings import Settings


class Hand:
    """A model with its tuning, moved as a hand does it."""

    def __init__(self) -> None:
        self.model, self.history = WorkbenchModel(), History()
        self.tuning = Tuning(self.model, self.history)

    def drag(self, *weights: float) -> None:
        for weight in weights:
            self.model.change_settings(prior_weight=weight)
            self.picture(finished=False)

    def picture(self, finished: bool = True) -> None:
        image = np.zeros((4, 4), np.float32)
        settings = self.model.settings
        self.tuning.pictured(CellPicture(image, (0, 0), "", settings, finished))

    def try_(self, weight: float) -> None:
        self.drag(weight)
        self.tuning.commit()
        self.picture()


def test_a_drag_is_one_edit_and_undo_brings_the_settled_value_back() -> None:
    hand = Hand()
    hand.try_(1.0)
    hand.drag(1.1, 1.5, 2.0)
    hand.tuning.commit()
    assert hand.history.undo_text == "Change lambda"
    hand.history.undo()
    assert hand.model.settings.prior_weight == 1.0
    hand.tuning.commit()
    hand.history.redo()
    assert hand.model.settings.prior_weight == 2.0
    hand.history.undo()
    hand.history.undo()
    assert hand.model.settings.prior_weight is None
    assert hand.history.undo_text is None


def test_undo_takes_the_last_image_setting_back_whatever_else_changed() -> None:
    hand = Hand()
    hand.model.change_settings(psf_sigma_lr_px=0.6)
    hand.tuning.commit()
    hand.model.change_settings(cell_aspect=1.5)
    hand.tuning.commit()
    hand.history.undo()
    assert hand.model.settings.psf_sigma_lr_px is None
    assert hand.model.settings.cell_aspect == 1.5


def test_there_is_one_trial_per_settled_setting() -> None:
    hand = Hand()
    hand.tuning.commit()
    hand.picture()
    hand.drag(0.1, 0.2)
    hand.picture()  # finished, but the slider goes on
    hand.drag(0.3)
    hand.picture()
    assert len(hand.tuning.trials) == 1
    hand.tuning.commit()
    hand.picture()
    assert [t.text for t in hand.tuning.trials] == ["first setting", "lambda 0.3"]


def test_a_trial_can_be_returned_to_and_is_not_listed_twice() -> None:
    hand = Hand()
    for weight in (1.0, 2.0):
        hand.try_(weight)
    first, second = hand.tuning.trials
    hand.tuning.restore(first)
    hand.picture()
    assert hand.model.settings.prior_weight == 1.0
    assert hand.tuning.trials == (first, second)
    assert (hand.tuning.current, hand.tuning.previous) == (first, second)
    hand.history.undo()
    assert hand.model.settings.prior_weight == 2.0


def test_before_is_the_settled_setting_while_the_slider_moves() -> None:
    hand = Hand()
    hand.try_(1.0)
    hand.try_(2.0)
    assert hand.tuning.before is hand.tuning.trials[0]
    hand.drag(2.5)
    assert hand.tuning.before is hand.tuning.trials[1]


def test_a_name_is_kept_and_can_be_taken_back() -> None:
    hand = Hand()
    hand.try_(1.0)
    hand.tuning.rename(hand.tuning.trials[0], "  sharp ")
    assert hand.tuning.trials[0].title == "sharp"
    assert hand.tuning.current is hand.tuning.trials[0]
    hand.history.undo()
    assert hand.tuning.trials[0].title == "first setting"


def test_another_sequence_begins_a_new_list(tiny_sequence: FrameSequence) -> None:
    hand = Hand()
    hand.try_(1.0)
    hand.model.open(tiny_sequence)
    assert hand.tuning.trials == ()
    assert hand.tuning.before is None


def test_what_differs_is_told_in_a_few_words() -> None:
    a = Settings(rows=2, prior_weight=0.5)
    b = Settings(rows=3, prior="btv", kappa=-0.2, skip_frames=("f1", "f2"))
    assert what_differs(a, b) == "kappa -0.2, frames left out 2, lambda automatic, prior btv"
