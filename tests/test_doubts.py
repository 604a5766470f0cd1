from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest

from pv_inspect.cracks import CellFeatures, CrackMap
from pv_inspect.doubts import CONTRADICTION, doubts_of, warnings_of
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


def test_frames_that_are_left_out_are_warned_about_with_their_reason() -> None:
    warnings = warnings_of(made_inspection(layout_guessed=True))
    assert any("guessed" in text for text in warnings)
    assert any("frame_1" in text and "found</b>" in text for text in warnings)
