"""Text of the footer about the shown result: doubts first, then the cells. No Qt."""

from __future__ import annotations

from dataclasses import dataclass

from napari_pv_inspect.models.workbench import WorkbenchModel
from pv_inspect.cracks.wording import finger_text
from pv_inspect.inspection.inspection import Inspection
from pv_inspect.reconstruction.reconstruction import Reconstruction
from pv_inspect.settings import Stage

__all__ = ["Facts", "capitalised", "facts_of"]


@dataclass(frozen=True)
class Facts:
    """A result in words.

    Parameters
    ----------
    doubts : tuple of str
        Why it must not be relied on.
    cells : str
        How many cells are suspected, clean, dark or can't be judged; "" if that is not known.
    numbers : str
        Frames, kappa, magnification.
    warnings : tuple of str
        The rest of what is worth knowing. Frames that are not used are in the list of frames.
    details : str
        What there is no room for, with units, and how many fingers are interrupted.
    """

    doubts: tuple[str, ...] = ()
    cells: str = ""
    numbers: str = "No result yet."
    warnings: tuple[str, ...] = ()
    details: str = "Frames that are used, and the distortion of the lens."


def facts_of(model: WorkbenchModel) -> Facts:
    """Return what the footer says about the open inspection or result folder."""
    if model.why_hidden:
        return Facts(numbers=model.why_hidden)
    if model.inspection is not None:
        return _of_inspection(model.inspection, _is_earlier(model))
    if model.result is not None:
        return _of_inspection(model.result, is_earlier=False)
    return Facts()


def _is_earlier(model: WorkbenchModel) -> bool:
    """Whether the last run failed, so that an earlier result is shown."""
    return model.failure is not None and bool(model.to_do - {Stage.LOAD})


def _of_inspection(inspection: Inspection, is_earlier: bool) -> Facts:
    fit = inspection.registration or inspection.calibration
    if fit is None:
        return Facts()
    kappa = "kappa" if inspection.registration is not None else "preliminary kappa"
    numbers = f"{int(fit.used.sum())} of {len(fit.used)} frames, {kappa} {fit.camera.kappa:+.4f}"
    made, cracks = inspection.reconstruction, inspection.cracks
    details = Facts().details
    if made is not None:
        numbers += f", {made.grid.magnification:.2f}x"
        numbers = f"Earlier result: {numbers}" if is_earlier else numbers
        details = _details(made)
    if cracks is not None and (fingers := finger_text(cracks.cells)):
        details = f"{details} {capitalised(fingers)}."
    return Facts(
        inspection.doubts,
        "" if cracks is None else cracks.counts.short_text,
        numbers,
        _without_frames(inspection.warnings),
        details,
    )


def _details(made: Reconstruction) -> str:
    height, width = made.image.shape
    return (
        f"Module image {width} x {height} px, {made.grid.magnification:.2f} px per LR px, "
        f"lambda {made.prior_weight:.3g}, PSF sigma {made.psf_sigma_lr_px:.2f} LR px."
    )


def _without_frames(warnings: tuple[str, ...]) -> tuple[str, ...]:
    return tuple(text for text in warnings if "is not used" not in text)


def capitalised(text: str) -> str:
    """Begin with a capital letter; the rest stays as it is."""
    return text[:1].upper() + text[1:]
