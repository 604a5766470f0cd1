"""Results of one camera are pooled; what can't be evidence is refused."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

from pv_inspect.calibration.camera_profile import read_profile
from pv_inspect.cli.app import app
from pv_inspect.errors import InspectionError
from pv_inspect.results.camera_evidence import pooled_profile


def _result(folder: Path, **changes: Any) -> Path:
    """What ``result.json`` says, as far as a profile needs it and the record wants it."""
    record: dict[str, Any] = {
        "format": 2,
        "layout": {"rows": 2, "cols": 3, "cell_aspect": 1.0},
        "camera": {
            "K": [[768.0, 0, 320.0], [0, 768.0, 255.0], [0, 0, 1]],
            "kappa": -0.2,
            "kappa_error": 0.002,
            "principal_point_error_px": 0.5,
        },
        "frames": [
            {"file": "a.tif", "used": False, "why": "black", "crossings_px": None, "H": None,
             "gain": None, "offset": None, "rms": None}
        ],
        "settings": {},
        "origin_px": [0.0, 0.0],
        "pixels_per_cell": [100.0, 100.0],
        "magnification": 3.0,
        "crack_threshold": 0.5,
        "crack_detector": "network",
        "prior_weight": 1.0,
        "psf_sigma_lr_px": 0.5,
        "psf": {"error_lr_px": 0.03, "evidence": "borders and pixels", "shape": "gaussian"},
        "vignetting": {"coefficients": [-0.15], "deviations": [0.01]},
        "frame_px": [640, 512],
        "solver": {"objective": [1.0], "iterations": 3, "converged": True},
        "seconds": {},
        "warnings": [],
        "versions": {},
    }  # fmt: skip
    for name, value in changes.items():
        record[name] = {**record[name], **value} if isinstance(value, dict) else value
    folder.mkdir()
    (folder / "result.json").write_text(json.dumps(record))
    return folder


def test_results_are_pooled_in_one_gauge(tmp_path: Path) -> None:
    half = {"K": [[384.0, 0, 320.0], [0, 384.0, 255.0], [0, 0, 1]], "kappa": -0.051}
    folders = [
        _result(tmp_path / "a"),
        # Half the focal length: kappa is -0.204 at the other one, its error 0.004.
        _result(tmp_path / "b", camera={**half, "kappa_error": 0.001}, psf_sigma_lr_px=0.52),
    ]
    profile = pooled_profile(folders)
    assert (profile.width, profile.height, profile.results) == (640, 512, 2)
    assert profile.lens is not None
    assert profile.lens.kappa == pytest.approx((-0.2 * 4 - 0.204) / 5)
    assert profile.lens.principal_point_px == (320.0, 255.0)
    assert profile.psf is not None
    assert profile.psf.sigma_lr_px == pytest.approx(0.51)
    # 0.03 / sqrt(2), and 2 % that all may have in common.
    assert profile.psf.error_lr_px == pytest.approx(((0.03**2) / 2 + 0.0102**2) ** 0.5)
    assert profile.psf.shape == "gaussian"
    assert profile.vignetting is not None
    assert profile.vignetting.deviations == pytest.approx((0.01 / 2**0.5,))


def test_what_was_given_is_no_evidence(tmp_path: Path) -> None:
    given = {"error_lr_px": 0.0, "evidence": "given"}
    profile = pooled_profile(
        [
            _result(tmp_path / "a"),
            _result(
                tmp_path / "b",
                settings={"kappa": -0.4},
                camera={"kappa": -0.4},
                psf_sigma_lr_px=2.0,
                psf=given,
            ),
        ]
    )
    assert profile.lens is not None
    assert profile.lens.kappa == pytest.approx(-0.2)
    assert profile.psf is not None
    assert profile.psf.sigma_lr_px == pytest.approx(0.5)


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({"settings": {"camera_profile": "camera.toml"}}, "no evidence of its own"),
        ({"frame_px": None}, "earlier version"),
        ({"frame_px": [320, 256]}, "give results of one camera"),
        ({"psf_sigma_lr_px": "wide"}, "can't be read"),
    ],
)
def test_what_can_not_be_evidence_is_refused(
    tmp_path: Path, changes: dict[str, Any], says: str
) -> None:
    folders = [_result(tmp_path / "a"), _result(tmp_path / "b", **changes)]
    with pytest.raises(InspectionError, match=says):
        pooled_profile(folders)


def test_a_result_counts_once_and_nothing_is_no_profile(tmp_path: Path) -> None:
    folder = _result(tmp_path / "a")
    with pytest.raises(InspectionError, match="given twice"):
        pooled_profile([folder, tmp_path / "." / "a"])
    with pytest.raises(InspectionError, match=r"result\.json can't be read"):
        pooled_profile([tmp_path])
    empty = _result(tmp_path / "c", settings={"kappa": 0.0}, psf=None, vignetting=None)
    with pytest.raises(InspectionError, match="None of the results tells anything"):
        pooled_profile([empty])


def test_the_command_writes_the_profile_and_names_outliers(tmp_path: Path) -> None:
    folders = [_result(tmp_path / name) for name in "abcd"]
    folders.append(_result(tmp_path / "odd", psf_sigma_lr_px=0.9))
    out = tmp_path / "camera.toml"
    told = CliRunner().invoke(app, ["calibrate", *map(str, folders), "--out", str(out)])
    assert told.exit_code == 0, told.output
    assert "blur 0.500 \u00b1 0.018 LR px, gaussian" in told.output
    assert "odd is 0.9, of the others 0.5: left out" in told.output
    assert read_profile(out).notes
    missing = CliRunner().invoke(app, ["calibrate", str(tmp_path / "no"), "-o", str(out)])
    assert missing.exit_code == 1
