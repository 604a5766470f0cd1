from __future__ import annotations

from pathlib import Path

import pytest

from pv_inspect.errors import InspectionError
from pv_inspect.settings import Settings, Stage


def test_a_changed_setting_makes_its_stage_and_no_earlier_one_stale() -> None:
    settings = Settings()
    assert settings.first_stale_stage(settings) is None
    assert settings.first_stale_stage(settings.changed(prior_weight=1.0)) is Stage.RECONSTRUCT
    assert settings.first_stale_stage(settings.changed(kappa=0.1)) is Stage.CALIBRATE
    ablation = settings.changed(registration_model="homography")
    assert settings.first_stale_stage(ablation) is Stage.REGISTER
    file = settings.changed(calibration_file=Path("camera.yml"))
    assert settings.first_stale_stage(file) is Stage.CALIBRATE
    both = settings.changed(kappa=0.1, magnification=3)
    assert settings.first_stale_stage(both) is Stage.CALIBRATE


def test_every_setting_says_its_unit_stage_and_meaning() -> None:
    for name, field in Settings.model_fields.items():
        assert Settings.unit_of(name)
        assert Settings.stage_of(name) in Stage
        assert field.description


def test_settings_survive_a_toml_file(tmp_path: Path) -> None:
    settings = Settings(
        rows=6, kappa=-0.2, dark_frame=Path('odd "name"\\dark.tif'), skip_frames=("a'b.tif",)
    )
    path = tmp_path / "settings.toml"
    path.write_text(settings.to_toml(), encoding="utf-8")
    assert Settings.from_toml(path) == settings


@pytest.mark.parametrize(
    ("values", "text"),
    [
        ({"magnification": 9}, r"magnification is 9 \[1\]: input should be less than"),
        ({"lambda_": 1}, "no setting 'lambda_': use one of rows"),
        ({"kappa": float("nan")}, "kappa is nan"),
        ({"rows": "many"}, "rows is 'many'"),
        ({"rows": 10**5000}, "rows is a number of thousands of digits"),
        ({"registration_model": "ecc"}, "is 'ecc' .*should be 'camera' or 'homography'"),
    ],
)
def test_a_wrong_value_is_named_with_its_range(values: dict[str, object], text: str) -> None:
    with pytest.raises(InspectionError, match=text):
        Settings.create(**values)


def test_a_bad_settings_file_is_one_sentence(tmp_path: Path) -> None:
    with pytest.raises(InspectionError, match="can't be read"):
        Settings.from_toml(tmp_path / "none.toml")
    path = tmp_path / "bad.toml"
    path.write_text("rows = [", encoding="utf-8")
    with pytest.raises(InspectionError, match="not valid TOML"):
        Settings.from_toml(path)
    for content in ("a = " + "[" * 5000, "rows = 1" + "0" * 5000, "# " + "x" * 2**20):
        path.write_text(content, encoding="utf-8")
        with pytest.raises(InspectionError, match=r"too deep|not valid TOML|at most 1048576"):
            Settings.from_toml(path)
    path.write_text("rows = 0", encoding="utf-8")
    with pytest.raises(InspectionError, match=r"bad\.toml: Setting rows is 0"):
        Settings.from_toml(path)


def test_a_slider_spans_usual_values_within_the_limits() -> None:
    for name in ("kappa", "magnification", "prior_weight", "psf_sigma_lr_px"):
        least, most = Settings.limits_of(name)
        low, high = Settings.slider_of(name)
        assert least is not None
        assert most is not None
        assert least <= low < high <= most
    assert Settings.slider_of("prior_weight")[0] > 0  # it is logarithmic
    with pytest.raises(ValueError, match="detector has no range"):
        Settings.slider_of("detector")


def test_stages_compare_by_their_order_not_by_their_names() -> None:
    assert sorted(Stage, key=str.__str__) != list(Stage)
    assert sorted(set(Stage)) == list(Stage)
    assert Stage.CALIBRATE > Stage.DETECT
    assert max(Stage.CELLS, Stage.REGISTER) is Stage.CELLS
