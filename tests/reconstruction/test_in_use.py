"""What counts where a setting is on automatic."""

from __future__ import annotations

from dataclasses import replace

from pv_inspect.reconstruction.in_use import values_in_use
from pv_inspect.reconstruction.prior import DEFAULT_PRIOR
from pv_inspect.reconstruction.prior_weight import typical_prior_weight
from pv_inspect.reconstruction.psf_estimation import TYPICAL_SIGMA_LR_PX
from pv_inspect.settings import Settings
from tests.handmade import made_reconstruction, made_registration


def test_what_is_given_counts_whatever_was_found() -> None:
    given = Settings(prior_weight=0.7, psf_sigma_lr_px=0.9, kappa=0.02)
    used = values_in_use(given, made_registration(), made_reconstruction())
    assert (used.prior_weight, used.psf_sigma_lr_px, used.kappa) == (0.7, 0.9, 0.02)


def test_what_the_last_run_found_counts_until_the_next_one() -> None:
    registration, made = made_registration(), made_reconstruction()
    used = values_in_use(Settings(), registration, made)
    assert (used.prior_weight, used.psf_sigma_lr_px) == (made.prior_weight, made.psf_sigma_lr_px)
    assert used.kappa == registration.camera.kappa


def test_before_the_first_run_values_are_typical_and_no_kappa_is_known() -> None:
    used = values_in_use(Settings())
    assert used.prior_weight == typical_prior_weight(DEFAULT_PRIOR)
    assert (used.psf_sigma_lr_px, used.kappa) == (TYPICAL_SIGMA_LR_PX, None)


def test_a_lambda_that_was_found_for_one_prior_means_nothing_to_another() -> None:
    made = replace(made_reconstruction(), prior="btv", prior_weight=0.123)
    assert values_in_use(Settings(), made=made).prior_weight != 0.123
    assert values_in_use(Settings(prior="btv"), made=made).prior_weight == 0.123
