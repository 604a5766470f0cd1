from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pv_inspect.cracks.centreline import skeleton_length
from pv_inspect.cracks.features import (
    FEATURES,
    CellFeatures,
    crack_marks,
    from_texts,
    measure_cell,
    texts,
)
from pv_inspect.cracks.isolation import Busbars
from pv_inspect.cracks.seen import LEAST_DETAIL, MOST_BLUR

SIDE = 200


def drawn(*lines: tuple[tuple[int, int], tuple[int, int]], width: int = 3) -> np.ndarray:
    mask = np.zeros((SIDE, SIDE), np.uint8)
    for a, b in lines:
        cv2.line(mask, a, b, 1, width)
    return mask > 0


def measured(mask: np.ndarray, tile: np.ndarray | None = None, level: float = 0.9) -> CellFeatures:
    tile = np.full(mask.shape, 0.5, np.float32) if tile is None else tile
    probability = mask.astype(np.float32) * np.float32(level)
    return measure_cell(
        tile, probability, 0.5, row=1, col=2, cell_width_px=SIDE, usual_intensity=0.5
    )


@settings(max_examples=30, deadline=None)
@given(angle=st.floats(0, 180), width=st.integers(1, 5))
def test_the_length_of_a_line_does_not_depend_on_its_direction(angle: float, width: int) -> None:
    half = 70 * np.array([np.cos(np.radians(angle)), np.sin(np.radians(angle))])
    a, b = np.round(100 - half).astype(int), np.round(100 + half).astype(int)
    length = skeleton_length(drawn((tuple(a), tuple(b)), width=width))
    # thinning takes up to half of the line's width from either end
    assert length == pytest.approx(np.hypot(*(b - a)), abs=2.5 + width)


def test_the_length_of_a_ring_is_its_circumference() -> None:
    mask = np.zeros((SIDE, SIDE), np.uint8)
    cv2.circle(mask, (100, 100), 60, 1, 3)
    assert skeleton_length(mask > 0) == pytest.approx(2 * np.pi * 60, rel=0.03)


def test_branches_count_once_each() -> None:
    mask = drawn(((20, 100), (180, 100)), ((100, 100), (100, 20)))
    assert skeleton_length(mask) == pytest.approx(160 + 80, abs=6)


def test_nothing_and_a_single_pixel_have_no_length() -> None:
    mask = np.zeros((20, 20), bool)
    assert skeleton_length(mask) == 0
    mask[10, 10] = True
    assert skeleton_length(mask) == 0


def test_separate_marks_are_instances_and_specks_are_none() -> None:
    mask = drawn(((20, 20), (120, 20)), ((20, 100), (20, 180)))
    mask[150:153, 150:153] = True
    features = measured(mask)
    assert features.crack_instances == 2
    assert features.crack_length_cells == pytest.approx(180 / SIDE, abs=0.03)
    assert (features.row, features.col) == (1, 2)


def test_a_compact_mark_is_no_crack_unless_it_is_large() -> None:
    blob = np.zeros((SIDE, SIDE), np.uint8)
    cv2.circle(blob, (60, 60), 18, 1, -1)  # 0.18 cell widths, a cluster of dark grains
    assert not measured(blob > 0).crack_suspected
    star = drawn(((20, 100), (180, 100)), ((100, 20), (100, 180)))
    assert measured(star).crack_suspected


@settings(max_examples=20, deadline=None)
@given(angle=st.floats(0, 180), length=st.floats(0.05, 0.25))
def test_a_straight_mark_counts_from_its_length_on_in_every_direction(
    angle: float, length: float
) -> None:
    half = length * SIDE / 2 * np.array([np.cos(np.radians(angle)), np.sin(np.radians(angle))])
    a, b = np.round(100 - half).astype(int), np.round(100 + half).astype(int)
    marks = crack_marks(drawn((tuple(a), tuple(b))).astype(np.float32), 0.5, SIDE)
    if abs(length - 0.15) > 0.03:  # the ends are rounded to pixels and have the line's width
        assert len(marks) == (length > 0.15)


def test_a_dark_cell_is_not_judged() -> None:
    tile = np.full((SIDE, SIDE), 0.1, np.float32)
    features = measured(drawn(((20, 20), (180, 180))), tile)
    assert features.dark
    assert not features.crack_suspected
    assert features.crack_length_cells == 0


def test_the_score_is_the_probability_of_a_crack_that_is_long_enough() -> None:
    assert measured(drawn(((20, 20), (180, 180)))).crack_score == pytest.approx(0.9)
    assert measured(drawn(((20, 20), (180, 180))), level=0.3).crack_score == pytest.approx(0.3)
    assert measured(np.zeros((SIDE, SIDE), bool)).crack_score == 0
    speck = np.zeros((SIDE, SIDE), bool)
    speck[90:94, 90:94] = True
    assert 0 < measured(speck).crack_score < 0.5


def test_dark_area_is_the_share_of_broad_dark_regions_only() -> None:
    tile = np.full((SIDE, SIDE), 0.5, np.float32)
    tile[50:90, 60:100] = 0.1  # 40 x 40 px, inactive
    tile[140:143] = 0.1  # a busbar
    tile[:3] = tile[-3:] = 0.0  # the gap between cells
    inside = (SIDE - 2 * 8) ** 2
    share = measured(np.zeros((SIDE, SIDE), bool), tile).dark_area_share
    assert share == pytest.approx(1600 / inside, rel=0.05)


def test_a_dead_cell_is_dark_against_the_module_not_against_itself() -> None:
    features = measured(np.zeros((SIDE, SIDE), bool), np.full((SIDE, SIDE), 0.05, np.float32))
    assert features.dark_area_share == 1.0
    assert features.mean_intensity == pytest.approx(0.05)


def busbars(*centres: int) -> Busbars:
    lines = np.zeros(SIDE, bool)
    for centre in centres:
        lines[centre - 2 : centre + 3] = True
    return Busbars(True, lines)


def with_busbars(mask: np.ndarray, brightness_beyond: float = 0.5) -> CellFeatures:
    """A cell with busbars at rows 60 and 140 whose part above row 30 has another brightness."""
    tile = np.full(mask.shape, 0.5, np.float32)
    tile[:30] = brightness_beyond
    return measure_cell(
        tile,
        mask.astype(np.float32),
        0.5,
        row=0,
        col=0,
        cell_width_px=SIDE,
        usual_intensity=0.5,
        busbars=busbars(60, 140),
        cell_width_mm=156.0,
    )


def test_isolated_area_and_its_brightness_are_measured() -> None:
    features = with_busbars(drawn(((0, 30), (199, 30))), 0.2)
    assert features.isolated_area_share == pytest.approx(30.5 / SIDE, rel=0.01)
    assert features.isolated_brightness == pytest.approx(0.4, rel=0.02)
    assert features.crack_branches == 1
    assert features.crack_length_mm == pytest.approx(156, rel=0.02)


@pytest.mark.parametrize(
    ("brightness", "expected"), [(0.5, "A"), (0.42, "A"), (0.3, "B"), (0.15, "C"), (0.0, "C")]
)
def test_the_class_follows_the_written_rule(brightness: float, expected: str) -> None:
    assert with_busbars(drawn(((0, 30), (199, 30))), brightness).crack_class == expected


def test_classes_without_an_isolated_area() -> None:
    nothing = np.zeros((SIDE, SIDE), bool)
    assert with_busbars(nothing).crack_class == "none"
    assert with_busbars(drawn(((20, 100), (180, 100)))).crack_class == "A"
    assert measured(drawn(((20, 100), (180, 100)))).crack_class == "unknown"  # no busbars known
    assert measured(nothing, np.full((SIDE, SIDE), 0.1, np.float32)).crack_class == "dark"


def test_the_largest_dark_area_is_one_of_them() -> None:
    tile = np.full((SIDE, SIDE), 0.5, np.float32)
    tile[50:90, 60:100] = tile[120:140, 60:80] = 0.1
    features = measured(np.zeros((SIDE, SIDE), bool), tile)
    inside = (SIDE - 2 * 8) ** 2
    assert features.dark_area_share == pytest.approx(2000 / inside, rel=0.05)
    assert features.largest_dark_share == pytest.approx(1600 / inside, rel=0.05)


def test_features_survive_a_table_and_old_tables_can_be_read() -> None:
    features = with_busbars(drawn(((0, 30), (199, 30))), 0.2)
    line = dict(zip(FEATURES, texts(features), strict=True))
    read = from_texts(0, 0, line)
    assert texts(read) == texts(features)
    assert isinstance(read.crack_branches, int)
    unsure = replace(features, unsupported_share=0.7, unsure=True)
    assert from_texts(0, 0, dict(zip(FEATURES, texts(unsure), strict=True))).unsure is True
    assert read.unsure is False
    old = {name: line[name] for name in FEATURES[:5]}
    assert np.isnan(from_texts(0, 0, old).isolated_area_share)


def supported(
    mask: np.ndarray,
    support: np.ndarray,
    beyond: float = 0.2,
    blocks: np.ndarray | None = None,
    seen: tuple[float, float] = (np.nan, np.nan),
) -> CellFeatures:
    """A cell with a busbar at row 100 whose part above row 30 is dark, and a support map."""
    tile = np.full(mask.shape, 0.5, np.float32)
    tile[:30] = 0.5 * beyond
    return measure_cell(
        tile,
        mask.astype(np.float32),
        0.5,
        row=0,
        col=0,
        cell_width_px=SIDE,
        usual_intensity=0.5,
        busbars=busbars(100),
        support=support.astype(np.float32),
        # The classes that hang on the marks alone.
        blocks=np.zeros(mask.shape, bool) if blocks is None else blocks,
        seen=seen,
    )


def half_supported(rows: int, left: float = 1.0) -> np.ndarray:
    """Support 0 in the first rows, left of a column; 0.5 elsewhere."""
    support = np.full((SIDE, SIDE), 0.5)
    support[:rows, : round(left * SIDE)] = 0.0
    return support


CUTTING, HARMLESS = ((0, 30), (199, 30)), ((100, 120), (100, 180))


@pytest.mark.parametrize("share", [0.0, 0.25, 0.75, 1.0])
def test_the_unsupported_share_is_that_of_the_length(share: float) -> None:
    found = supported(drawn(CUTTING), half_supported(60, share))
    assert found.unsupported_share == pytest.approx(share, abs=0.02)
    assert found.supported == (share < 0.5)


def test_without_cracks_the_unsupported_share_is_that_of_the_area() -> None:
    nothing = np.zeros((SIDE, SIDE), bool)
    found = supported(nothing, half_supported(50))
    assert found.unsupported_share == pytest.approx(0.25)
    assert (found.supported, found.crack_class) == (True, "none")
    found = supported(nothing, half_supported(120))
    assert (found.supported, found.crack_class, found.marked_class) == (False, "unsure", "none")


def test_a_class_that_an_unsupported_crack_decides_is_unsure() -> None:
    both = drawn(CUTTING, HARMLESS)
    found = supported(both, half_supported(60))
    assert (found.crack_class, found.marked_class) == ("unsure", "C")
    assert supported(both, half_supported(0)).crack_class == "C"


def test_a_class_that_would_be_the_same_without_the_unsupported_crack_is_not_unsure() -> None:
    both = drawn(CUTTING, HARMLESS)
    support = half_supported(0)
    support[110:190] = 0.0
    found = supported(both, support)
    assert (found.crack_class, found.unsure) == ("C", False)
    assert found.unsupported_share == pytest.approx(60 / 260, abs=0.02)
    only = supported(drawn(HARMLESS), support)
    assert (only.crack_class, only.marked_class, only.supported) == ("unsure", "A", False)


def test_a_broad_dark_part_is_cut_off_whether_its_crack_is_supported_or_not() -> None:
    dark = np.zeros((SIDE, SIDE), bool)
    dark[:30] = True
    found = supported(drawn(CUTTING), half_supported(60), blocks=dark)
    assert (found.crack_class, found.unsure) == ("C", False)
    nothing = supported(np.zeros((SIDE, SIDE), bool), half_supported(0), blocks=dark)
    assert nothing.crack_class == "none"  # a person has erased the marks


def test_a_table_from_before_the_cut_off_parts_is_read() -> None:
    values = dict(zip(FEATURES, texts(measured(drawn(CUTTING))), strict=True))
    values.pop("cut_off_share")
    old = from_texts(0, 0, values)
    assert np.isnan(old.cut_off_share)
    assert old.crack_class == "unknown"


def test_without_a_support_map_nothing_is_unsure() -> None:
    found = measured(drawn(CUTTING))
    assert np.isnan(found.unsupported_share)
    assert found.supported
    assert not found.unsure


def test_a_dark_cell_without_support_is_dark() -> None:
    tile = np.full((SIDE, SIDE), 0.1, np.float32)
    found = measure_cell(
        tile,
        np.zeros_like(tile),
        0.5,
        row=0,
        col=0,
        cell_width_px=SIDE,
        usual_intensity=0.5,
        support=np.zeros_like(tile),
    )
    assert found.crack_class == "dark"


def test_support_is_that_of_the_marks_or_of_the_cell() -> None:
    mask = drawn(((20, 20), (180, 20)))
    support = np.where(mask, 0.2, 0.6).astype(np.float32)
    arguments = {"row": 0, "col": 0, "cell_width_px": SIDE, "usual_intensity": 0.5}
    tile = np.full(mask.shape, 0.5, np.float32)
    on_marks = measure_cell(tile, mask.astype(np.float32), 0.5, support=support, **arguments)
    assert on_marks.crack_support == pytest.approx(0.2)
    clean = measure_cell(tile, np.zeros_like(tile), 0.5, support=support, **arguments)
    assert clean.crack_support == pytest.approx(float(support.mean()))
    assert np.isnan(measured(mask).crack_support)


def weighed(mask: np.ndarray, **arguments: object) -> CellFeatures:
    tile = np.full(mask.shape, 0.5, np.float32)
    place = {"row": 0, "col": 0, "cell_width_px": SIDE, "usual_intensity": 0.5}
    probability = mask.astype(np.float32) * np.float32(0.9)
    return measure_cell(tile, probability, 0.5, **place, **arguments)  # type: ignore[arg-type]


def test_marks_that_are_too_short_give_no_class() -> None:
    mask = drawn(((20, 20), (36, 20)), ((20, 100), (36, 100)))
    strict, lenient = (
        weighed(mask, least_extent_cells=0.02, least_length_cells=least) for least in (0.15, 0.02)
    )
    assert strict.weak_marks
    assert (strict.crack_class, strict.marked_class) == ("unsure", "unknown")
    assert not strict.crack_suspected
    assert not lenient.weak_marks
    assert lenient.crack_suspected


def test_marks_of_a_cell_with_a_low_score_give_no_class() -> None:
    mask = drawn(((20, 20), (120, 20)))
    assert weighed(mask, least_score=0.95).crack_class == "unsure"
    assert weighed(mask, least_score=0.85).crack_class == "unknown"


def test_marks_without_length_never_give_a_class() -> None:
    mask = np.zeros((SIDE, SIDE), bool)
    mask[0, :2] = True  # twice as long as wide, but its centre line is thinned to nothing
    cell = weighed(mask, least_extent_cells=0.0)
    assert cell.has_marks
    assert cell.crack_length_cells == 0
    assert cell.crack_class == "unsure"


def test_what_a_person_has_marked_is_never_too_weak() -> None:
    mask = drawn(((20, 20), (30, 20)))
    cell = weighed(mask, marks=[mask], least_length_cells=0.5, least_score=0.99)
    assert not cell.weak_marks
    assert cell.crack_suspected


def test_a_cell_of_an_unknown_look_cant_be_judged_with_or_without_marks() -> None:
    for mask in (np.zeros((SIDE, SIDE), bool), drawn(((20, 20), (120, 20)))):
        assert weighed(mask, novelty=1.2).crack_class == "unsure"
        assert weighed(mask, novelty=0.8).crack_class != "unsure"


@pytest.mark.parametrize(
    ("seen", "judged"),
    [
        ((LEAST_DETAIL, MOST_BLUR), True),
        ((LEAST_DETAIL - 0.01, MOST_BLUR), False),
        ((LEAST_DETAIL, MOST_BLUR + 0.001), False),
        ((1.0, np.nan), False),
    ],
)
def test_a_cell_is_judged_if_cracks_would_show_whatever_its_support(
    seen: tuple[float, float], judged: bool
) -> None:
    """One photograph has no support at all; what can be judged depends on what was seen."""
    nothing = np.zeros((SIDE, SIDE), bool)
    for mask, usual in ((nothing, "none"), (drawn(CUTTING), "C")):
        found = supported(mask, half_supported(SIDE), seen=seen)
        assert (found.unsupported_share, found.marked_class) == (1.0, usual)
        assert (found.supported, found.crack_class == usual) == (judged, judged)
        assert found.undecidable is not judged


def test_a_broad_dark_part_is_class_c_also_where_cracks_would_not_show() -> None:
    dark = np.zeros((SIDE, SIDE), bool)
    dark[:40] = True
    found = supported(drawn(CUTTING), half_supported(0), blocks=dark, seen=(0.1, 0.05))
    assert found.crack_class == "C"


def test_interrupted_fingers_are_counted_and_make_no_class() -> None:
    tile = np.full((SIDE, SIDE), 0.5, np.float32)
    tile[65:110, 80:83] = tile[70:130, 150:152] = 0.3
    arguments = {"row": 0, "col": 0, "cell_width_px": SIDE, "usual_intensity": 0.5}
    bars = busbars(60, 140)
    nothing = np.zeros(tile.shape, np.float32)
    found = measure_cell(tile, nothing, 0.5, busbars=bars, **arguments)  # type: ignore[arg-type]
    assert found.finger_interruptions == 2
    assert found.finger_interruption_length_cells == pytest.approx(105 / SIDE, rel=0.15)
    assert (found.crack_class, found.crack_length_cells) == ("none", 0)
    # A mark on one of them: of the two a crack is worse, and it alone is counted.
    marked = np.zeros(tile.shape, np.float32)
    marked[65:110, 80:83] = 0.9
    crack = measure_cell(tile, marked, 0.5, busbars=bars, **arguments)  # type: ignore[arg-type]
    assert (crack.crack_class, crack.crack_instances, crack.finger_interruptions) == ("A", 1, 1)


def test_interrupted_fingers_are_unknown_where_they_are_not_looked_for() -> None:
    assert np.isnan(measured(drawn(CUTTING)).finger_interruptions)  # no busbars
    dark = supported(drawn(CUTTING), half_supported(0), beyond=1.0, seen=(0.1, 0.01))
    assert np.isnan(dark.finger_interruptions)  # cracks would not show
    assert with_busbars(np.zeros((SIDE, SIDE), bool)).finger_interruptions == 0
