"""When which evidence of the optical blur is asked for."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from pv_inspect.common.work import result_of
from pv_inspect.reconstruction import psf_evidence
from pv_inspect.reconstruction.border_blur import BorderBlur
from pv_inspect.reconstruction.psf_combination import TYPICAL, Evidence, possible
from pv_inspect.reconstruction.psf_estimate import PsfEstimate
from pv_inspect.reconstruction.psf_evidence import estimate_psf
from pv_inspect.registration.registration import Registration


class _OfAModule:
    """What `estimate_psf` itself asks of a registration."""

    lr_px_per_unit = 50.0


def _estimated(
    borders: BorderBlur | None, pixels: float | None, further: tuple[Evidence, ...] = ()
) -> tuple[PsfEstimate, list[tuple[float, float]]]:
    """The estimate, and the limits within which held-out pixels were asked."""
    asked: list[tuple[float, float]] = []

    def held_out(*arguments: Any) -> Any:
        asked.append(arguments[-1])
        yield 1.0
        return pixels

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(psf_evidence, "_held_out_sigma", held_out)
        nothing: Any = None
        registration: Any = _OfAModule()
        assert not isinstance(registration, Registration)
        steps = estimate_psf(
            nothing, registration, None, nothing, np.zeros((1, 2)), borders, further
        )
        return result_of(steps), asked


def test_held_out_pixels_are_asked_within_what_borders_allow() -> None:
    borders = BorderBlur(0.45, 0.01, "gaussian", 50.0)
    found, asked = _estimated(borders, 0.4)
    assert asked == [possible(borders, 50.0)]
    assert found.sigma == pytest.approx(0.4, abs=0.005)


def test_held_out_pixels_are_not_asked_if_the_rest_says_it() -> None:
    found, asked = _estimated(BorderBlur(0.9, 0.015, "gaussian", 50.0), 0.5)
    assert asked == []
    assert found.evidence == "borders"
    profile = Evidence(0.42, 0.01, "camera profile")
    found, asked = _estimated(BorderBlur(0.45, 0.01, "gaussian", 50.0), 0.5, (profile,))
    assert asked == []
    assert found.evidence == "borders and camera profile"


def test_without_borders_held_out_pixels_are_asked_at_large() -> None:
    found, asked = _estimated(None, 0.4)
    assert (found.evidence, asked) == ("pixels", [psf_evidence.SEARCHED_LR_PX])
    assert _estimated(None, None)[0] == TYPICAL
