"""What counts where a setting is left to be found: lambda, the PSF and kappa."""

from __future__ import annotations

from dataclasses import dataclass

from pv_inspect.reconstruction.prior_weight import typical_prior_weight
from pv_inspect.reconstruction.psf_estimation import TYPICAL_SIGMA_LR_PX
from pv_inspect.reconstruction.reconstruction import Reconstruction
from pv_inspect.registration.registration import Registration
from pv_inspect.settings import Settings

__all__ = ["ValuesInUse", "values_in_use"]


@dataclass(frozen=True)
class ValuesInUse:
    """Values of the settings that may be found instead of given.

    Parameters
    ----------
    prior_weight : float
        lambda.
    psf_sigma_lr_px : float
        Optical blur, LR px.
    kappa : float or None
        None: it is neither given nor fitted yet.
    """

    prior_weight: float
    psf_sigma_lr_px: float
    kappa: float | None


def values_in_use(
    settings: Settings,
    registration: Registration | None = None,
    made: Reconstruction | None = None,
) -> ValuesInUse:
    """Return what is given; else what a run has found; before the first run typical values.

    Parameters
    ----------
    settings : Settings
        The present ones, which may differ from those of the run.
    registration : Registration, optional
    made : Reconstruction, optional
        Of the last run. Its lambda counts for its own prior only: to another it means nothing.
    """
    weight, sigma, kappa = settings.prior_weight, settings.psf_sigma_lr_px, settings.kappa
    if weight is None:
        known = made is not None and made.prior == settings.prior
        weight = made.prior_weight if made and known else typical_prior_weight(settings.prior)
    if sigma is None:
        sigma = TYPICAL_SIGMA_LR_PX if made is None else made.psf_sigma_lr_px
    if kappa is None and registration is not None:
        kappa = registration.camera.kappa
    return ValuesInUse(weight, sigma, kappa)
