from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pv_inspect.cracks import CellFeatures, CrackMap
from pv_inspect.geometry.layout import ModuleLayout
from pv_inspect.inspection.doubts import CONTRADICTION, OVER_FIT, doubts_of, warnings_of
from pv_inspect.inspection.summary import summary
from pv_inspect.sequence.differences import Pair
from pv_inspect.sequence.lock_in import LockIn
from tests.handmade import made_inspection, made_reconstruction


def cell(**values: Any) -> CellFeatures:
    given = {"crack_length_cells": 0.0, "crack_instances": 0, "dark_area_share": 0.0, **values}
    return CellFeatures(0, 0, mean_intensity=0.4, crack_score=0.1, **given)


def test_a_sound_result_is_not_in_doubt() -> None:
    assert doubts_of(made_inspection()) == ()


@pytest.mark.parametrize(("residual", "doubted"), [(CONTRADICTION, 0), (CONTRADICTION + 0.1, 1)])
def test_frames_that_contradict_the_image_put_it_in_doubt(residual: float, doubted: int) -> None:
    reconstruction = replace(made_reconstruction(), residual_rms=(residual, float("nan"), residual))
    doubts = doubts_of(made_inspection(reconstruction=reconstruction))
    assert len(doubts) == doubted
    assert all("same module" in doubt for doubt in doubts)


def test_a_layout_that_the_frames_contradict_is_the_first_doubt() -> None:
    made = made_inspection(
        reconstruction=replace(made_reconstruction(), residual_rms=(9.0, np.nan, 9.0))
    )
    assert made.registration is not None
    doubts = doubts_of(replace(made, registration=replace(made.registration, misfit="No fit.")))
    assert doubts[0] == "No fit."
    assert len(doubts) == 2


def test_an_image_that_differs_from_the_only_frame_is_in_doubt() -> None:
    made = made_inspection(
        reconstruction=replace(made_reconstruction(), residual_rms=(14.8, np.nan, np.nan))
    )
    assert made.registration is not None
    alone = replace(made.registration, used=np.array([True, False, False]))
    (doubt,) = doubts_of(replace(made, registration=alone))
    assert "differs from the only frame by 14.8 times its noise" in doubt


def test_a_module_of_which_no_cell_can_be_judged_is_in_doubt() -> None:
    made = made_inspection()
    assert made.cracks is not None
    blind = (cell(unsure=True), cell(unsure=True, crack_instances=2), cell(dark_area_share=0.9))

    def doubts(*cells: CellFeatures) -> tuple[str, ...]:
        cracks = CrackMap(made.cracks.probability, 0.5, "by hand", cells)
        return doubts_of(replace(made, cracks=cracks))

    assert len(doubts(*blind)) == 1
    assert doubts(*blind)[0].startswith(
        "2 of 3 cells can't be judged from these frames, 1 is dark and not judged"
    )
    assert "current" in doubts(cell(dark_area_share=0.9))[0]
    assert doubts(*blind, cell()) == ()
    noisy, blurred = ({"crack_detail": a, "edge_blur": b} for a, b in ((0.1, 0.01), (0.9, 0.03)))
    assert "less noise" in doubts(cell(unsure=True, **noisy))[0]
    assert "in focus" in doubts(cell(unsure=True, **blurred))[0]
    # A part that is cut off is seen in any frame, cracks are not.
    cut_off = cell(crack_instances=1, cut_off_share=0.2, **noisy)
    assert len(doubts(cut_off, cell(unsure=True, **noisy))) == 1
    assert doubts(cut_off, cell(crack_detail=0.9, edge_blur=0.01)) == ()


def test_a_layout_that_fits_nearly_as_well_is_named() -> None:
    made = made_inspection(layout_guessed=True, runner_up=ModuleLayout(6, 20, 0.5))
    assert any("(6 x 20 of aspect 0.5 fit nearly as well)" in text for text in warnings_of(made))


def test_frames_that_are_left_out_are_warned_about_with_their_reason() -> None:
    warnings = warnings_of(made_inspection(layout_guessed=True))
    assert any("guessed" in text for text in warnings)
    assert any("frame_1" in text and "found</b>" in text for text in warnings)


@pytest.mark.parametrize(("residual", "warned"), [(OVER_FIT - 0.1, True), (OVER_FIT, False)])
def test_frames_that_agree_better_than_their_noise_allows_are_warned_about(
    residual: float, warned: bool
) -> None:
    reconstruction = replace(made_reconstruction(), residual_rms=(residual, float("nan"), residual))
    warnings = warnings_of(made_inspection(reconstruction=reconstruction))
    assert any("better than their noise allows (residual 0.30" in w for w in warnings) is warned


def test_a_single_frame_is_not_said_to_agree_with_others() -> None:
    made = made_inspection(
        reconstruction=replace(
            made_reconstruction(), residual_rms=(0.3, float("nan"), float("nan"))
        )
    )
    assert made.registration is not None
    alone = replace(made.registration, used=np.array([True, False, False]))
    warnings = warnings_of(replace(made, registration=alone))
    assert any("follows the only frame down to 0.30 times its noise" in text for text in warnings)
    assert not any("agree" in text for text in warnings)


def test_a_reconstruction_that_ended_too_early_is_warned_about() -> None:
    early = replace(made_reconstruction(), converged=False)
    warnings = warnings_of(made_inspection(reconstruction=early))
    assert any("had not converged after 12 steps" in text for text in warnings)
    assert not any("converged" in text for text in warnings_of(made_inspection()))


def test_copies_are_told_in_one_sentence_not_frame_by_frame() -> None:
    made = made_inspection()
    sequence: Any = replace(made.sequence, copies={1: 0})  # type: ignore[type-var]
    warnings = warnings_of(replace(made, sequence=sequence))
    assert sum("counted once" in text for text in warnings) == 1
    assert not any("is not used" in text for text in warnings)
    told = summary(replace(made, sequence=sequence, warnings=warnings), Path("out"), 1.0)
    assert "not used" not in told


def test_frames_without_current_are_told_in_one_sentence_not_frame_by_frame() -> None:
    made = made_inspection()
    lock_in = LockIn({0: Pair(1), 2: Pair(1)}, {1: "without current: subtracted from frame_0"})
    sequence: Any = replace(  # type: ignore[type-var]
        made.sequence, lock_in=lock_in, without_current=frozenset({1})
    )
    warnings = warnings_of(replace(made, sequence=sequence))
    assert sum("please confirm it (--lock-in" in text for text in warnings) == 1
    assert not any("is not used" in text for text in warnings)
    asked = replace(made, sequence=sequence, settings=made.settings.changed(lock_in=True))
    assert not any("confirm it" in text for text in warnings_of(asked))


def test_rows_that_run_down_the_frames_are_warned_about() -> None:
    made = made_inspection()
    registration = made.registration
    assert registration is not None
    assert not any("turned by a quarter" in text for text in warnings_of(made))
    quarter = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])
    turned = replace(registration, homographies=quarter @ registration.homographies)
    texts = warnings_of(replace(made, registration=turned))
    rows, cols = registration.layout.rows, registration.layout.cols
    assert any(f"give --rows {cols} --cols {rows}" in text for text in texts)


def test_frames_that_end_where_the_module_ends_are_a_warning() -> None:
    made = made_inspection()
    registration = made.registration
    assert registration is not None
    assert not any("whether it goes on" in text for text in warnings_of(made))
    # Nearer by so much that no frame shows what lies around the module.
    K, camera = registration.camera.K, replace(registration.camera, kappa=0.0)
    centre = camera.project(registration.homographies[0], np.array([registration.layout.size]) / 2)
    shape = made.frames.shape
    shift = np.array([[4, 0, 0.0], [0, 4, 0], [0, 0, 1]])
    shift[:2, 2] = np.array(shape[::-1]) / 2 - 4 * centre[0]
    filled = np.linalg.inv(K) @ shift @ K @ registration.homographies
    texts = warnings_of(
        replace(made, registration=replace(registration, camera=camera, homographies=filled))
    )
    assert any("The frames end at the first row" in text for text in texts)
