"""A region is reconstructed like the whole module, and again at little cost."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from pv_inspect.common.work import result_of
from pv_inspect.errors import InspectionError
from pv_inspect.geometry.grid import HrGrid
from pv_inspect.geometry.rays import SensorRays
from pv_inspect.photometry.photometry import observed
from pv_inspect.reconstruction.held_out import cut_view
from pv_inspect.reconstruction.preview import Preview, Region
from pv_inspect.reconstruction.reconstruct import reconstruct
from pv_inspect.reconstruction.reconstruction import Reconstruction
from pv_inspect.registration.registration import Registration
from tests.recording import LAYOUT, recording, settings_with

SETTINGS = settings_with(max_iterations=300)


@pytest.fixture(scope="module")
def made() -> tuple[Any, Registration, Reconstruction]:
    sequence, registration, _ = recording(12)
    return sequence, registration, result_of(reconstruct(sequence, registration, SETTINGS))


def cell_of(whole: Reconstruction, row: int, col: int) -> np.ndarray:
    return whole.image[whole.grid.cell_slices(row, col)]


def test_a_cell_looks_as_it_does_in_the_whole_module(
    made: tuple[Any, Registration, Reconstruction],
) -> None:
    sequence, registration, whole = made
    shown = Preview(sequence, registration, whole).show(Region(1, 1), SETTINGS)
    expected = cell_of(whole, 1, 1)
    assert shown.image[shown.cell].shape == expected.shape
    rms = float(np.sqrt(np.mean((shown.image[shown.cell] - expected) ** 2)))
    assert rms < 0.02 * float(expected.std())


def test_a_region_of_several_cells_lies_where_its_grid_says(
    made: tuple[Any, Registration, Reconstruction],
) -> None:
    sequence, registration, whole = made
    shown = Preview(sequence, registration, whole).show(Region(0, 1, 2, 2), SETTINGS)
    height, width = shown.image[shown.cell].shape
    assert (width, height) == (2 * whole.grid.pixels_per_cell[0], 2 * whole.grid.pixels_per_cell[1])
    first = np.array([shown.cell[1].start - 0.5, shown.cell[0].start - 0.5])
    np.testing.assert_allclose(shown.grid.to_module(first), [1.0, 0.0], atol=1e-9)


def test_a_change_back_and_forth_ends_where_it_began(
    made: tuple[Any, Registration, Reconstruction],
) -> None:
    sequence, registration, whole = made
    view = Preview(sequence, registration, whole)
    # Squares have one minimiser. The margin around the cell, of which the corner of the module is
    # seen by no frame, reaches it late and is not shown.
    convex = SETTINGS.changed(prior="tikhonov", prior_weight=0.05)
    first = view.show(Region(0, 2), convex)
    other = view.show(Region(0, 2), convex.changed(prior_weight=5.0))
    again = view.show(Region(0, 2), convex)
    assert np.abs(other.image[other.cell] - first.image[first.cell]).max() > 0.005
    apart = (again.image - first.image)[first.cell]
    assert float(np.sqrt(np.mean(apart**2))) < 0.0003


def test_another_psf_and_another_magnification_are_taken_over(
    made: tuple[Any, Registration, Reconstruction],
) -> None:
    sequence, registration, whole = made
    view = Preview(sequence, registration, whole)
    sharp = view.show(Region(1, 0), SETTINGS.changed(psf_sigma_lr_px=0.3))
    wide = view.show(Region(1, 0), SETTINGS.changed(psf_sigma_lr_px=0.6))
    assert (sharp.psf_sigma_lr_px, wide.psf_sigma_lr_px) == (0.3, 0.6)
    assert wide.image[wide.cell].std() > sharp.image[sharp.cell].std()
    coarse = view.show(Region(1, 0), SETTINGS.changed(magnification=2.0))
    assert coarse.grid.magnification == pytest.approx(2.0, rel=0.05)
    assert coarse.image.shape < wide.image.shape


def test_another_geometry_shows_the_cell_elsewhere(
    made: tuple[Any, Registration, Reconstruction],
) -> None:
    sequence, registration, whole = made
    view = Preview(sequence, registration, whole)
    before = view.show(Region(0, 0), SETTINGS)
    shift = np.array([[1.0, 0, 0.05], [0, 1, 0], [0, 0, 1]])
    moved = replace(registration, homographies=registration.homographies @ shift)
    after = view.with_registration(moved).show(Region(0, 0), SETTINGS)
    px = round(0.05 * before.grid.pixels_per_unit)
    y, x = before.cell
    inner = np.s_[y.start + 4 : y.stop - 4, x.start + 4 : x.stop - 4 - px]
    there = np.s_[y.start + 4 : y.stop - 4, x.start + 4 + px : x.stop - 4]
    assert np.corrcoef(after.image[inner].ravel(), before.image[there].ravel())[0, 1] > 0.9


def test_a_region_sees_in_every_frame_what_is_cut_out_of_the_whole_frame(
    made: tuple[Any, Registration, Reconstruction],
) -> None:
    sequence, registration, whole = made
    view = Preview(sequence, registration.with_kappa(registration.camera.kappa - 0.05), whole)
    shown = view.show(Region(1, 2), SETTINGS)
    camera = view._registration.camera
    rays = SensorRays.of(camera, sequence.shape)
    assert len(view._views) == len(sequence)
    for i, found in enumerate(view._views):
        H = view._registration.homographies[i]
        g, weights = observed(sequence, registration, i, whole.photometry)
        expected = cut_view(camera, H, rays, shown.grid, g, weights)
        assert expected is not None
        np.testing.assert_allclose(found.rays.xy, expected.rays.xy, rtol=1e-14)
        np.testing.assert_allclose(found.rays.per_px, expected.rays.per_px, rtol=1e-12)
        np.testing.assert_allclose(found.g, expected.g, rtol=1e-6)
        np.testing.assert_allclose(found.weights, expected.weights, rtol=1e-6)


@pytest.mark.parametrize("region", [Region(2, 0), Region(0, 3), Region(-1, 0), Region(0, 2, 1, 2)])
def test_a_region_outside_of_the_module_is_one_clear_sentence(
    region: Region, made: tuple[Any, Registration, Reconstruction]
) -> None:
    sequence, registration, whole = made
    with pytest.raises(InspectionError, match="module of 2 x 3 cells"):
        Preview(sequence, registration, whole).show(region, SETTINGS)


def test_a_cell_that_no_frame_shows_is_one_clear_sentence(
    made: tuple[Any, Registration, Reconstruction],
) -> None:
    sequence, registration, whole = made
    away = registration.homographies.copy()
    away[:, 0, 2] += 6.0
    view = Preview(sequence, replace(registration, homographies=away), whole)
    with pytest.raises(InspectionError, match="No frame that is used shows the cell in row 1"):
        view.show(Region(1, 0), SETTINGS)


def test_work_that_is_given_up_half_way_does_no_harm(
    made: tuple[Any, Registration, Reconstruction],
) -> None:
    sequence, registration, whole = made
    view = Preview(sequence, registration, whole)
    convex = SETTINGS.changed(prior="tikhonov", prior_weight=0.05)
    first = view.show(Region(1, 1), convex)
    other = view.refine(Region(1, 1), convex.changed(prior_weight=5.0))
    assert not next(other).finished
    other.close()
    again = view.show(Region(1, 1), convex)
    assert float(np.sqrt(np.mean((again.image - first.image) ** 2))) < 0.003


def test_at_another_magnification_it_starts_near_its_end(
    made: tuple[Any, Registration, Reconstruction],
) -> None:
    sequence, registration, whole = made
    steps = Preview(sequence, registration, whole).refine(
        Region(1, 1), SETTINGS.changed(magnification=2.0)
    )
    first = next(steps).image.copy()
    *_, last = steps
    assert last.finished
    y, x = last.cell
    error = (first - last.image)[y, x]
    assert float(np.sqrt(np.mean(error**2))) < 0.25 * float(last.image[y, x].std())


def test_without_a_whole_reconstruction_it_takes_typical_values(
    made: tuple[Any, Registration, Reconstruction],
) -> None:
    sequence, registration, whole = made
    expected = cell_of(whole, 1, 1)
    shown = Preview(sequence, registration).show(Region(1, 1), SETTINGS)
    assert np.corrcoef(shown.image[shown.cell].ravel(), expected.ravel())[0, 1] > 0.95


def test_motion_that_is_not_wanted_is_left_out(
    made: tuple[Any, Registration, Reconstruction],
) -> None:
    sequence, registration, whole = made
    moving = replace(whole, motion=((3.0, 0.0),) * len(sequence))
    still = Preview(sequence, registration, whole).show(Region(1, 1), SETTINGS)
    view = Preview(sequence, registration, moving)
    left_out = view.show(Region(1, 1), SETTINGS.changed(motion_blur="none"))
    np.testing.assert_allclose(left_out.image, still.image, atol=1e-6)
    undone = view.show(Region(1, 1), SETTINGS.changed(motion_blur="auto"))
    assert np.abs(undone.image - still.image).max() > 0.01


def test_a_registration_with_another_kappa_keeps_the_crossing_points_as_far_as_a_homography_can(
    made: tuple[Any, Registration, Reconstruction],
) -> None:
    _, registration, _ = made
    same = registration.with_kappa(registration.camera.kappa)
    np.testing.assert_allclose(same.crossings_px(0), registration.crossings_px(0), atol=1e-3)
    other = registration.with_kappa(registration.camera.kappa + 0.05)
    assert other.camera.kappa == pytest.approx(registration.camera.kappa + 0.05)
    assert np.abs(other.crossings_px(0) - registration.crossings_px(0)).max() < 1.0


def test_a_kappa_that_can_not_show_the_module_is_one_clear_sentence(
    made: tuple[Any, Registration, Reconstruction],
) -> None:
    with pytest.raises(InspectionError, match="choose a kappa nearer to the fitted one"):
        made[1].with_kappa(-500.0)


def test_a_window_of_a_grid_keeps_the_places_of_its_pixels() -> None:
    grid = HrGrid.covering(LAYOUT, 20.0, 3.0)
    part = grid.window(slice(10, 40), slice(25, 60))
    assert part.shape == (30, 35)
    np.testing.assert_allclose(part.to_module([3.0, 5.0]), grid.to_module([28.0, 15.0]))
