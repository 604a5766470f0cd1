from __future__ import annotations

import math

import pytest

from pv_inspect import __version__
from pv_inspect.errors import InspectionError
from pv_inspect.review import ModuleData, Verdict, VerdictKind, fingerprint, of_rater
from pv_inspect.settings import Settings


def test_every_verdict_has_a_key_a_colour_and_a_meaning_of_its_own() -> None:
    for what in ("key", "colour", "label", "meaning"):
        assert len({getattr(kind, what) for kind in VerdictKind}) == len(VerdictKind)
    for kind in VerdictKind:
        assert len(kind.key) == 1
        assert VerdictKind.of_key(kind.key.upper()) is kind
    assert VerdictKind.of_key("q") is None


def luminance(colour: str) -> float:
    parts = [int(colour[i : i + 2], 16) / 255 for i in (1, 3, 5)]
    linear = [c / 12.92 if c <= 0.04045 else ((c + 0.055) / 1.055) ** 2.4 for c in parts]
    return 0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2]


def test_black_letters_can_be_read_on_every_colour() -> None:
    """WCAG asks for a contrast of 3 for bold text of this size."""
    for kind in VerdictKind:
        assert (luminance(kind.colour) + 0.05) / 0.05 >= 3


def test_a_verdict_knows_when_and_with_what_it_was_given() -> None:
    verdict = Verdict(0, 1, VerdictKind.OK, "Ann")
    assert verdict.time.endswith("+00:00")
    assert verdict.software == __version__
    assert verdict.cell == (0, 1)


def test_a_verdict_without_rater_or_cell_is_refused() -> None:
    with pytest.raises(InspectionError, match="has no rater: give your name"):
        Verdict(0, 0, VerdictKind.OK, " ")
    with pytest.raises(InspectionError, match="no cell in row -1, column 0"):
        Verdict(-1, 0, VerdictKind.OK, "Ann")


def test_the_fingerprint_follows_the_settings() -> None:
    assert fingerprint(Settings()) == fingerprint(Settings())
    assert fingerprint(Settings()) != fingerprint(Settings(prior_weight=0.3))


@pytest.mark.parametrize("value", [0.0, -1.0, math.nan, math.inf])
def test_module_data_are_numbers_that_can_be(value: float) -> None:
    with pytest.raises(InspectionError, match=r"current_a is .*: give a number above 0"):
        ModuleData(current_a=value)
    assert ModuleData(temperature_c=-20).temperature_c == -20


def test_module_data_of_a_newer_version_are_read_as_far_as_they_are_known() -> None:
    assert ModuleData.from_mapping({"serial_number": "7", "colour": "blue"}) == ModuleData("7")


def test_verdicts_of_one_rater_are_found_by_cell() -> None:
    ann, bob = (Verdict(0, 0, VerdictKind.OK, rater) for rater in ("Ann", "Bob"))
    assert of_rater([ann, bob], "Bob") == {(0, 0): bob}
