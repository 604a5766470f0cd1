"""Results of one camera are pooled; what can't be evidence is refused."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tifffile
from typer.testing import CliRunner

from pv_inspect.calibration.camera_profile import read_profile
from pv_inspect.cli.app import app
from pv_inspect.errors import InspectionError
from pv_inspect.results.camera_evidence import pooled_profile
from pv_inspect.results.folder import results_in
from tests.camera_results import written_result


def test_results_are_pooled_in_one_gauge(tmp_path: Path) -> None:
    half = {"K": [[384.0, 0, 320.0], [0, 384.0, 255.0], [0, 0, 1]], "kappa": -0.051}
    folders = [
        written_result(tmp_path / "a"),
        # Half the focal length: kappa is -0.204 at the other one, its error 0.004.
        written_result(tmp_path / "b", camera={**half, "kappa_error": 0.001}, psf_sigma_lr_px=0.52),
    ]
    profile = pooled_profile(folders)
    assert (profile.width, profile.height, profile.results) == (640, 512, 2)
    assert profile.lens is not None
    assert profile.lens.kappa == pytest.approx((-0.2 * 4 - 0.204) / 5)
    assert profile.lens.principal_point_px == (320.0, 255.0)
    assert profile.psf is not None
    assert profile.psf.sigma_lr_px == pytest.approx(0.51, abs=1e-4)
    # 0.03 / sqrt(2), and 2 % that all may have in common.
    assert profile.psf.error_lr_px == pytest.approx(((0.03**2) / 2 + 0.0102**2) ** 0.5, rel=1e-3)
    assert profile.psf.shape == "gaussian"
    assert profile.vignetting is not None
    assert profile.vignetting.deviations == pytest.approx((0.01 / 2**0.5,))


def test_what_the_borders_show_is_pooled_and_not_what_each_scene_makes_of_it(
    tmp_path: Path,
) -> None:
    folders = []
    # Pitch of a cell: 100 px at 3x. Soft scenes make borders wide, never sharp.
    for k, width in enumerate((0.4, 0.4, 0.45, 0.45)):
        says = {"error_lr_px": 0.03, "evidence": "borders", "borders_lr_px": [width, 0.01]}
        folders.append(written_result(tmp_path / str(k), psf_sigma_lr_px=width, psf=says))
    psf = pooled_profile(folders).psf
    assert psf is not None
    assert psf.sigma_lr_px == pytest.approx(0.4, abs=0.01)


def test_a_pixel_is_defective_if_half_of_the_results_say_so(tmp_path: Path) -> None:
    pixels: list[Any] = [[[1, 2], [5, 6]], [[1, 2]], [[511, 639]], None]
    folders = [
        written_result(tmp_path / str(k), defective_pixels=told) for k, told in enumerate(pixels)
    ]
    assert pooled_profile(folders).defective_pixels == ((1, 2),)
    assert pooled_profile(folders[3:]).defective_pixels == ()


def test_columns_are_pooled_and_another_camera_is_told(tmp_path: Path) -> None:
    rng = np.random.default_rng(1)
    own, other = rng.normal(0, 0.01, (2, 640))
    folders = []
    for k in range(5):
        sums = np.zeros((2, 5, 640))
        sums[:, :3] = np.array([1e6, 3e5, 1e5])[:, None]
        level = (other if k == 3 else own) + rng.normal(0, 1e-3, (2, 640))
        sums[:, 3], sums[:, 4] = 1e6 * level, 3e5 * level
        folders.append(written_result(tmp_path / str(k)))
        tifffile.imwrite(
            folders[k] / "sensor_column_sums.tif", sums.reshape(10, 640).astype(np.float32)
        )
    profile = pooled_profile(folders)
    assert profile.columns is not None
    assert np.corrcoef(profile.columns.level, own)[0, 1] > 0.97
    # What all results may get wrong alike, 15 % of 0.01, is in the error.
    assert 0.0014 < np.median(profile.columns.level_error) < 0.0018
    assert profile.notes == (
        f"the columns of {folders[3]} do not show the pattern of the others: left out",
    )
    (folders[0] / "sensor_column_sums.tif").write_bytes(b"II")
    with pytest.raises(InspectionError, match=r"sensor_column_sums\.tif is damaged"):
        pooled_profile(folders)


def test_crossing_points_tell_kappa_where_no_lines_do(tmp_path: Path) -> None:
    bare = {"principal_point_error_px": None, "kappa": -0.1, "kappa_error": 1e-4}
    points = written_result(tmp_path / "points", camera=bare)
    lines = written_result(tmp_path / "lines")
    for folders, kappa in (([points, lines], -0.2), ([points], -0.1)):
        lens = pooled_profile(folders).lens
        assert lens is not None
        assert lens.kappa == pytest.approx(kappa)


def test_what_was_given_is_no_evidence(tmp_path: Path) -> None:
    given = {"error_lr_px": 0.0, "evidence": "given"}
    profile = pooled_profile(
        [
            written_result(tmp_path / "a"),
            written_result(
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
    folders = [written_result(tmp_path / "a"), written_result(tmp_path / "b", **changes)]
    with pytest.raises(InspectionError, match=says):
        pooled_profile(folders)


def test_a_result_counts_once_and_nothing_is_no_profile(tmp_path: Path) -> None:
    folder = written_result(tmp_path / "a")
    with pytest.raises(InspectionError, match="given twice"):
        pooled_profile([folder, tmp_path / "." / "a"])
    with pytest.raises(InspectionError, match=r"result\.json can't be read"):
        pooled_profile([tmp_path])
    empty = written_result(tmp_path / "c", settings={"kappa": 0.0}, psf=None, vignetting=None)
    with pytest.raises(InspectionError, match="None of the results tells anything"):
        pooled_profile([empty])


def test_the_command_writes_the_profile_and_names_outliers(tmp_path: Path) -> None:
    folders = [written_result(tmp_path / name) for name in "abcd"]
    folders.append(written_result(tmp_path / "odd", psf_sigma_lr_px=0.9))
    out = tmp_path / "camera.toml"
    told = CliRunner().invoke(app, ["calibrate", *map(str, folders), "--out", str(out)])
    assert told.exit_code == 0, told.output
    assert "blur 0.500 \u00b1 0.018 LR px, gaussian" in told.output
    assert "odd is 0.9, of the others 0.5: left out" in told.output
    assert read_profile(out).notes
    missing = CliRunner().invoke(app, ["calibrate", str(tmp_path / "no"), "-o", str(out)])
    assert missing.exit_code == 1


def test_a_folder_of_results_is_all_of_them_in_their_order(tmp_path: Path) -> None:
    made = [written_result(tmp_path / name) for name in ("run_10", "run_2")]
    (tmp_path / "notes").mkdir()
    assert results_in(tmp_path) == (made[1], made[0])
    assert results_in(made[0]) == (made[0],)
    with pytest.raises(InspectionError, match="is no result folder and holds none"):
        results_in(tmp_path / "notes")
    with pytest.raises(InspectionError, match="can't be read"):
        results_in(tmp_path / "missing")
