"""What a run has come to, in a few lines for a terminal: doubts first, then what kind of image."""

from __future__ import annotations

from pathlib import Path

from pv_inspect.cracks import CrackMap
from pv_inspect.cracks.wording import finger_text
from pv_inspect.errors import printable
from pv_inspect.inspection.doubts import left_out, no_super_resolution, not_used_sentence
from pv_inspect.inspection.figures import RESIDUAL_MEANING, median_text
from pv_inspect.inspection.inspection import Inspection
from pv_inspect.reconstruction.reconstruction import Reconstruction
from pv_inspect.registration.registration import Registration

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
    reconstruction, used = inspection.need(Reconstruction), inspection.need(Registration).used
    unused = left_out(inspection)
    sigma, psf = reconstruction.psf_sigma_lr_px, reconstruction.psf
    told = [not_used_sentence(*frame) for frame in unused]
    height, width = reconstruction.image.shape
    plain = no_super_resolution(inspection.need(Registration), inspection.frames.shape)
    fingers = finger_text(inspection.need(CrackMap).cells)
    told.append(plain)
    lines = [
        *(f"IN DOUBT  {text}" for text in inspection.doubts),
        *([f"warning   {plain}"] if plain else []),
        f"cells     {inspection.need(CrackMap).counts.text}",
        *([f"fingers   {fingers}"] if fingers else []),
        f"frames    {int(used.sum())} of {used.size} used",
        *(f"  not used: {name}: {why}" for name, why in unused),
        f"residual  {median_text(reconstruction.residual_rms)} ({RESIDUAL_MEANING})",
        f"module    {width} x {height} px, {reconstruction.grid.magnification:.2f}x",
        *([f"PSF       {sigma:.2f} LR px{psf.words}"] if psf else []),
        *(f"warning   {text}" for text in inspection.warnings if text not in told),
        f"results   {out}",
        f"report    {out / 'report.html'}",
        f"time      {seconds:.1f} s",
    ]
    return "\n".join(map(printable, lines))
