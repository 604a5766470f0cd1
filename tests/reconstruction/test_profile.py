"""The reconstruction takes a camera profile into account."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from pv_inspect.calibration.camera_profile import (
    CameraProfile,
    ColumnsProfile,
    PsfProfile,
    VignettingProfile,
    write_profile,
)
from pv_inspect.common.work import result_of
from pv_inspect.reconstruction.reconstruct import reconstruct
from pv_inspect.settings import Settings
from tests.recording import SHAPE, SIGMA, recording, settings_with


def test_blur_and_vignetting_of_a_profile_are_used(tmp_path: Path) -> None:
    sequence, registration, _ = recording(1, moving=False)
    path = tmp_path / "camera.toml"
    profile = CameraProfile(
        width=SHAPE[1],
        height=SHAPE[0],
        results=5,
        psf=PsfProfile(sigma_lr_px=SIGMA + 0.2, error_lr_px=0.01),
        vignetting=VignettingProfile(coefficients=(-0.2,), deviations=(0.01,)),
    )
    write_profile(path, profile)
    settings = Settings(magnification=2.0, camera_profile=path, prior_weight=1.0, max_iterations=3)
    made = result_of(reconstruct(sequence, registration, settings))
    # One frame tells neither: the profile does.
    assert made.psf is not None
    assert made.psf.evidence == "camera profile"
    assert made.psf_sigma_lr_px == pytest.approx(SIGMA + 0.2, abs=0.003)
    assert made.photometry is not None
    assert made.photometry.vignetting.coefficients == (-0.2,)
    corner = made.photometry.response[0, 0] / made.photometry.response[32, 44]
    assert corner == pytest.approx(np.exp(-0.2), abs=0.03)


def test_columns_and_defective_pixels_of_a_profile_are_taken_out_of_a_single_frame(
    tmp_path: Path,
) -> None:
    sequence, registration, _ = recording(1, moving=False)
    rng = np.random.default_rng(3)
    height, width = SHAPE
    gain, offset = rng.normal(0, 0.05, width), rng.normal(0, 0.01, width)
    spoilt = sequence.images[0] * (1 + gain) + offset
    hot = ((30, 40), (31, 52))
    for row, col in hot:
        spoilt[row, col] = 0.95
    wrong = replace(sequence, images=(spoilt.astype(np.float32),))
    path = tmp_path / "camera.toml"
    profile = CameraProfile(
        width=width,
        height=height,
        results=5,
        columns=ColumnsProfile(
            light=(0.0,) * width,
            level=tuple(offset),
            level_error=(1e-4,) * width,
            gain=tuple(gain),
            gain_error=(1e-4,) * width,
        ),
        defective_pixels=hot,
    )
    write_profile(path, profile)
    plain = settings_with(max_iterations=20)
    best, without, with_it = (
        result_of(reconstruct(frames, registration, settings)).image
        for frames, settings in (
            (sequence, plain),
            (wrong, plain),
            (wrong, plain.changed(camera_profile=path)),
        )
    )
    assert np.isfinite(with_it).all()
    # The mean over the columns around stays in the offsets.
    assert np.abs(with_it - best).mean() < 0.35 * np.abs(without - best).mean()
    assert np.abs(with_it - best).max() < 0.35 * np.abs(without - best).max()
