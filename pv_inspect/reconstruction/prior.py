"""The prior R of Eq. 7: what the solver asks of it, and the names of those that there are."""

from __future__ import annotations

from typing import Literal, Protocol

import numpy as np
from numpy.typing import NDArray

from pv_inspect.observation.stencil import Quadratic
from pv_inspect.reconstruction.filter_prior import learned_prior, sparse_curvature
from pv_inspect.reconstruction.total_variation import Btv, WeightedBtv

__all__ = ["DEFAULT_PRIOR", "Prior", "PriorName", "prior_named"]

Image = NDArray[np.floating]
PriorName = Literal["learned", "sparse_curvature", "wbtv", "btv", "tikhonov"]
DEFAULT_PRIOR: PriorName = "learned"


class Prior(Protocol):
    """What the solver asks of a prior; images are (height, width), full-scale units."""

    def objective(self, image: Image) -> float:
        """R(f), summed in float64."""

    def majoriser(self, image: Image, factor: float = 1.0) -> Quadratic:
        """Return L; f' L f / 2 touches ``factor * R`` at the image and lies above it elsewhere."""

    def continued(self, image: Image, rounds: int, /) -> Prior:
        """Return the prior of the next round: itself, unless its scale follows the image.

        Parameters
        ----------
        image : (height, width)
            As it is after some rounds, each of which has minimised one majoriser.
        rounds : int
        """


def prior_named(name: PriorName, contrast: float) -> Prior:
    """Return the prior of a name.

    Parameters
    ----------
    name : {"learned", "sparse_curvature", "wbtv", "btv", "tikhonov"}
    contrast : float
        Unit that differences are measured in, full-scale units.
    """
    if name == "learned":
        return learned_prior(contrast)
    if name == "sparse_curvature":
        return sparse_curvature(contrast)
    if name == "wbtv":
        return WeightedBtv(contrast)
    if name == "btv":
        return Btv(contrast)
    return Btv(contrast, exponent=2.0)
