"""A camera profile is pooled by uncertainty, and acts as a prior."""

from __future__ import annotations

import errno
import os
from pathlib import Path

import numpy as np
import pytest

from pv_inspect.calibration.bundle_adjustment import Bundle, View
from pv_inspect.calibration.calibrate import with_profile
from pv_inspect.calibration.camera_profile import (
    CameraProfile,
    ColumnsProfile,
    LensProfile,
    PsfProfile,
    read_profile,
    write_profile,
)
from pv_inspect.calibration.pooling import pooled
from pv_inspect.errors import InspectionError
from pv_inspect.geometry.camera import Camera
from pv_inspect.reconstruction.profile_psf import evidence_of
from pv_inspect.reconstruction.psf_combination import combined

PROFILE = CameraProfile(
    width=640,
    height=512,
    results=10,
    notes=("kappa drifts",),
    lens=LensProfile(
        focal_length_px=768.0,
        kappa=-0.2,
        kappa_error=0.002,
        principal_point_px=(321.0, 254.0),
        principal_point_error_px=0.2,
    ),
    psf=PsfProfile(sigma_lr_px=0.5, error_lr_px=0.01, shape="disc"),
    columns=ColumnsProfile(
        light=(0.3,) * 640,
        level=(0.001, -0.001) * 320,
        level_error=(1e-4,) * 640,
        gain=(0.01, -0.01) * 320,
        gain_error=(0.0,) * 640,
    ),
    defective_pixels=((3, 4), (500, 639)),
)


def test_values_are_weighted_by_their_uncertainty() -> None:
    result = pooled(np.array([1.0, 2.0]), np.array([0.1, 0.3]))
    assert result.value == pytest.approx(1.1)
    # They differ by more than they claim: a Birge ratio of sqrt(1 / 0.1).
    assert result.error == pytest.approx(np.sqrt(0.009 * 10))
    assert pooled(np.array([1.0]), np.array([0.1]), shared=0.2).error == pytest.approx(
        np.hypot(0.1, 0.2)
    )


def test_an_outlier_is_left_out_and_named() -> None:
    values = np.array([0.50, 0.51, 0.49, 0.90, 0.505])
    result = pooled(values, np.full(5, 0.01))
    assert result.outliers == (3,)
    assert result.value == pytest.approx(0.50125)
    assert result.count == 4
    assert result.drift == 0.0


def test_a_drift_is_told_and_noise_is_not() -> None:
    noise = np.random.default_rng(0).normal(0, 0.01, 12)
    assert pooled(0.5 + noise, np.full(12, 0.01)).drift == 0.0
    drifting = pooled(0.5 + noise + np.linspace(0, 0.1, 12), np.full(12, 0.01))
    assert drifting.drift == pytest.approx(0.1, abs=0.03)


def test_a_profile_is_read_as_it_was_written(tmp_path: Path) -> None:
    path = tmp_path / "camera.toml"
    write_profile(path, PROFILE)
    assert read_profile(path, (512, 640)) == PROFILE
    assert PROFILE.described[-2:] == (
        "columns differ by 0.10 % of full scale, 1.00 % in gain",
        "2 defective pixels",
    )
    assert [p.name for p in tmp_path.iterdir()] == ["camera.toml"]


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("width = 640\nheight = 512\nresults = 1\ndefective_pixels = [[512, 0]]\n",
         r"defective pixel \[512, 0\] outside of 640 x 512 px"),
        ("width = 2\nheight = 2\nresults = 1\n[columns]\nlight = [0.1]\nlevel = [0.1]\n"
         "level_error = [0.1]\ngain = [0.1]\ngain_error = [0.1]\n",
         "1 numbers in columns.light, but a width of 2"),
        ("rows = 6\n", "is no camera profile .width is missing."),
        ("width = 640\nheight = 512\nresults = 1\n[psf]\nsigma_lr_px = -1\nerror_lr_px = 1\n",
         "psf.sigma_lr_px is -1"),
        ("width = 640\nheight = 512\nresults = 1\nformat = 9\n", "newer version"),
        ("width = ", "not valid TOML"),
    ],
)  # fmt: skip
def test_what_is_no_profile_is_told_in_one_sentence(tmp_path: Path, text: str, says: str) -> None:
    path = tmp_path / "camera.toml"
    path.write_text(text)
    with pytest.raises(InspectionError, match=says):
        read_profile(path)


def test_a_profile_of_another_size_or_place_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "camera.toml"
    write_profile(path, PROFILE)
    with pytest.raises(InspectionError, match="camera of 640 x 512 px, but the frames have 320"):
        read_profile(path, (256, 320))


def test_a_profile_is_written_as_a_whole_or_not_at_all(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with pytest.raises(InspectionError, match=r"there is no folder .*missing"):
        write_profile(tmp_path / "missing" / "camera.toml", PROFILE)
    with pytest.raises(InspectionError, match="is a folder"):
        write_profile(tmp_path, PROFILE)
    path = tmp_path / "camera.toml"
    write_profile(path, PROFILE)

    def full(_: int) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(InspectionError, match="the disk is full"):
        write_profile(path, PROFILE.model_copy(update={"results": 11}))
    assert read_profile(path) == PROFILE
    assert list(tmp_path.iterdir()) == [path]


def _fit(n_frames: int, noise_px: float, known: CameraProfile | None) -> tuple[float, float]:
    """Kappa and its error from frames of a camera with kappa -0.1 and another focal length."""
    camera = Camera(np.array([[384.0, 0, 319.5], [0, 384.0, 255.5], [0, 0, 1]]), -0.05)
    rng = np.random.default_rng(3)
    x, y = np.meshgrid(np.linspace(-1, 1, 7), np.linspace(-0.7, 0.7, 5))
    points = np.column_stack([x.ravel(), y.ravel()])
    views, starts = {}, {}
    for k in range(n_frames):
        H = np.array([[0.7, 0.02 * k, 0.01], [0, 0.7, 0], [0.03, 0.02, 1.0]])
        px = camera.project(H, points) + rng.normal(0, noise_px, points.shape)
        views[k] = View(np.arange(len(points)), points, px, np.full(len(points), noise_px))
        starts[k] = H
    bundle = Bundle(views, 384.0, (319.5, 255.5), 5.0, None)
    fit = (bundle if known is None else with_profile(bundle, known)).fit(starts)
    return float(fit.common[0]), fit.kappa_std


def test_the_profile_decides_where_the_frames_say_little_and_not_where_they_say_much() -> None:
    # At half of the focal length kappa is a quarter: -0.05, +- 0.0005.
    alone, error = _fit(1, 2.0, None)
    held, less = _fit(1, 2.0, PROFILE)
    assert abs(held + 0.05) < 0.001
    assert abs(alone + 0.05) > 2 * abs(held + 0.05)
    assert less < 0.0006 < error
    assert PROFILE.lens is not None
    wrong = PROFILE.lens.model_copy(update={"kappa": -0.4, "kappa_error": 0.2})
    free, _ = _fit(3, 0.02, PROFILE.model_copy(update={"lens": wrong}))
    assert free == pytest.approx(-0.05, abs=0.001)


def test_what_the_profile_says_of_the_blur_is_one_more_piece_of_evidence() -> None:
    known = combined(None, None, 50.0, evidence_of(PROFILE))
    assert known.sigma == pytest.approx(0.5, abs=0.002)
    assert known.error == pytest.approx(0.01, rel=0.1)
    assert known.words.endswith("from the camera profile")
    # Held-out pixels are not worth much by themselves.
    both = combined(None, 0.6, 50.0, evidence_of(PROFILE))
    assert both.evidence == "pixels and camera profile"
    assert abs(both.sigma - 0.5) < 0.03
    assert evidence_of(None) == evidence_of(PROFILE.model_copy(update={"psf": None})) == ()
