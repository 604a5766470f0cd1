from __future__ import annotations

from dataclasses import replace

import pytest

from pv_inspect.cracks.features import CellFeatures
from pv_inspect.cracks.wording import (
    CLASS_RULE,
    CLASS_WORDS,
    class_text,
    described,
    finger_text,
    tooltip,
)

CELL = CellFeatures(
    row=0,
    col=3,
    crack_length_cells=0.482,
    crack_instances=2,
    dark_area_share=0.031,
    mean_intensity=0.3121,
    crack_score=0.934,
    crack_branches=3,
    largest_dark_share=0.02,
    isolated_area_share=0.123,
    isolated_brightness=0.654,
    crack_support=0.31,
    unsupported_share=0.1,
)


def test_a_cell_is_described_with_units() -> None:
    said = dict(described(CELL))
    assert said["crack length"] == "0.48 cell widths"
    assert dict(described(replace(CELL, crack_length_mm=75.2)))["crack length"] == "75 mm"
    assert said["cracks"] == "2, 3 branches"
    assert said["cut off at worst"] == "12.3% of the cell, 65% as bright as the rest"
    assert said["dark area"] == "3.1% of the cell, largest piece 2.0%"
    assert said["mean brightness"] == "31.2% of full scale"
    assert said["class"] == "B (cracks, a part is badly connected)"
    assert said["supported by the frames"] == "yes, 10% of the crack length is unsupported"


def test_a_cell_that_is_not_supported_says_so_and_what_the_marks_alone_say() -> None:
    said = dict(described(replace(CELL, unsupported_share=0.8, unsure=True)))
    assert (
        said["class"] == "can't be judged (not supported by the frames; B if the marks are right)"
    )
    assert said["supported by the frames"] == "no, 80% of the crack length is unsupported"


def test_what_is_not_known_is_not_written_as_nan() -> None:
    bare = CellFeatures(0, 0, 0.2, 1, 0.0, 0.3, 0.5)
    assert "nan" not in tooltip(bare)
    assert "no busbars" in tooltip(bare)


@pytest.mark.parametrize("name", CLASS_WORDS)
def test_every_class_is_in_the_written_rule(name: str) -> None:
    shown = "can't be judged" if name == "unsure" else name
    assert any(line.startswith(f"{shown} ") for line in CLASS_RULE.splitlines())


def test_unsure_is_the_word_of_an_expert_and_never_the_detectors() -> None:
    marked, bare = replace(CELL, unsure=True), replace(CELL, unsure=True, crack_instances=0)
    assert class_text(CELL) == "B"
    assert class_text(marked) == "can't be judged (B)"
    assert class_text(bare) == "can't be judged"
    assert "no marks" in dict(described(bare))["class"]
    for cell in (marked, bare):
        assert "unsure" not in tooltip(cell)


def test_a_tooltip_begins_with_the_place() -> None:
    assert tooltip(CELL).splitlines()[0] == "Row 1, column 4"
    assert len(tooltip(CELL).splitlines()) == 1 + len(described(CELL))


def test_the_reason_why_a_cell_cant_be_judged_is_in_its_description() -> None:
    weak = dict(described(replace(CELL, weak_marks=True)))
    strange = dict(described(replace(CELL, novelty=1.5)))
    assert "too short or too faint" in weak["class"]
    assert "unlike all that the detector has learnt" in strange["class"]
    assert strange["novelty of its look"].startswith("1.50")


def test_interrupted_fingers_are_told_with_the_cells_where_none_was_looked_for() -> None:
    two = replace(CELL, finger_interruptions=2.0, finger_interruption_length_cells=0.41)
    none = replace(CELL, finger_interruptions=0.0, finger_interruption_length_cells=0.0)
    assert dict(described(two))["interrupted fingers"] == "2, together 0.41 cell widths, no cracks"
    assert dict(described(none))["interrupted fingers"] == "none seen"
    assert "interrupted fingers" not in dict(described(CELL))
    assert finger_text([two, none]) == (
        "2 interrupted fingers in 1 of 2 cells, no cracks by themselves"
    )
    assert finger_text([two, CELL]).endswith("no cracks by themselves; not looked for in 1")
    assert finger_text([none, CELL]) == ""
