from __future__ import annotations

import numpy as np
import pytest

from pv_inspect.detection.edges import (
    _robust_means,
    cell_edges,
    measure_edges,
    measure_gaps_robustly,
)
from pv_inspect.detection.gap_model import GapShape
from pv_inspect.detection.outline import conventional_camera
from pv_inspect.geometry.layout import ModuleLayout
from pv_inspect.geometry.pose import Pose

SHAPE = (160, 200)
LAYOUT = ModuleLayout(3, 4)
PITCH = 40.0


def _pose(shift: tuple[float, float] = (0.0, 0.0)) -> Pose:
    camera = conventional_camera(SHAPE)
    f = camera.K[0, 0]
    origin = np.array([20.0, 20.0]) + shift
    to_px = np.array([[PITCH, 0, origin[0]], [0, PITCH, origin[1]], [0, 0, 1]])
    assert f > 0
    return Pose(camera, np.linalg.inv(camera.K) @ to_px)


def _module(levels: np.ndarray, gap: float = 0.03) -> np.ndarray:
    """Cells with sharp dark gaps, area-sampled 8 x 8 and blurred slightly by the averaging."""
    n = 8
    rows, cols = np.mgrid[0 : SHAPE[0] * n, 0 : SHAPE[1] * n] / n - 0.5 + 0.5 / n
    x, y = (cols - 20) / PITCH, (rows - 20) / PITCH
    inside = (x > 0) & (x < 4) & (y > 0) & (y < 3)
    i, j = np.clip(y.astype(int), 0, 2), np.clip(x.astype(int), 0, 3)
    near = np.minimum(np.abs(x - np.round(x)), np.abs(y - np.round(y))) < gap / 2
    scene = np.where(inside & ~near, levels[i, j], 0.03)
    return scene.reshape(SHAPE[0], n, SHAPE[1], n).mean(axis=(1, 3)).astype(np.float32)


def test_every_edge_joins_its_two_crossings() -> None:
    edges = cell_edges(LAYOUT)
    ends = LAYOUT.crossings()[edges.crossings]
    np.testing.assert_allclose(ends.mean(axis=1), edges.middle)
    np.testing.assert_allclose(ends[:, 1] - ends[:, 0], edges.along)
    assert edges.inner.sum() == 3 * 3 + 2 * 4
    np.testing.assert_allclose((edges.normal * edges.along).sum(axis=1), 0)


def test_gaps_between_unequal_cells_are_measured_without_bias() -> None:
    levels = np.random.default_rng(3).uniform(0.3, 0.9, (3, 4))
    image = _module(levels)
    shift = np.array([1.3, -0.9])
    edges = cell_edges(LAYOUT)
    offsets = measure_edges(image, edges, _pose(tuple(shift)), 0.12)
    expected = -(edges.normal * shift).sum(axis=1) / PITCH
    assert offsets.found.all()
    error_px = (offsets.offset - expected) * PITCH
    assert np.abs(error_px[edges.inner]).max() < 0.06
    assert np.abs(error_px[~edges.inner]).max() < 0.3


def test_an_image_without_gaps_has_no_edges() -> None:
    rng = np.random.default_rng(0)
    image = rng.normal(0.5, 0.02, SHAPE).astype(np.float32)
    edges = cell_edges(LAYOUT)
    offsets = measure_edges(image, edges, _pose(), 0.12)
    assert offsets.found[edges.inner].mean() < 0.3


@pytest.mark.parametrize("scale", [0.1, 7.0])
def test_the_offsets_do_not_depend_on_the_intensity_scale(scale: float) -> None:
    image = _module(np.full((3, 4), 0.6))
    edges = cell_edges(LAYOUT)
    one = measure_edges(image, edges, _pose((0.4, 0.2)), 0.1)
    other = measure_edges(image * np.float32(scale), edges, _pose((0.4, 0.2)), 0.1)
    np.testing.assert_allclose(one.offset, other.offset, atol=1e-4)


def test_a_gap_between_unevenly_dark_margins_counts_less_than_a_clean_one() -> None:
    image = _module(np.full((3, 4), 0.6))
    # The margin of the cells to the right of the first gap fades over a pixel and a half.
    image[20:140, 61:63] *= 0.6
    edges = cell_edges(LAYOUT)
    shape = GapShape(0.6, 1.3, 1.75)
    offsets = measure_gaps_robustly(image, edges, _pose(), 0.05, shape)
    assert offsets.found[edges.inner].all()
    assert not offsets.found[~edges.inner].any()
    spoilt = edges.middle[:, 0] == 1
    spoilt &= edges.normal[:, 0] == 1
    clean = edges.inner & ~spoilt
    assert np.abs(offsets.offset[spoilt]).min() > 5 * np.abs(offsets.offset[clean]).max()
    assert offsets.sigma[spoilt].min() > 1.5 * offsets.sigma[clean].max()


def test_a_gap_beside_a_black_cell_has_no_place_and_no_infinite_weight() -> None:
    levels = np.full((3, 4), 0.6)
    levels[:, 0] = 0.0
    image = _module(levels)
    image[:, :61] = np.minimum(image[:, :61], 0.0)
    edges = cell_edges(LAYOUT)
    offsets = measure_gaps_robustly(image, edges, _pose(), 0.05, GapShape(0.6, 1.3, 1.75))
    black = (edges.middle[:, 0] == 1) & (edges.normal[:, 0] == 1)
    assert not offsets.found[black].any()
    assert np.all(offsets.sigma[offsets.found] > 0)
    assert np.isfinite(offsets.offset[offsets.found]).all()


def test_the_robust_mean_leaves_out_what_is_spoilt_or_unknown() -> None:
    values = np.array([[0.1, 0.12, 0.11, 3.0, np.nan], [1.0, 1.0, 1.0, 1.0, 1.0]])
    sigma = np.full(values.shape, 0.05)
    sigma[1, 4] = np.inf
    mean, deviation = _robust_means(values, sigma)
    np.testing.assert_allclose(mean, [0.11, 1.0], atol=0.01)
    np.testing.assert_allclose(deviation, 0.05 / np.sqrt(0.8))


def test_a_pose_that_blows_a_cell_up_shows_nothing() -> None:
    image = _module(np.full((3, 4), 0.7))
    pose = _pose()
    blown_up = Pose(pose.camera, pose.homography @ np.diag([1e6, 1e6, 1.0]))
    offsets = measure_edges(image, cell_edges(LAYOUT), blown_up, 0.05)
    assert not offsets.found.any()
    assert not offsets.visible.any()
