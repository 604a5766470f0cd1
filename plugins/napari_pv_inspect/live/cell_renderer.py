"""Pictures of one cell: reconstructed with the settings of the sliders, or bicubic. No Qt."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from time import perf_counter

from napari_pv_inspect.models.cell_picture import Cell, CellPicture
from pv_inspect.errors import InspectionError
from pv_inspect.geometry.grid import HrGrid
from pv_inspect.inspection.inspection import Inspection
from pv_inspect.reconstruction.preview import Preview, Region
from pv_inspect.reconstruction.single_frame import best_frame, bicubic
from pv_inspect.registration.registration import Registration
from pv_inspect.settings import Settings

__all__ = [
    "CellRenderer",
    "basis_of",
    "bicubic_cell",
    "default_cell",
    "registration_for",
    "run_cell",
    "same_basis",
]


# Solver steps to the first picture: by then it differs from its end by a percent or so.
FIRST_STEPS = 12
# And while a slider moves on: the next picture begins where this one ends.
HURRIED_STEPS = 4
# Seconds between the pictures that follow while it gets better.
BETWEEN = 0.2


class CellRenderer:
    """Reconstructs cells of one inspection; keeps what a change of the settings leaves valid."""

    def __init__(self) -> None:
        self._known: tuple[object, ...] = ()
        self._base: Preview | None = None
        self._registered_for: tuple[object, ...] = ()
        self._preview: Preview | None = None

    def pictures(
        self,
        inspection: Inspection,
        cell: Cell,
        settings: Settings,
        hurry: Callable[[], bool] = lambda: False,
    ) -> Iterator[CellPicture | None]:
        """Reconstruct a cell.

        Parameters
        ----------
        hurry : callable
            Whether somebody waits for another picture.

        Yields
        ------
        CellPicture or None
            A picture when one is due, else None: a chance to give up.

        Raises
        ------
        InspectionError
            If no frame shows the cell, or the geometry does not allow it.
        """
        begun = shown_at = perf_counter()
        preview = self._preview_for(inspection, settings)
        yield None
        first = True
        for state in preview.refine(Region(*cell), settings):
            now = perf_counter()
            steps = HURRIED_STEPS if first and hurry() else FIRST_STEPS
            due = state.iterations >= steps if first else now - shown_at > BETWEEN
            if not (due or state.finished):
                yield None
                continue
            first, shown_at = False, now
            caption = (
                f"{state.grid.magnification:.2f}x, lambda {state.prior_weight:.3g}, PSF "
                f"{state.psf_sigma_lr_px:.2f} LR px, {state.iterations} steps, "
                f"{1e3 * (now - begun):.0f} ms"
            )
            image = state.image[state.cell].copy()
            yield CellPicture(image, cell, caption, settings, state.finished)

    def _preview_for(self, inspection: Inspection, settings: Settings) -> Preview:
        registration, whole = inspection.registration, inspection.reconstruction
        assert registration is not None
        if self._base is None or not same_basis(self._known, basis_of(inspection)):
            self._base = Preview(inspection.frames, registration, whole)
            self._known = basis_of(inspection)
            self._registered_for, self._preview = (), self._base
        wanted = (settings.kappa, settings.skip_frames)
        if wanted != self._registered_for or self._preview is None:
            there = registration_for(inspection, settings)
            self._preview = (
                self._base
                if there is registration
                else (self._preview or self._base).with_registration(there)
            )
            self._registered_for = wanted
        return self._preview


def registration_for(inspection: Inspection, settings: Settings) -> Registration:
    """Return the poses with the kappa and without the frames that the settings say.

    Raises
    ------
    InspectionError
        If no frame is left, or kappa is out of reach.
    """
    registration = inspection.registration
    assert registration is not None
    out = inspection.frames.indices(settings.skip_frames)
    if out and registration.used[out].any():
        used = registration.used.copy()
        used[out] = False
        if not used.any():
            raise InspectionError("All frames are left out: use at least one.")
        registration = replace(registration, used=used)
    kappa = settings.kappa
    if kappa is not None and abs(kappa - registration.camera.kappa) > 1e-9:
        registration = registration.with_kappa(kappa)
    return registration


def default_cell(inspection: Inspection) -> Cell:
    """Return the cell that is looked at first: with the highest crack score, else the middle."""
    if inspection.cracks is not None and inspection.cracks.cells:
        worst = max(inspection.cracks.cells, key=lambda cell: cell.crack_score)
        return worst.row, worst.col
    return inspection.layout.rows // 2, inspection.layout.cols // 2


def run_cell(inspection: Inspection, cell: Cell) -> CellPicture | None:
    """Return a cell of the last whole run, None without one."""
    made = inspection.reconstruction
    if made is None:
        return None
    caption = f"{made.grid.magnification:.2f}x, lambda {made.prior_weight:.3g}"
    return CellPicture(made.image[made.grid.cell_slices(*cell)], cell, caption)


def bicubic_cell(inspection: Inspection, cell: Cell, magnification: float) -> CellPicture:
    """Rectify a cell from its best frame: what there is without super-resolution."""
    registration = inspection.registration
    assert registration is not None
    made = inspection.reconstruction
    motion = None if made is None else made.motion
    frame = best_frame(registration, inspection.frames.shape, cell, motion)
    if frame is None:
        raise InspectionError("No frame in use shows this cell as a whole: choose another cell.")
    whole = HrGrid.covering(inspection.layout, registration.lr_px_per_unit, magnification)
    grid = whole.window(*whole.cell_slices(*cell))
    image = bicubic(inspection.frames, registration, grid, frame)
    return CellPicture(image, cell, inspection.frames.names[frame])


def basis_of(inspection: Inspection | None) -> tuple[object, ...]:
    """Return what pictures of an inspection are made of, apart from the settings."""
    return () if inspection is None else (inspection.registration, inspection.reconstruction)


def same_basis(a: tuple[object, ...], b: tuple[object, ...]) -> bool:
    """Whether pictures of one are pictures of the other."""
    return len(a) == len(b) and all(x is y for x, y in zip(a, b, strict=True))
