"""A small part of the module, reconstructed again and again while the settings change.

The same equations and the same solver as for the whole module; what a change leaves valid is kept,
and the solver starts from the image before.
"""

from __future__ import annotations

from collections.abc import Generator, Iterator
from contextlib import contextmanager
from copy import copy
from dataclasses import dataclass, replace

import numba
import numpy as np
from numpy.typing import NDArray

from pv_inspect.common.parallel import one_at_a_time
from pv_inspect.errors import InspectionError
from pv_inspect.geometry.grid import HrGrid
from pv_inspect.geometry.rays import SensorRays
from pv_inspect.observation.model import ObservationModel
from pv_inspect.observation.motion_blur import STILL, motion_of
from pv_inspect.observation.normal_equations import NormalEquations
from pv_inspect.photometry.photometry import huber_weights, observed
from pv_inspect.reconstruction.held_out import View, seen_part
from pv_inspect.reconstruction.in_use import values_in_use
from pv_inspect.reconstruction.reconstruction import Reconstruction, brightness_of
from pv_inspect.reconstruction.resampling import resampled
from pv_inspect.reconstruction.solver import Problem, minimise
from pv_inspect.registration.module_mean import module_mean
from pv_inspect.registration.registration import Registration
from pv_inspect.sequence.sequence import FrameSequence
from pv_inspect.settings import Settings

__all__ = ["Preview", "Region", "RegionImage"]

Image = NDArray[np.float32]

# Around the cell, so that what lies beyond its border has the chance to explain the LR pixels.
_MARGIN_LR_PX = 4.0


@contextmanager
def _one_thread() -> Iterator[None]:
    """Run compiled code on one thread: on so few pixels more of them wait for each other."""
    threads = numba.get_num_threads()
    numba.set_num_threads(1)
    try:
        yield
    finally:
        numba.set_num_threads(threads)


@dataclass(frozen=True)
class Region:
    """A rectangle of cells, counted from the top left.

    Parameters
    ----------
    row, col : int
        Its first cell.
    rows, cols : int
        How many cells.
    """

    row: int
    col: int
    rows: int = 1
    cols: int = 1


@dataclass(frozen=True, eq=False)
class RegionImage:
    """Reconstruction of a region.

    Parameters
    ----------
    image : (height, width) float32
        Intensities, full scale = 1. A view that goes on changing until ``finished``.
    grid : HrGrid
        Where its pixels lie on the module.
    cell : tuple of slice
        [row, col] slices of the region without its margin.
    prior_weight, psf_sigma_lr_px : float
        lambda and optical blur that were used.
    iterations : int
    finished : bool
        Whether the solver has ended.
    """

    image: Image
    grid: HrGrid
    cell: tuple[slice, slice]
    prior_weight: float
    psf_sigma_lr_px: float
    iterations: int
    finished: bool


class Preview:
    """Reconstructs parts of one module again and again.

    Parameters
    ----------
    sequence : FrameSequence
    registration : Registration
    whole : Reconstruction, optional
        Of the whole module: PSF, motion and lambda are taken from it where the settings leave
        them open, and the brightness that the prior measures contrast against. Without it they
        are typical ones, and the frames are taken as still.

    Notes
    -----
    A change of lambda or of the prior keeps the equations; a change of the PSF or of the
    magnification builds them again, from the part of the frames that sees the region.
    """

    def __init__(
        self,
        sequence: FrameSequence,
        registration: Registration,
        whole: Reconstruction | None = None,
    ) -> None:
        self._sequence = sequence
        self._registration = registration
        self._whole = whole
        if whole is not None:
            self._known, self._known_grid = whole.image, whole.grid
        else:
            scale = registration.lr_px_per_unit
            self._known_grid = HrGrid.covering(registration.layout, scale, 1.0)
            with one_at_a_time():
                self._known = module_mean(sequence, registration, self._known_grid)[0]
        self._brightness = brightness_of(self._known, self._known_grid)
        self._seen: tuple[Region, str] | None = None
        self._views: list[View] = []
        self._built_for: tuple[HrGrid, float] | None = None
        self._equations: NormalEquations | None = None
        self._image: Image | None = None
        self._image_grid: HrGrid | None = None

    def with_registration(self, registration: Registration) -> Preview:
        """Return the preview for another geometry, after a change of kappa say.

        It starts from the image that this one has; what is known of the whole module stays.
        """
        other = copy(self)
        other._registration = registration
        other._seen, other._views = None, []
        other._built_for = other._equations = None
        return other

    def show(self, region: Region, settings: Settings) -> RegionImage:
        """Reconstruct a region; the last of what `refine` yields."""
        for shown in self.refine(region, settings):
            last = shown
        return last

    def refine(self, region: Region, settings: Settings) -> Iterator[RegionImage]:
        """Reconstruct a region, step by step.

        Parameters
        ----------
        region : Region
        settings : Settings

        Yields
        ------
        RegionImage
            After every step of the solver; the last one is finished. Closing the generator ends
            the work, and the next one begins from the image so far.

        Raises
        ------
        InspectionError
            If the module has no such region, or no frame sees it.
        """
        steps = self._steps(region, settings)
        while True:
            with one_at_a_time(), _one_thread():
                shown = next(steps, None)
            if shown is None:
                return
            yield shown

    def _steps(self, region: Region, settings: Settings) -> Generator[RegionImage, None, None]:
        grid, cell = self._window(region, settings.magnification)
        seen = (region, settings.motion_blur)
        if seen != self._seen:
            self._views = self._cut(grid, region, still=settings.motion_blur == "none")
            self._seen, self._built_for = seen, None
        used = values_in_use(settings, self._registration, self._whole)
        sigma, weight = used.psf_sigma_lr_px, used.prior_weight
        if self._equations is None or self._built_for != (grid, sigma):
            self._equations = self._built(grid, sigma)
            self._built_for = (grid, sigma)
        start = self._image
        if start is None or self._image_grid != grid:
            start = self._known_on(grid)
        problem = Problem(self._equations, weight, self._brightness, settings.prior)
        work = minimise(problem, start, settings.max_iterations, spectral=True)
        finished = False
        while not finished:
            try:
                state = next(work)
            except StopIteration as end:
                state, finished = end.value, True
            image = np.asarray(state.image, np.float32)
            self._image, self._image_grid = image, grid
            yield RegionImage(image, grid, cell, weight, sigma, state.iterations, finished)

    def _window(self, region: Region, magnification: float) -> tuple[HrGrid, tuple[slice, slice]]:
        """Grid of a region with its margin, and the region within it."""
        layout = self._registration.layout
        last = (region.row + region.rows - 1, region.col + region.cols - 1)
        inside = min(region.row, region.col) >= 0 and min(region.rows, region.cols) >= 1
        if not inside or last[0] >= layout.rows or last[1] >= layout.cols:
            raise InspectionError(
                f"There are no {region.rows} x {region.cols} cells at row {region.row}, column "
                f"{region.col} in a module of {layout.rows} x {layout.cols} cells: rows and "
                "columns count from 0."
            )
        whole = HrGrid.covering(layout, self._registration.lr_px_per_unit, magnification)
        begin = [s.start for s in whole.cell_slices(region.row, region.col)]
        end = [s.stop for s in whole.cell_slices(*last)]
        pad = int(np.ceil(_MARGIN_LR_PX * whole.magnification))
        low = [max(b - pad, 0) for b in begin]
        grid = whole.window(slice(low[0], end[0] + pad), slice(low[1], end[1] + pad))
        cell = tuple(slice(b - a, e - a) for a, b, e in zip(low, begin, end, strict=True))
        return grid, (cell[0], cell[1])

    def _cut(self, grid: HrGrid, region: Region, still: bool) -> list[View]:
        """What every frame sees of the region."""
        registration, whole, sequence = self._registration, self._whole, self._sequence
        camera, photometry = registration.camera, None if whole is None else whole.photometry
        seen = {}
        for i in np.flatnonzero(registration.used).tolist():
            part = seen_part(camera, registration.homographies[i], grid, sequence.shape)
            if part is not None:
                seen[i] = part
        if not seen:
            raise InspectionError(
                f"No frame that is used shows the cell in row {region.row}, column {region.col}: "
                "choose another cell."
            )
        # The rays of a pixel are the same in all frames.
        top, left = (min(part[axis].start for part in seen.values()) for axis in (0, 1))
        bottom, right = (max(part[axis].stop for part in seen.values()) for axis in (0, 1))
        rays = SensorRays.of(camera, sequence.shape, (slice(top, bottom), slice(left, right)))
        views = []
        for i, (rows, cols) in seen.items():
            g, weights = observed(sequence, registration, i, photometry, (rows, cols))
            motion = STILL if still or whole is None else motion_of(*whole.motion[i])
            within = (
                slice(rows.start - top, rows.stop - top),
                slice(cols.start - left, cols.stop - left),
            )
            H = registration.homographies[i]
            views.append(View(H, rays.cut(within), g, weights, motion))
        return views

    def _built(self, grid: HrGrid, sigma: float) -> NormalEquations:
        camera = self._registration.camera
        homographies = np.array([view.H for view in self._views])
        model = ObservationModel.build(self._views[0].rays, camera, homographies, grid, sigma)
        equations = NormalEquations.empty(model)
        # The mean of the frames is too blurred to tell which pixels contradict it.
        blurred = None if self._whole is None else model.blur.apply(self._known_on(grid))
        for view in self._views:
            weights = view.weights
            if blurred is not None:
                frame = replace(model, rays=view.rays).frame(view.H, view.motion)
                predicted = np.asarray(frame.sample(blurred), np.float32)
                weights = huber_weights(view.g, predicted, weights)
            equations.add(view.H, view.g, weights, view.motion, view.rays)
        return equations

    def _known_on(self, grid: HrGrid) -> Image:
        """What is known of the whole module, on a grid."""
        return resampled(self._known, self._known_grid, grid)
