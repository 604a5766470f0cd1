"""What is declared of every setting is enough to build its control."""

from __future__ import annotations

from pathlib import Path

import pytest

from pv_inspect.settings import Group, Settings


@pytest.mark.parametrize("name", Settings.model_fields)
def test_every_setting_is_declared_for_a_control_or_says_what_sets_it(name: str) -> None:
    declared, (kind, optional) = Settings.declared(name), Settings.kind_of(name)
    assert declared.title
    assert optional == (Settings.model_fields[name].default is None)
    # A switch that may be left to the program has three positions: a box, not a mark to set.
    switch = {"yes", "no"} if kind is bool and optional else set()
    assert set(declared.choices) == set(Settings.choices_of(name)) | switch
    assert bool(declared.files) == (kind is Path)
    if declared.slider is not None:
        assert kind is float
        least, most = Settings.limits_of(name)
        low, high = declared.slider
        assert least is None or least <= low
        assert most is None or high <= most
        assert low > 0 or not declared.logarithmic
    if not declared.set_by:
        assert Settings.choices_of(name) or kind in (
            int,
            float,
            bool,
            str,
            Path,
            tuple[float, float],
        )


def test_every_setting_is_in_one_form() -> None:
    names = [name for group in Group for name in Settings.names_in(group)]
    assert sorted(names) == sorted(Settings.model_fields)
    assert Settings.names_in(Group.LENS) == (
        "kappa",
        "focal_length_px",
        "calibration_file",
        "camera_profile",
    )
