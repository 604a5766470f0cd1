"""The reconstruction takes a camera profile into account."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from pv_inspect.calibration.camera_profile import (
    CameraProfile,
    PsfProfile,
    VignettingProfile,
    write_profile,
)
from pv_inspect.common.work import result_of
from pv_inspect.reconstruction.reconstruct import reconstruct
from pv_inspect.settings import Settings
from tests.recording import SHAPE, SIGMA, recording


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
