"""Frames that each show a part of a module are put together, in one way or not at all."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from pv_inspect.common.work import result_of
from pv_inspect.detection import grid_of_a_part, partial_views
from pv_inspect.detection.edges import cell_edges
from pv_inspect.detection.grid_of_a_part import (
    REACH,
    GridOfPart,
    bright_area,
    grid_of_part,
    plane_of,
)
from pv_inspect.detection.joined_views import (
    beside_others,
    joined_picture,
    lies_on,
    of_another_aspect,
    poses_together,
)
from pv_inspect.detection.outline import OutlineError
from pv_inspect.detection.part_shift import shift_between
from pv_inspect.detection.seen_part import Part, part_of, part_of_module
from pv_inspect.detection.single_frame import detect_in_frame
from pv_inspect.geometry.camera import Camera
from pv_inspect.geometry.layout import ModuleLayout
from pv_inspect.geometry.pose import Pose
from pv_inspect.simulate import SimulationSettings
from pv_inspect.simulate.exposure import Exposer, camera_matrix
from pv_inspect.simulate.exposure import Pose as View
from pv_inspect.simulate.scene import render_scene

SETTINGS = SimulationSettings(
    seed=5, rows=3, cols=5, width=170, height=120, kappa=-0.1, pixels_per_unit=60, supersampling=2
)
LAYOUT = SETTINGS.layout
AT = [(1.6, 1.1), (2.6, 1.2), (3.5, 1.0), (1.5, 1.9), (2.5, 2.0), (3.4, 1.9)]
"""Module points in the middle of the frames; a frame shows 4.2 x 3 cells."""
SHIFTS = [(28, 29), (27, 28), (26, 30), (28, 28), (30, 27), (25, 29)]
"""Where the frames' own grids have the module's first cell."""


@pytest.fixture(scope="module")
def frames() -> list[tuple[NDArray[np.float32], Pose]]:
    scene = result_of(render_scene(SETTINGS, np.random.default_rng(5)))
    exposer = Exposer(SETTINGS, scene)
    camera = Camera(camera_matrix(SETTINGS), SETTINGS.kappa)
    made = []
    for x, y in AT:
        H = np.array([[1, 0, -x], [0, 1, -y], [0, 0.02, SETTINGS.focal_px / 40]])
        image = exposer.expose(View(H, 1.0, 0.0, 0.0)) + 0.01
        made.append((np.asarray(image, np.float32), Pose(camera, H)))
    return made


@pytest.fixture(scope="module")
def parts(frames: list[tuple[NDArray[np.float32], Pose]]) -> dict[int, Part]:
    return {
        k: part_of(image, _own_grid(pose, *shift), 1.0)
        for k, ((image, pose), shift) in enumerate(zip(frames, SHIFTS, strict=True))
    }


def _own_grid(pose: Pose, x: float, y: float) -> GridOfPart:
    moved = np.array([[1.0, 0, -x], [0, 1, -y], [0, 0, 1]])
    return GridOfPart(Pose(pose.camera, pose.homography @ moved), 1.0)


def _off_px(pose: Pose, true: Pose) -> float:
    points = LAYOUT.crossings()
    return float(np.abs(pose.project(points) - true.project(points)).max())


def test_the_grid_of_a_part_is_found_up_to_a_shift() -> None:
    settings = replace(SETTINGS, rows=6, cols=8, width=190, height=170, pixels_per_unit=40)
    scene = result_of(render_scene(settings, np.random.default_rng(1)))
    H = np.array([[1, 0.03, -3.5], [-0.03, 1, -3.2], [0, 0.02, settings.focal_px / 32]])
    image = np.asarray(Exposer(settings, scene).expose(View(H, 1.0, 0.0, 0.0)) + 0.01, np.float32)
    found = grid_of_part(image, 1.0).pose
    points = settings.layout.crossings()
    seen = Camera(camera_matrix(settings), settings.kappa).project(H, points)
    shown = np.all((seen > 2) & (seen < [187, 167]), axis=1)
    places = (found.unproject(seen) - points)[shown]
    assert shown.mean() < 0.8
    assert np.ptp(places, axis=0).max() < 0.03
    assert np.abs(places - REACH).max() < 7


def test_a_grid_that_a_wide_search_does_not_let_grow_is_grown_with_a_narrow_one(
    monkeypatch: pytest.MonkeyPatch, frames: list[tuple[NDArray[np.float32], Pose]]
) -> None:
    grown = grid_of_a_part._grown

    def with_busbars(*args: Any) -> GridOfPart:
        if args[-1] > 0.1:
            raise OutlineError("the borders between cells are not in place")
        return grown(*args)

    monkeypatch.setattr(grid_of_a_part, "_grown", with_busbars)
    image, pose = frames[4]
    start = _own_grid(pose, 28, 28).pose
    edges = cell_edges(plane_of(1.0))
    found = list(grid_of_a_part._grids(image, bright_area(image), edges, start, 1.0))
    assert len(found) == 1
    assert found[0][0].share > 0.9


def test_grids_that_differ_by_whole_cells_are_put_together(
    frames: list[tuple[NDArray[np.float32], Pose]], parts: dict[int, Part]
) -> None:
    poses = poses_together(parts, LAYOUT)
    assert len(poses) == len(frames)
    assert max(_off_px(poses[k], pose) for k, (_, pose) in enumerate(frames)) < 40 / 12


@pytest.mark.parametrize("all_of_them", [False, True])
def test_grids_on_busbars_are_put_right_by_the_outer_borders(
    frames: list[tuple[NDArray[np.float32], Pose]], parts: dict[int, Part], all_of_them: bool
) -> None:
    beside = {
        k: part_of(image, _own_grid(pose, SHIFTS[k][0] + 1 / 3, SHIFTS[k][1]), 1.0)
        for k, (image, pose) in enumerate(frames)
        if all_of_them or k == 1
    }
    poses = poses_together({**parts, **beside}, LAYOUT)
    # Pictures are compared to a twelfth of a cell; the fit to the gaps does the rest.
    assert max(_off_px(poses[k], pose) for k, (_, pose) in enumerate(frames)) < 40 / 8


def test_wrong_columns_are_refused(parts: dict[int, Part]) -> None:
    with pytest.raises(OutlineError, match="show 3 rows x 5 columns, not 3 x 6"):
        poses_together(parts, ModuleLayout(3, 6))


def test_a_side_that_no_frame_shows_is_named(parts: dict[int, Part]) -> None:
    # Without it these three could as well be the left part of a longer module.
    left = {k: parts[k] for k in (0, 3)}
    with pytest.raises(OutlineError, match="not where the module ends on the right"):
        poses_together(left, ModuleLayout(3, 4))


def test_cells_that_all_look_alike_are_not_put_together(parts: dict[int, Part]) -> None:
    rng = np.random.default_rng(0)
    alike = {
        k: replace(p, details=rng.normal(0, 0.02, p.details.shape).astype(np.float32))
        for k, p in parts.items()
    }
    with pytest.raises(OutlineError, match="does not fit together at one place only"):
        poses_together(alike, LAYOUT)


def _windows(places: list[tuple[int, int]], rows: int, cols: int) -> dict[int, Part]:
    """Pictures of so many rows and columns of a module of 5 x 6 cells with a dark rim of a cell."""
    rng = np.random.default_rng(4)
    bright = np.zeros((7 * 12, 8 * 12), bool)
    bright[12:-12, 12:-12] = True
    details = np.where(bright, rng.normal(0, 0.1, (7 * 12, 8 * 12)), 0).astype(np.float32)
    pose = Pose(Camera(np.eye(3), 0.0), np.eye(3))
    parts = {}
    for k, (row, col) in enumerate(places):
        window = np.s_[12 * row : 12 * (row + rows), 12 * col : 12 * (col + cols)]
        seen = bright[window]
        parts[k] = Part(
            pose, np.zeros(2, np.int64), details[window], seen, ~seen, np.ones_like(seen)
        )
    return parts


def test_lines_of_views_overlap_by_more_than_two_of_their_frames() -> None:
    # Frames of two lines share two cells, the lines as a whole six.
    parts = _windows([(0, 0), (0, 2), (0, 4), (3, 0), (3, 2), (3, 4)], 4, 4)
    poses = poses_together(parts, ModuleLayout(5, 6))
    assert [pose.homography[:2, 2].round(6).tolist() for pose in poses.values()] == [
        [1 - x, 1 - y] for y in (0, 3) for x in (0, 2, 4)
    ]


def test_where_the_module_ends_tells_cells_that_look_alike_apart() -> None:
    # All columns look the same: only the dark beside the outer ones says which they are.
    parts = _windows([(0, 0), (3, 0)], 4, 8)
    alike = {
        k: replace(p, details=np.where(p.bright, np.tile(p.details[:, 12:24], (1, 8)), 0))
        for k, p in parts.items()
    }
    shift = shift_between(alike[0], alike[1], whole_cells=True)
    assert shift is not None
    assert shift[0].tolist() == [0, 3]
    nowhere = {k: replace(p, dark=np.zeros_like(p.dark)) for k, p in alike.items()}
    assert shift_between(nowhere[0], nowhere[1], whole_cells=True) is None


def test_cells_that_were_seen_two_by_two_are_halved(
    frames: list[tuple[NDArray[np.float32], Pose]], parts: dict[int, Part]
) -> None:
    poses = poses_together(parts, ModuleLayout(6, 10))
    points = LAYOUT.crossings()
    for k, (_, true) in enumerate(frames):
        assert np.abs(poses[k].project(2 * points) - true.project(points)).max() < 40 / 12


def test_that_frames_do_not_hang_together_is_said_before_what_is_missing(
    parts: dict[int, Part],
) -> None:
    noise = np.random.default_rng(0).normal(0, 0.1, (200, 200)).astype(np.float32)
    other = {
        k: replace(p, details=noise[: p.details.shape[0], : p.details.shape[1]])
        for k, p in parts.items()
        if k in (2, 5)
    }
    with pytest.raises(OutlineError, match="only 4 of 6 fit together without doubt, and together"):
        poses_together({**parts, **other}, LAYOUT)


def test_a_frame_that_lies_beside_what_the_others_show_is_named(
    frames: list[tuple[NDArray[np.float32], Pose]],
) -> None:
    at_last = {k: part_of_module(image, pose, 1.0) for k, (image, pose) in enumerate(frames)}
    assert beside_others(at_last) == []
    image, pose = frames[1]
    together = joined_picture({k: part for k, part in at_last.items() if k != 1})
    assert lies_on(at_last[1], together)
    for x, y in ((0, 0.12), (1, 0), (0, -1)):
        moved = Pose(pose.camera, pose.homography @ [[1.0, 0, x], [0, 1, y], [0, 0, 1]])
        part = part_of_module(image, moved, 1.0)
        assert beside_others({**at_last, 1: part}) == [1]
        assert not lies_on(part, together)


def test_a_frame_is_seen_where_the_first_cells_lie_beyond_the_fold_of_the_lens(
    frames: list[tuple[NDArray[np.float32], Pose]],
) -> None:
    image, pose = frames[1]
    camera = Camera(pose.camera.K, -0.6)
    moved = pose.homography @ [[1.0, 0, 10], [0, 1, 0], [0, 0, 1]]
    assert not np.isfinite(Pose(camera, moved).project(np.zeros((1, 2)))).any()
    seen = part_of_module(image, Pose(camera, moved), 1.0)
    assert seen.inside.any()


def test_a_frame_without_a_grid_of_its_own_is_found_from_the_others(
    monkeypatch: pytest.MonkeyPatch,
    frames: list[tuple[NDArray[np.float32], Pose]],
    parts: dict[int, Part],
) -> None:
    # Frame 1 has its grid a tenth of a cell too high, as on busbars beside the borders.
    image, pose = frames[1]
    higher = Pose(pose.camera, pose.homography @ np.diag([1.0, 1.1, 1.0]))
    seen = {**parts, 1: part_of(image, _own_grid(higher, *SHIFTS[1]), 1.0)}
    images = [image for image, _ in frames]

    def part(image: NDArray[np.float32], cell_aspect: float) -> Part | OutlineError:
        k = next(k for k, one in enumerate(images) if one is image)
        return seen[k] if k != 4 else OutlineError("no grid of cells is seen")

    monkeypatch.setattr(partial_views, "_seen", part)
    numbered: Any = SimpleNamespace(frame=lambda k: SimpleNamespace(image=images[k]))
    found, reasons = result_of(partial_views.found_together(numbered, LAYOUT, range(6)))
    assert not reasons
    shown = [pose.shows(LAYOUT.crossings(), images[0].shape) for _, pose in frames]
    for k, (_, true) in enumerate(frames):
        off = found[k].pose.project(LAYOUT.crossings()) - true.project(LAYOUT.crossings())
        assert np.abs(off[shown[k]]).max() < 0.5


def test_a_frame_whose_cells_are_of_another_aspect_is_named(
    frames: list[tuple[NDArray[np.float32], Pose]],
) -> None:
    poses = {k: pose for k, (_, pose) in enumerate(frames)}
    assert of_another_aspect({}) == []
    assert of_another_aspect(poses) == []
    higher = Pose(poses[1].camera, poses[1].homography @ np.diag([1.0, 1.13, 1.0]))
    assert of_another_aspect({**poses, 1: higher}) == [1]


@pytest.mark.parametrize("aside", [0.13, 0.0])
def test_a_grid_a_little_beside_the_cells_is_not_taken_for_whole_cells(
    frames: list[tuple[NDArray[np.float32], Pose]], parts: dict[int, Part], aside: float
) -> None:
    image, pose = frames[2]
    own = part_of(image, _own_grid(pose, SHIFTS[2][0], SHIFTS[2][1] + aside), 1.0)
    poses = poses_together({**parts, 2: own}, LAYOUT)
    assert _off_px(poses[2], pose) < 40 * 0.05


def test_frames_without_a_grid_are_counted_first(monkeypatch: pytest.MonkeyPatch) -> None:
    seen = _windows([(0, 0), (0, 2), (0, 4), (3, 4)], 4, 4)
    image = np.zeros((8, 8), np.float32)
    numbered: Any = SimpleNamespace(frame=lambda k: SimpleNamespace(image=image + k))

    def part(image: NDArray[np.float32], cell_aspect: float) -> Part | OutlineError:
        assert cell_aspect == 1
        return seen.get(int(image[0, 0])) or OutlineError("no grid of cells is seen")

    monkeypatch.setattr(partial_views, "_seen", part)
    with pytest.raises(OutlineError, match="seen in only 4 of 6, and only 3 of 4 fit together"):
        result_of(partial_views.found_together(numbered, ModuleLayout(5, 6), range(6)))


def test_busbars_near_the_borders_do_not_draw_a_grid_that_lies_on_them(
    monkeypatch: pytest.MonkeyPatch, frames: list[tuple[NDArray[np.float32], Pose]]
) -> None:
    tried: list[float] = []

    def detect(
        image: NDArray[np.float32], layout: ModuleLayout, start: Pose, searches: Any = (0.12,)
    ) -> Any:
        tried.append(max(searches))
        if max(searches) > 0.05:
            raise OutlineError("only 56 % of the borders are where they should be")
        return detect_in_frame(image, layout, start, searches=searches)

    monkeypatch.setattr(partial_views, "detect_in_frame", detect)
    image, pose = frames[4]
    assert not isinstance(partial_views._detected(image, LAYOUT, pose), OutlineError)
    # A grid that lay on busbars is drawn from there.
    outcome = partial_views._detected(image, LAYOUT, _own_grid(pose, 0.2, 0.2).pose)
    assert isinstance(outcome, OutlineError)
    assert tried == [0.04, 0.04, 0.12]
