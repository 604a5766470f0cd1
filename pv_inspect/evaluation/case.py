"""One sequence as every method sees it: the same frames, geometry, grid and cells."""

from __future__ import annotations

from collections.abc import Generator
from dataclasses import dataclass, replace
from time import process_time
from typing import cast

import numpy as np

from pv_inspect.calibration.calibrate import Calibration
from pv_inspect.common.work import Progress
from pv_inspect.detection.crossings import Crossings
from pv_inspect.errors import InspectionError
from pv_inspect.geometry.grid import HrGrid
from pv_inspect.geometry.layout import ModuleLayout
from pv_inspect.inspection.inspection import Part
from pv_inspect.pipeline import inspect_steps
from pv_inspect.registration.registration import Registration
from pv_inspect.sequence.sequence import FrameSequence
from pv_inspect.settings import Settings, Stage

__all__ = ["Case", "Cell", "prepared", "sampled_cells"]

Cell = tuple[int, int]

# Share of a run that the stages before the reconstruction take.
_GEOMETRY = 0.42


@dataclass(frozen=True, eq=False)
class Case:
    """A registered sequence, and the grid on which all methods are compared.

    Parameters
    ----------
    sequence : FrameSequence
    settings : Settings
        What the geometry was found with; ``magnification`` is that of the grid.
    crossings : Crossings
    calibration : Calibration
        Both for methods that register the frames in a way of their own.
    registration : Registration
        The geometry that all other methods share.
    grid : HrGrid
    geometry_cpu_s : float
        CPU time of the shared geometry.
    """

    sequence: FrameSequence
    settings: Settings
    crossings: Crossings
    calibration: Calibration
    registration: Registration
    grid: HrGrid
    geometry_cpu_s: float

    def half(self, which: int) -> Case:
        """Return the case with every second frame in use alone.

        Parameters
        ----------
        which : {0, 1}

        Raises
        ------
        InspectionError
            If no frame is left.
        """
        used = self.registration.used.copy()
        used[np.flatnonzero(used)[1 - which :: 2]] = False
        if not used.any():
            raise InspectionError(
                "One frame is in use, which has no halves: compare without --halves."
            )
        return replace(self, registration=replace(self.registration, used=used))

    def frame_of(self, cell: Cell) -> int:
        """Return the frame from which methods of one frame make a cell: the first that shows it.

        Raises
        ------
        InspectionError
            If no frame in use shows the whole cell.
        """
        corners = self.registration.layout.cell_corners(*cell)
        height, width = self.sequence.shape
        for i in np.flatnonzero(self.registration.used):
            px = self.registration.camera.project(self.registration.homographies[i], corners)
            inside = np.isfinite(px).all() and (px >= 0).all()
            if inside and (px <= [width - 1, height - 1]).all():
                return int(i)
        raise InspectionError(
            f"No frame shows the whole cell in row {cell[0] + 1}, column {cell[1] + 1}: compare "
            "other cells."
        )


def prepared(sequence: FrameSequence, settings: Settings) -> Generator[Progress, None, Case]:
    """Find the geometry of a sequence, as `pv_inspect.inspect` does, and stop before the image.

    Parameters
    ----------
    sequence : FrameSequence
    settings : Settings

    Yields
    ------
    Progress

    Returns
    -------
    Case

    Raises
    ------
    InspectionError
        If the module is not found or no frame can be registered.
    """
    begun = process_time()
    parts: dict[Stage, Part] = {}
    steps = inspect_steps(sequence, settings)
    try:
        for step in steps:
            if isinstance(step.partial, Crossings | Calibration | Registration):
                parts[step.stage] = step.partial
            if isinstance(step.partial, Registration):
                break
            yield Progress(min(step.fraction / _GEOMETRY, 1.0), step.message)
    finally:
        steps.close()
    crossings = cast(Crossings, parts[Stage.DETECT])
    calibration = cast(Calibration, parts[Stage.CALIBRATE])
    registration = cast(Registration, parts[Stage.REGISTER])
    if not registration.used.any():
        raise InspectionError(
            f"None of the {len(sequence)} frames could be registered, so there is nothing to "
            "compare: look at the reasons that pv-inspect run gives for the frames."
        )
    grid = HrGrid.covering(registration.layout, registration.lr_px_per_unit, settings.magnification)
    spent = process_time() - begun
    return Case(sequence, settings, crossings, calibration, registration, grid, spent)


def sampled_cells(layout: ModuleLayout, count: int, seed: int) -> list[Cell]:
    """Draw cells of a module without replacement, row by row; all of them if there are no more.

    Parameters
    ----------
    layout : ModuleLayout
    count : int
    seed : int
    """
    places = [(row, col) for row in range(layout.rows) for col in range(layout.cols)]
    if count >= len(places):
        return places
    drawn = np.random.default_rng(seed).choice(len(places), count, replace=False)
    return [places[k] for k in sorted(drawn)]
