"""How much is read at most, so that a small file can't fill the memory."""

from __future__ import annotations

from dataclasses import dataclass

from pv_inspect.image_files.problems import ImageFileError, damaged

__all__ = ["MAX_FRAMES", "MAX_FRAME_MPX", "ReadLimits", "check_size"]

# The largest sensors of the usual formats have 61 Mpx (36 x 24 mm, Sony IMX455: 9576 x 6388);
# cameras for luminescence have 0.3 to 25.
MAX_FRAME_MPX = 64.0
# The paper uses 20; work and memory grow with the number, 300 frames are a long sequence.
MAX_FRAMES = 1000
# A picture with several channels, or of wider values, may have as many bytes as a grey one of 16
# bits: at the default limit it is decoded in under 2 s and 1 GiB.
_BYTES_PER_PX = 2
# Longer than any line camera; also what OpenCV decodes in one line of 4 x 16 bits.
_LONGEST_SIDE_PX = 100_000


@dataclass(frozen=True)
class ReadLimits:
    """Limits on what is read.

    Parameters
    ----------
    max_frame_mpx : float
        Largest picture that is decoded, millions of pixels.
    max_frames : int
        Largest number of frames of a sequence.
    """

    max_frame_mpx: float = MAX_FRAME_MPX
    max_frames: int = MAX_FRAMES


def check_size(height: int, width: int, pixel_bytes: int, limits: ReadLimits) -> None:
    """Check what a header says before anything is decoded.

    Parameters
    ----------
    height, width : int
        Size of the picture, px.
    pixel_bytes : int
        Bytes of one pixel in all its channels.
    limits : ReadLimits

    Raises
    ------
    ImageFileError
        If it is empty or too large.
    """
    if height < 1 or width < 1:
        raise damaged(f"its size is {width} x {height}")
    most = limits.max_frame_mpx
    mpx = height * width / 1e6
    says = f"is {width} x {height} px"
    if max(height, width) > _LONGEST_SIDE_PX:
        raise ImageFileError(
            f"{says}, but no side may be longer than {_LONGEST_SIDE_PX} px: crop it."
        )
    if mpx > most:
        in_all = f"{mpx:.0f}" if mpx > 10 else f"{mpx:.2f}"
        raise ImageFileError(
            f"{says} ({in_all} Mpx), more than the {most:g} Mpx that are read: crop or bin it, or "
            "raise max_frame_mpx if it is real."
        )
    if mpx * pixel_bytes > most * _BYTES_PER_PX:
        raise ImageFileError(
            f"{says} of {pixel_bytes} bytes each, more than the {most:g} Mpx of {_BYTES_PER_PX} "
            "bytes that are read: export it as grey, or raise max_frame_mpx if it is real."
        )
