"""What a run has come to, in a few lines for a terminal: doubts first, then the cells."""

from __future__ import annotations

from pathlib import Path

from pv_inspect.errors import printable
from pv_inspect.inspection.doubts import left_out
from pv_inspect.inspection.figures import RESIDUAL_MEANING, median_text
from pv_inspect.inspection.inspection import Inspection

__all__ = ["summary"]


def summary(inspection: Inspection, out: Path, seconds: float) -> str:
    """Sum a run up.

    Parameters
    ----------
    inspection : Inspection
        Complete.
    out : Path
        Where its result is.
    seconds : float
        How long the run took.

    Returns
    -------
    str
        Some lines, without the last line break.
    """
    registration, reconstruction = inspection.registration, inspection.reconstruction
    assert registration is not None
    assert reconstruction is not None
    assert inspection.cracks is not None
    used = registration.used
    rejected = [
        f"  not used: {name}: {why}"
        for k, (name, ok, why) in enumerate(
            zip(inspection.sequence.names, used, registration.why, strict=True)
        )
        if not ok and k not in inspection.sequence.copies  # one warning tells of all copies
    ]
    told_as_frame = left_out(inspection)
    height, width = reconstruction.image.shape
    lines = [
        *(f"IN DOUBT  {text}" for text in inspection.doubts),
        f"cells     {inspection.cracks.counts.text}",
        f"frames    {int(used.sum())} of {used.size} used",
        *rejected,
        f"residual  {median_text(reconstruction.residual_rms)} ({RESIDUAL_MEANING})",
        f"module    {width} x {height} px, {reconstruction.grid.magnification:.2f}x",
        *(f"warning   {text}" for text in inspection.warnings if text not in told_as_frame),
        f"results   {out}",
        f"report    {out / 'report.html'}",
        f"time      {seconds:.1f} s",
    ]
    return "\n".join(map(printable, lines))
