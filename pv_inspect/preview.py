"""A small part of the module, reconstructed again and again while the settings change.

The same equations and the same solver as for the whole module; what a change leaves valid is kept,
and the solver starts from the image before.
"""

from __future__ import annotations

from collections.abc import Callable, Generator
from dataclasses import dataclass, replace
from functools import wraps
from typing import ParamSpec, TypeVar

import numba
import numpy as np
from numpy.typing import NDArray

from pv_inspect.errors import InspectionError
from pv_inspect.layout import HrGrid
from pv_inspect.motion import motion_of
from pv_inspect.observation import NormalEquations, ObservationModel, SensorRays
from pv_inspect.photometry import huber_weights, observed
from pv_inspect.prediction import View, cut_view
from pv_inspect.reconstruction import Reconstruction, brightness_of
from pv_inspect.registration import Registration
from pv_inspect.sequence import Sequence
from pv_inspect.settings import Settings
from pv_inspect.solver import Problem, Solution, first_guess, minimise

__all__ = ["Preview", "Region", "RegionImage"]

Image = NDArray[np.float32]

# Around the cell, so that what lies beyond its border has the chance to explain the LR pixels.
_MARGIN_LR_PX = 4.0


P = ParamSpec("P")
T = TypeVar("T")


def _on_one_thread(function: Callable[P, T]) -> Callable[P, T]:
    """Run compiled code on one thread: on so few pixels more of them wait for each other."""

    @wraps(function)
    def run(*args: P.args, **kwargs: P.kwargs) -> T:
        threads = numba.get_num_threads()
        numba.set_num_threads(1)
        try:
            return function(*args, **kwargs)
        finally:
            numba.set_num_threads(threads)

    return run


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
        Intensities, full scale = 1.
    grid : HrGrid
        Where its pixels lie on the module.
    cell : tuple of slice
        [row, col] slices of the region without its margin.
    prior_weight, psf_sigma_lr_px : float
        lambda and optical blur that were used.
    iterations : int
    """

    image: Image
    grid: HrGrid
    cell: tuple[slice, slice]
    prior_weight: float
    psf_sigma_lr_px: float
    iterations: int


class Preview:
    """Reconstructs parts of one module again and again.

    Parameters
    ----------
    sequence : Sequence
    registration : Registration
    whole : Reconstruction
        Of the whole module: PSF, motion and lambda are taken from it where the settings leave
        them open, and the brightness that the prior measures contrast against.

    Notes
    -----
    A change of lambda or of the prior keeps the equations; a change of the PSF, of the region or
    of the magnification builds them again from the part of the frames that sees the region.
    """

    def __init__(
        self, sequence: Sequence, registration: Registration, whole: Reconstruction
    ) -> None:
        self._sequence = sequence
        self._registration = registration
        self._whole = whole
        self._brightness = brightness_of(whole.image, whole.grid)
        self._rays = SensorRays.of(registration.camera, sequence.shape)
        self._place: tuple[Region, float] | None = None
        self._views: list[View] = []
        self._sigma = float("nan")
        self._equations: NormalEquations | None = None
        self._image: Image | None = None

    def moved(self, registration: Registration) -> Preview:
        """Return the preview for another geometry, after a change of kappa say.

        It starts from the image that this one has.
        """
        other = Preview(self._sequence, registration, self._whole)
        other._image = self._image
        return other

    @_on_one_thread
    def show(self, region: Region, settings: Settings) -> RegionImage:
        """Reconstruct a region.

        Parameters
        ----------
        region : Region
        settings : Settings

        Returns
        -------
        RegionImage

        Raises
        ------
        InspectionError
            If the module has no such region, or no frame sees it.
        """
        grid, cell = self._window(region, settings.magnification)
        given = settings.psf_sigma_lr_px
        sigma = self._whole.psf_sigma_lr_px if given is None else given
        place = (region, settings.magnification)
        if place != self._place:
            self._views = self._cut(grid, region)
            self._equations = None
            if self._place not in (None, place):
                self._image = None
            self._place = place
        if self._equations is None or sigma != self._sigma:
            self._equations = self._built(grid, sigma)
            self._sigma = sigma
        equations = self._equations
        given = settings.prior_weight
        weight = self._whole.prior_weight if given is None else given
        start = self._image
        if start is None or start.shape != grid.shape:
            start = self._look(grid)
        if start is None:
            start = first_guess(equations)
        problem = Problem(equations, weight, self._brightness, settings.prior)
        solution = _solved(minimise(problem, start, settings.max_iterations))
        self._image = np.asarray(solution.image, np.float32)
        return RegionImage(self._image, grid, cell, weight, sigma, solution.iterations)

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

    def _cut(self, grid: HrGrid, region: Region) -> list[View]:
        """What every frame sees of the region."""
        registration = self._registration
        views = []
        for i in np.flatnonzero(registration.used):
            g, weights = observed(self._sequence, registration, int(i), self._whole.photometry)
            H = registration.homographies[i]
            motion = motion_of(*self._whole.motion[i])
            view = cut_view(registration.camera, H, self._rays, grid, g, weights, motion)
            if view is not None:
                views.append(view)
        if not views:
            raise InspectionError(
                f"No frame that is used shows the cell in row {region.row}, column {region.col}: "
                "choose another cell."
            )
        return views

    def _built(self, grid: HrGrid, sigma: float) -> NormalEquations:
        camera = self._registration.camera
        homographies = np.array([view.H for view in self._views])
        model = ObservationModel.build(self._views[0].rays, camera, homographies, grid, sigma)
        equations = NormalEquations.empty(model)
        look = self._look(grid)
        blurred = None if look is None else model.blur.apply(look)
        for view in self._views:
            weights = view.weights
            if blurred is not None:
                frame = replace(model, rays=view.rays).frame(view.H, view.motion)
                predicted = np.asarray(frame.sample(blurred), np.float32)
                weights = huber_weights(view.g, predicted, weights)
            equations.add(view.H, view.g, weights, view.motion, view.rays)
        return equations

    def _look(self, grid: HrGrid) -> Image | None:
        """What the image of the whole module shows of a grid; None at another magnification."""
        whole = self._whole.grid
        if whole.pixels_per_unit != grid.pixels_per_unit:
            return None
        left = round(whole.origin_px[0] - grid.origin_px[0])
        top = round(whole.origin_px[1] - grid.origin_px[1])
        height, width = grid.shape
        return self._whole.image[top : top + height, left : left + width].copy()


def _solved(work: Generator[Solution, None, Solution]) -> Solution:
    while True:
        try:
            next(work)
        except StopIteration as end:
            solution: Solution = end.value
            return solution
