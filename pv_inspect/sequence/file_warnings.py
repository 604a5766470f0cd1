"""What is worth knowing about the files of a sequence, in sentences."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

from pv_inspect.image_files.orientation import AS_STORED, said_of_orientation
from pv_inspect.sequence.frame_files import FrameFile
from pv_inspect.sequence.values import ValueScale, ValueSurvey

__all__ = ["said_of_frames"]


def said_of_frames(
    files: Sequence[FrameFile], survey: ValueSurvey, scale: ValueScale, n_tinted: int
) -> tuple[str, ...]:
    """Say what the kind of the files leaves unknown or changes.

    Parameters
    ----------
    files : sequence of FrameFile
    survey : ValueSurvey
    scale : ValueScale
    n_tinted : int
        Number of frames with a slight tint.
    """
    said = [
        _of_compression(files),
        _of_orientation(files),
        _of_tint(len(files), n_tinted),
        _of_computed(survey, scale),
        _of_gaps(survey, scale),
    ]
    return tuple(sentence for sentence in said if sentence)


def _of_compression(files: Sequence[FrameFile]) -> str:
    lossy = [file for file in files if file.picture.lossy]
    if not lossy:
        return ""
    names = " and ".join(sorted({file.format.name for file in lossy}))
    who = "The frames are" if len(lossy) == len(files) else f"{len(lossy)} frames are"
    return (
        f"{who} {names}, compressed with loss: faint detail, and the noise that tells how far "
        "the frames can be trusted, have been changed. Take TIFF or PNG if the camera can."
    )


def _of_orientation(files: Sequence[FrameFile]) -> str:
    found = Counter(file.picture.orientation for file in files)
    if set(found) == {AS_STORED}:
        return ""
    common, n = found.most_common(1)[0]
    if n == len(files):
        return (
            f"The frames are {said_of_orientation(common)}, as their orientation tag says; a "
            "calibration, dark or flat frame has to be turned alike."
        )
    return (
        "The frames have different orientation tags and are turned as these say: what the sensor "
        "does to fixed pixels can't be told from them."
    )


def _of_tint(n_frames: int, n_tinted: int) -> str:
    if not n_tinted:
        return ""
    who = "The frames have" if n_tinted == n_frames else f"{n_tinted} of {n_frames} frames have"
    return f"{who} colours with a slight tint: the mean of the channels is taken as grey."


def _of_computed(survey: ValueSurvey, scale: ValueScale) -> str:
    if scale.bit_depth is not None:
        return ""
    return (
        f"The frames hold computed values from {survey.minimum:.4g} to {survey.maximum:.4g}, not "
        f"the counts of a camera: {scale.full_scale:.6g} is taken as full scale, and where the "
        "camera was saturated is not known."
    )


def _of_gaps(survey: ValueSurvey, scale: ValueScale) -> str:
    if survey.n_wrapped:
        return (
            f"{survey.n_wrapped} dark pixels of the frames have wrapped round to very high values "
            "(something was subtracted in unsigned numbers): they are not used."
        )
    if not (survey.n_missing or survey.minimum < -scale.full_scale):
        return ""
    who = f"{survey.n_missing} pixels" if survey.n_missing else "Some pixels"
    return (
        f"{who} of the frames hold no usable number (infinite, not a number, or a filler far from "
        "all others): they are not used."
    )
