"""What a camera profile says of the sensor, before the frames are looked at."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from pv_inspect.calibration.camera_profile import CameraProfile, ColumnsProfile
from pv_inspect.photometry.fixed_pattern import ColumnPattern, without_slow_columns
from pv_inspect.photometry.photometry import Photometry, falloff_alone, photometry_of
from pv_inspect.photometry.vignetting import Vignetting
from pv_inspect.registration.registration import Registration
from pv_inspect.sequence.sequence import FrameSequence

__all__ = ["known_sensor"]


def known_sensor(
    sequence: FrameSequence, registration: Registration, profile: CameraProfile | None
) -> Photometry | None:
    """Return what is known of the sensor from the registration and a profile; None if nothing.

    Parameters
    ----------
    sequence : FrameSequence
    registration : Registration
    profile : CameraProfile or None
        Its columns count where the frames were opened without dark and flat frame, and are no
        differences: those know better.
    """
    known = falloff_alone(sequence, registration)
    if profile is None:
        return known
    if known is None and profile.vignetting is not None:
        fall = profile.vignetting
        known = photometry_of(
            Vignetting(fall.coefficients, fall.deviations), sequence, registration
        )
    removed = sequence.removed_columns
    columns = profile.columns if removed is not None else None
    if columns is None and not profile.defective_pixels:
        return known
    known = known or Photometry.ideal(len(sequence), sequence.shape)
    response = known.response.copy()
    if columns is not None and removed is not None:
        pattern = pattern_of(columns)
        offset = without_slow_columns(pattern.offset - removed)
        response *= (1.0 + pattern.gain).astype(np.float32)
        known = replace(known, offsets=known.offsets + offset.astype(np.float32), columns=pattern)
    if profile.defective_pixels:
        rows, cols = np.transpose(profile.defective_pixels)
        response[rows, cols] = 0.0
    return replace(known, response=response)


def pattern_of(columns: ColumnsProfile) -> ColumnPattern:
    """Return the pattern that a profile holds."""
    return ColumnPattern(
        *(
            np.array(values, np.float64)
            for values in (
                columns.light,
                columns.level,
                columns.level_error,
                columns.gain,
                columns.gain_error,
            )
        )
    )
