"""The HR module image, and what is known of it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pv_inspect.geometry.grid import HrGrid
from pv_inspect.photometry.photometry import Photometry
from pv_inspect.reconstruction.cell_sight import CellSight
from pv_inspect.reconstruction.prior import DEFAULT_PRIOR, PriorName
from pv_inspect.reconstruction.psf_estimate import PsfEstimate

__all__ = ["NO_CURVE", "Curve", "Reconstruction", "brightness_of"]

Image = NDArray[np.float32]


Curve = tuple[tuple[float, float], ...]


NO_CURVE: Curve = ()


@dataclass(frozen=True, eq=False)
class Reconstruction:
    """The HR module image.

    Parameters
    ----------
    image : (height, width) float32
        Intensities, full scale = 1.
    support : (height, width) float32
        0..1: share of a detail of 10 % contrast, just finer than the LR pixels, that comes from the
        frames; see
        `pv_inspect.reconstruction.support`.
    grid : HrGrid
        Where the pixels lie on the module.
    prior_weight : float
        lambda that was used.
    psf_sigma_lr_px : float
        Optical blur that was used, LR px.
    objective : tuple of float
        Value of Eq. 7 after every round of the solver.
    converged : bool
        False: the iteration limit came first.
    consistency : (height, width) float32
        Residual of the frames around a pixel in units of the noise: about 1 where they agree with
        the image, more where they contradict it, 0 where no frame looks.
    residual_rms : tuple of float
        Residual per frame (see `figures`): robust, in units of the noise; NaN if not in use.
    motion : tuple of (length, angle)
        Motion blur per frame, LR px and degrees in the sensor plane; (0, 0) for frames that are
        still or not in use.
    iterations : int
        Steps of the solver.
    lambda_curve : tuple of (float, float)
        Weights that were tried and what they left of held-out pixels with PSFs a little off, mean
        square in noise units;
        empty if the user gave lambda.
    photometry : Photometry, optional
        The sensor's part in the intensities, if it was looked for.
    prior : {"learned", "sparse_curvature", "wbtv", "btv", "tikhonov"}
        What ``prior_weight`` is the weight of.
    sight : CellSight, optional
        How well every cell was seen; not in results of earlier versions.
    psf : PsfEstimate, optional
        How the optical blur is known; None in results that don't say.
    """

    image: Image
    support: Image
    grid: HrGrid
    prior_weight: float
    psf_sigma_lr_px: float
    objective: tuple[float, ...]
    converged: bool
    consistency: Image
    residual_rms: tuple[float, ...]
    motion: tuple[tuple[float, float], ...]
    iterations: int
    lambda_curve: Curve = ()
    photometry: Photometry | None = None
    prior: PriorName = DEFAULT_PRIOR
    sight: CellSight | None = None
    psf: PsfEstimate | None = None


def brightness_of(image: Image, grid: HrGrid) -> float:
    """Median intensity of the module; the prior measures contrast against it.

    Parameters
    ----------
    image : (height, width) float32
        The whole module.
    grid : HrGrid
    """
    x0, y0 = np.round(grid.to_pixels(np.zeros(2)) + 0.5).astype(int)
    x1, y1 = np.round(grid.to_pixels(np.asarray(grid.layout.size)) + 0.5).astype(int)
    return max(float(np.median(image[y0:y1:2, x0:x1:2])), 1e-6)
