"""What a camera profile says of the blur, as one more piece of evidence."""

from __future__ import annotations

from pv_inspect.calibration.camera_profile import CameraProfile
from pv_inspect.reconstruction.psf_combination import Evidence

__all__ = ["PROFILE", "evidence_of"]

PROFILE = "camera profile"


def evidence_of(profile: CameraProfile | None) -> tuple[Evidence, ...]:
    """Return what a profile says of the blur, for `combined`; nothing without a profile.

    Parameters
    ----------
    profile : CameraProfile or None
    """
    known = None if profile is None else profile.sigma
    return () if known is None else (Evidence(known.value, known.error, PROFILE),)
