"""One optical blur out of all evidence."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pv_inspect.reconstruction.border_blur import BorderBlur
from pv_inspect.reconstruction.psf_combination import TYPICAL, Evidence, combined, possible
from pv_inspect.reconstruction.psf_estimate import PsfEstimate

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
