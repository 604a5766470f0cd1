"""One optical blur out of all evidence."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pv_inspect.reconstruction.border_blur import BorderBlur
from pv_inspect.reconstruction.psf_combination import (
    TYPICAL,
    Evidence,
    combined,
    combined_over_sequences,
    possible,
)
from pv_inspect.reconstruction.psf_estimate import PsfEstimate, PsfMeasurements

SHARP = BorderBlur(0.5, 0.01, "disc", 50.0)


def test_borders_allow_what_scenes_of_any_softness_would_show() -> None:
    least, largest = possible(SHARP, 50.0)
    assert least == pytest.approx(np.sqrt(0.5**2 - (0.0055 * 50) ** 2) - 0.01)
    assert largest == pytest.approx(0.51)


def test_held_out_pixels_decide_within_what_the_borders_allow() -> None:
    found = combined(SHARP, 0.45, 50.0)
    assert found.sigma == pytest.approx(0.45, abs=0.005)
    assert (found.evidence, found.shape) == ("borders and pixels", "disc")


@pytest.mark.parametrize("pixels", [0.25, 0.7])
def test_held_out_pixels_beyond_it_are_not_believed(pixels: float) -> None:
    borders = combined(SHARP, None, 50.0)
    assert combined(SHARP, pixels, 50.0).sigma == pytest.approx(borders.sigma, rel=0.02)
    assert borders.sigma == pytest.approx(0.5, rel=0.02)


def test_the_error_says_that_the_scene_may_be_soft() -> None:
    alone = combined(SHARP, None, 50.0)
    # A scene as soft as any would make 0.42 of 0.5.
    assert 0.02 < alone.error < 0.04
    # Held-out pixels are wrong in some scenes.
    assert combined(SHARP, 0.45, 50.0).error > 0.015
    wide = combined(replace(SHARP, sigma=0.8), None, 50.0)
    assert wide.error / wide.sigma < 0.6 * alone.error / alone.sigma


def test_further_evidence_counts_by_its_error() -> None:
    profile = Evidence(0.44, 0.006, "camera profile")
    found = combined(SHARP, None, 50.0, [profile])
    assert found.sigma == pytest.approx(0.44, abs=0.004)
    assert found.error < 0.007
    assert found.words == ", \u00b1 0.01, from the borders of the cells and the camera profile"
    vague = combined(SHARP, None, 50.0, [replace(profile, error=0.5)])
    assert vague.sigma == pytest.approx(combined(SHARP, None, 50.0).sigma, rel=0.01)
    only = combined(None, None, 50.0, [profile])
    assert (only.sigma, only.error) == pytest.approx((0.44, 0.006), rel=0.02)


def test_evidence_that_contradicts_itself_ends_in_between() -> None:
    found = combined(SHARP, None, 50.0, [Evidence(0.2, 0.002, "camera profile")])
    assert 0.19 < found.sigma < 0.5


def test_without_evidence_the_usual_blur_is_stated() -> None:
    assert combined(None, None, 50.0) == TYPICAL
    assert "usual" in TYPICAL.words
    assert "0.12" in TYPICAL.words


def test_held_out_pixels_alone_are_known_badly() -> None:
    found = combined(None, 0.4, 50.0)
    assert (found.sigma, found.evidence, found.shape) == (0.4, "pixels", "unknown")
    assert found.error > 0.08


def test_words_say_how_well_it_is_known() -> None:
    assert (
        PsfEstimate(0.5, 0.013, "borders").words == ", \u00b1 0.01, from the borders of the cells"
    )
    both = PsfEstimate(0.5, 0.013, "borders and pixels").words
    assert both.endswith("from the borders of the cells and held-out pixels")
    assert PsfEstimate(0.5, 0.0, "given").words == ", given"


def test_one_camera_over_sequences_is_as_sharp_as_its_sharpest_borders_show() -> None:
    # Optics of 0.4: two scenes are sharp, three as soft as 0.2 LR px.
    widths = [0.4, 0.405, *3 * [float(np.hypot(0.4, 0.2))]]
    told = [(combined(replace(SHARP, sigma=width), None, 50.0), 50.0) for width in widths]
    sigma, error = combined_over_sequences(told)
    assert sigma == pytest.approx(0.4, abs=0.01)
    assert error < 0.015
    # The mean of what each would say alone is wider than the optics.
    assert np.mean([psf.sigma for psf, _ in told]) > 0.42


def test_held_out_pixels_of_which_no_two_agree_hardly_move_what_borders_tell() -> None:
    borders = replace(SHARP, sigma=0.35, error=0.018)
    pixels = (0.31, 0.23, 0.385, 0.25, 0.335, 0.285, 0.23, 0.312)
    told = [(combined(borders, one, 50.0), 50.0) for one in pixels]
    sigma, error = combined_over_sequences(told)
    without, _ = combined_over_sequences([(combined(borders, None, 50.0), 50.0)] * len(pixels))
    assert sigma == pytest.approx(without, rel=0.02)
    assert 0.005 < error < 0.012
    assert np.mean([psf.sigma for psf, _ in told]) < 0.94 * without


def test_held_out_pixels_that_no_other_sequence_confirms_are_not_believed() -> None:
    wide = replace(SHARP, error=0.04)
    alone = combined(wide, 0.42, 50.0)
    assert alone.sigma < 0.43
    others = [combined(SHARP, None, 50.0)] * 3
    sigma, _ = combined_over_sequences([(psf, 50.0) for psf in (alone, *others)])
    assert sigma == pytest.approx(0.5, abs=0.01)


def test_an_estimate_of_which_no_more_is_known_counts_by_its_error() -> None:
    told = [(PsfEstimate(0.5, 0.01, "borders"), 50.0), (PsfEstimate(0.52, 0.01, "borders"), 50.0)]
    assert combined_over_sequences(told) == pytest.approx((0.51, 0.01 / 2**0.5), rel=1e-3)
    assert combined(SHARP, 0.45, 50.0).measured == PsfMeasurements((0.5, 0.01), 0.45)
