"""What is known about how well the cells of a photograph were seen."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import cv2
import numpy as np
import pytest

from pv_inspect.common.work import result_of
from pv_inspect.cracks.seen import LEAST_DETAIL, MOST_BLUR, would_show
from pv_inspect.geometry.camera import Camera
from pv_inspect.geometry.grid import HrGrid
from pv_inspect.geometry.layout import ModuleLayout
from pv_inspect.reconstruction.cell_sight import CellSight
from pv_inspect.reconstruction.image_blur import image_blur
from pv_inspect.reconstruction.reconstruct import reconstruct
from pv_inspect.registration.registration import Registration
from pv_inspect.sequence.frame import Frame
from pv_inspect.sequence.noise import estimate_noise
from pv_inspect.settings import Settings
from pv_inspect.simulate import SimulationSettings, simulated
from tests.recording import Frames

SETTINGS = Settings.create(magnification=2, motion_blur="none", second_pass=False)


@dataclass(frozen=True, eq=False)
class Masked(Frames):
    """Frames with pixels that don't count."""

    valid: np.ndarray = field(default_factory=lambda: np.ones((1, 1), bool))

    def frame(self, index: int) -> Frame:
        return Frame(self.images[index], self.valid)


def sight(cell_px: int = 80, **changes: Any) -> CellSight:
    """One photograph of 2 x 2 cells with its true geometry."""
    given: dict[str, Any] = {"psf_sigma_px": 0.4, "hot_share": 0.0, "dead_share": 0.0, **changes}
    plan = SimulationSettings(
        seed=3,
        rows=2,
        cols=2,
        n_frames=1,
        width=int(2.6 * cell_px),
        height=int(2.6 * cell_px),
        kappa=-0.1,
        fill=0.85,
        motion_blur_px=0.0,
        pixels_per_unit=160,
        supersampling=3,
        **given,
    )
    made = simulated(plan)
    image = (made.frames[0] - np.float32(plan.black_level_dn)) / np.float32(plan.max_dn)
    valid = np.asarray(made.frames[0] < plan.max_dn)
    registration = Registration(
        made.scene.layout,
        Camera(made.camera_matrix, plan.kappa),
        np.array([pose.H for pose in made.poses]),
        np.ones(1, bool),
        ("",),
        np.ones(1),
        np.zeros(1),
        np.ones(1),
    )
    sequence: Any = Masked([image], estimate_noise([image], [valid]), valid)
    found = result_of(reconstruct(sequence, registration, SETTINGS)).sight
    assert found is not None
    return found


def shown(found: CellSight) -> bool:
    """Whether cracks would show in every cell; it must be the same for all of them."""
    pairs = zip(found.detail.ravel(), found.blur.ravel(), strict=True)
    (answer,) = {would_show(float(detail), float(blur)) for detail, blur in pairs}
    return answer


def test_cracks_would_show_in_a_sharp_quiet_photograph() -> None:
    found = sight()
    assert shown(found)
    # The optics, the pixels and the light that spreads in the module: 0.4, 0.29 and 0.3 px.
    assert np.all((found.blur > 0.004) & (found.blur < 0.011))


def test_cracks_would_not_show_out_of_focus_though_the_frame_agrees_with_the_usual_psf() -> None:
    found = sight(psf_sigma_px=2.5)
    assert found.blur.min() > 1.3 * MOST_BLUR
    assert not shown(found)


@pytest.mark.parametrize(
    "changes", [{"exposure": 0.012}, {"cell_px": 30}, {"exposure": 2.5}], ids=str
)
def test_cracks_would_not_show_in_noise_coarse_pixels_or_overexposed(
    changes: dict[str, Any],
) -> None:
    found = sight(**changes)
    assert found.detail.max() < LEAST_DETAIL
    assert not shown(found)


@pytest.mark.parametrize("gap", [0.0, 0.12])
@pytest.mark.parametrize("blur", [0.01, 0.025])
def test_the_blur_is_that_of_the_edges_of_the_cells(gap: float, blur: float) -> None:
    layout = ModuleLayout(2, 3, cell_gap=(gap, gap))
    grid = HrGrid.covering(layout, 60.0, 2.0)
    image = np.full(grid.shape, 0.05, np.float32)
    margin = round(0.01 * grid.pixels_per_unit)  # gaps of 2 % without a wide one
    for row, col in np.ndindex(2, 3):
        y, x = grid.cell_slices(row, col)
        image[y.start + margin : y.stop - margin, x.start + margin : x.stop - margin] = 0.6
    image = np.asarray(cv2.GaussianBlur(image, (0, 0), blur * grid.pixels_per_unit))
    assert np.allclose(image_blur(image, grid), blur, rtol=0.25)


def test_without_an_edge_nothing_is_known_about_the_blur() -> None:
    grid = HrGrid.covering(ModuleLayout(2, 2), 30.0, 2.0)
    assert np.isnan(image_blur(np.full(grid.shape, 0.4, np.float32), grid)).all()
