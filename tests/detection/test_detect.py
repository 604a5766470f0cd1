from __future__ import annotations

import json
import re
from pathlib import Path
from types import SimpleNamespace
from typing import Any, ClassVar

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from pv_inspect.common.work import result_of
from pv_inspect.detection.crossings import Crossings, FrameCrossings, _side_shifts
from pv_inspect.detection.detect import detect
from pv_inspect.detection.edges import EdgeOffsets, cell_edges
from pv_inspect.detection.outline import OutlineError
from pv_inspect.detection.single_frame import find_module
from pv_inspect.errors import InspectionError
from pv_inspect.geometry.layout import ModuleLayout
from pv_inspect.sequence.sequence import FrameSequence
from pv_inspect.simulate import SimulatedSequence, SimulationSettings, simulated


def _finish(generator: Any) -> Any:
    fractions: list[float] = []
    result = result_of(generator, lambda step: fractions.append(step.fraction))
    assert fractions == sorted(fractions)
    return result


def _in_memory(frames: list[np.ndarray]) -> Any:
    images = [SimpleNamespace(image=frame) for frame in frames]

    class Frames:
        names = tuple(f"frame_{i}.tif" for i in range(len(frames)))
        shape = frames[0].shape
        no_measurements: ClassVar[dict[int, str]] = {}
        lock_in = None
        measured = tuple(range(len(frames)))

        def __len__(self) -> int:
            return len(frames)

        def frame(self, index: int) -> Any:
            return images[index]

    return Frames()


def _floats(simulation: SimulatedSequence) -> list[np.ndarray]:
    return [(frame.astype(np.float32) - 64) / 4031 for frame in simulation.frames]


def _rmse(crossings: Crossings, simulation: SimulatedSequence, frame: int) -> float:
    found = crossings.frames[frame]
    error = found.points_px - simulation.crossings_px(frame)
    return float(np.sqrt((error[found.measured] ** 2).sum(axis=1).mean()))


def test_crossings_of_a_distorted_tilted_module_are_found_to_a_third_of_a_pixel(
    small_sequence: tuple[SimulatedSequence, Path],
) -> None:
    simulation, folder = small_sequence
    crossings = _finish(detect(FrameSequence.open(folder), ModuleLayout(4, 6)))
    assert all(frame.why == "" for frame in crossings.frames)
    assert max(_rmse(crossings, simulation, i) for i in range(8)) < 0.35
    assert np.mean([frame.measured.mean() for frame in crossings.frames]) > 0.9


@pytest.mark.parametrize(("rows", "cols", "aspect"), [(4, 6, 0.5), (3, 10, 2.0)])
def test_half_cut_cells_and_upright_modules_are_found(rows: int, cols: int, aspect: float) -> None:
    settings = SimulationSettings(
        seed=2,
        rows=rows,
        cols=cols,
        cell_aspect=aspect,
        n_frames=1,
        width=360,
        height=360,
        roll_deg=30,
        kappa=0.1,
        pixels_per_unit=150,
        supersampling=4,
    )
    simulation = simulated(settings)
    crossings = _finish(detect(_in_memory(_floats(simulation)), settings.layout))
    assert crossings.frames[0].why == ""
    assert _rmse(crossings, simulation, 0) < 0.4


def test_a_black_and_a_saturated_frame_fail_with_their_reason_and_the_others_do_not(
    small_sequence: tuple[SimulatedSequence, Path],
) -> None:
    simulation, _ = small_sequence
    frames = _floats(simulation)[:4]
    noise = np.random.default_rng(0).normal(0, 0.003, frames[0].shape)
    frames[1] = noise.astype(np.float32)
    frames[2] = np.ones_like(frames[2])
    crossings = _finish(detect(_in_memory(frames), ModuleLayout(4, 6)))
    assert [frame.why.split(":")[0] for frame in crossings.frames] == ["", "black", "saturated", ""]


def test_a_frame_that_cuts_the_module_is_found_from_its_neighbour(
    small_sequence: tuple[SimulatedSequence, Path],
) -> None:
    simulation, _ = small_sequence
    frames = _floats(simulation)[:2]
    shift = 40
    frames[1] = np.roll(frames[1], -shift, axis=1)
    frames[1][:, -shift:] = 0
    crossings = _finish(detect(_in_memory(frames), ModuleLayout(4, 6)))
    assert crossings.frames[1].why == ""
    found = crossings.frames[1]
    error = found.points_px - (simulation.crossings_px(1) - [shift, 0])
    assert np.sqrt((error[found.measured] ** 2).sum(axis=1).mean()) < 0.5
    outside = found.points_px[:, 0] < 0
    assert outside.any()
    assert not found.measured[outside].any()


@pytest.mark.parametrize(("rows", "cols"), [(5, 6), (3, 6), (4, 7), (6, 10), (2, 3)])
def test_wrong_rows_or_columns_are_refused_in_one_sentence(
    small_sequence: tuple[SimulatedSequence, Path], rows: int, cols: int
) -> None:
    simulation, _ = small_sequence
    frames = _in_memory(_floats(simulation)[:2])
    with pytest.raises(InspectionError, match=r"No frame shows a module of .* check"):
        _finish(detect(frames, ModuleLayout(rows, cols)))


def test_the_layout_that_fits_is_named_after_a_few_frames(
    small_sequence: tuple[SimulatedSequence, Path],
) -> None:
    frames = _in_memory(_floats(small_sequence[0]) * 5)
    looked: list[int] = []
    show = frames.frame
    frames.frame = lambda index: (looked.append(index), show(index))[1]
    with pytest.raises(
        InspectionError, match=r"4 rows x 6 columns: .*--rows 4 --cols 6\."
    ) as error:
        _finish(detect(frames, ModuleLayout(5, 6)))
    assert len(str(error.value)) < 400
    assert set(looked) == {0, 20, 39}


@pytest.mark.parametrize("faulty", [2, 3])
def test_a_layout_that_most_frames_speak_against_is_refused(
    small_sequence: tuple[SimulatedSequence, Path],
    monkeypatch: pytest.MonkeyPatch,
    faulty: int,
) -> None:
    """Frames that show a fault of the grid are told by their brightness here."""
    frames = [(1 + (k < faulty)) * frame for k, frame in enumerate(_floats(small_sequence[0]) * 3)]
    frames = frames[:5]
    limit = 1.5 * float(frames[-1].mean())

    def fault(image: NDArray[np.float32], *_: object, **__: object) -> str:
        return "there is no border between row 1 and 2 of" if image.mean() > limit else ""

    monkeypatch.setattr("pv_inspect.detection.single_frame.grid_fault", fault)
    # Faulty frames are looked at again from three others; one place in each is enough here.
    monkeypatch.setattr("pv_inspect.detection.overlapping_view.PEAKS", 1)
    if faulty == 2:
        crossings = _finish(detect(_in_memory(frames), ModuleLayout(4, 6)))
        assert [frame.why == "" for frame in crossings.frames] == [False, False, True, True, True]
        return
    with pytest.raises(InspectionError, match=r"3 of 5 frames speak against .* check rows"):
        _finish(detect(_in_memory(frames), ModuleLayout(4, 6)))


def test_cells_of_another_shape_than_given_are_refused(
    small_sequence: tuple[SimulatedSequence, Path],
) -> None:
    frames = _in_memory(_floats(small_sequence[0])[:2])
    with pytest.raises(InspectionError, match="--rows 4 --cols 6 --cell-aspect 1"):
        _finish(detect(frames, ModuleLayout(4, 6, 2.0)))


def test_a_black_beginning_does_not_refuse_the_layout(
    small_sequence: tuple[SimulatedSequence, Path],
) -> None:
    noise = np.random.default_rng(0).normal(0, 0.003, (9, 216, 288)).astype(np.float32)
    frames = _in_memory([*noise, *_floats(small_sequence[0])[:1]])
    crossings = _finish(detect(frames, ModuleLayout(4, 6)))
    assert [frame.why == "" for frame in crossings.frames] == [*[False] * 9, True]


@pytest.mark.parametrize(("rows", "cols"), [(1, 8), (8, 1), (1, 1)])
def test_a_single_row_column_or_cell_is_found(rows: int, cols: int) -> None:
    settings = SimulationSettings(
        seed=3,
        rows=rows,
        cols=cols,
        n_frames=1,
        width=320,
        height=320,
        pixels_per_unit=100 if rows * cols > 1 else 400,
        supersampling=3,
        tilt_deg=8,
        kappa=-0.1,
    )
    simulation = simulated(settings)
    crossings = _finish(detect(_in_memory(_floats(simulation)), settings.layout))
    assert crossings.frames[0].why == ""
    # A single cell has no neighbour that shows how wide the gaps are: half a gap is uncertain.
    px_per_unit = np.linalg.norm(np.ptp(simulation.crossings_px(0), axis=0)) / np.hypot(rows, cols)
    assert _rmse(crossings, simulation, 0) < (0.5 if rows * cols > 1 else 0.5 + 0.015 * px_per_unit)


def test_a_picture_without_a_module_is_refused() -> None:
    rng = np.random.default_rng(0)
    picture = rng.normal(0.3, 0.02, (200, 260)).astype(np.float32)
    picture[40:140, 50:170] += 0.3
    with pytest.raises(InspectionError, match="No frame shows a module"):
        _finish(detect(_in_memory([picture]), ModuleLayout(4, 6)))


def _side_by_side(simulation: SimulatedSequence, frames: int = 1) -> list[np.ndarray]:
    """Two modules at the same distance from the centre, the right one with another cell dark."""
    pictures = _floats(simulation)[:frames]
    return [np.hstack([one, one[:, ::-1][::-1]]) for one in pictures]


def test_two_modules_of_equal_standing_are_both_named(
    small_sequence: tuple[SimulatedSequence, Path],
) -> None:
    frames = _in_memory(_side_by_side(small_sequence[0]))
    with pytest.raises(InspectionError, match=r"two modules .* and .*--module-at") as refused:
        _finish(detect(frames, ModuleLayout(4, 6)))
    width = frames.shape[1]
    named = [float(x) for x in re.findall(r"\((\d+), \d+\)", str(refused.value))]
    assert min(named) < width / 2 < max(named)


@pytest.mark.parametrize("side", [0, 1])
def test_a_point_in_the_first_frame_chooses_the_module(
    small_sequence: tuple[SimulatedSequence, Path], side: int
) -> None:
    frames = _in_memory(_side_by_side(small_sequence[0], 2))
    half = frames.shape[1] / 2
    point = ((side + 0.5) * half, frames.shape[0] / 2)
    crossings = _finish(detect(frames, ModuleLayout(4, 6), point))
    for frame in crossings.frames:
        assert np.all((frame.points_px[:, 0] > half) == (side == 1))


def test_a_point_beside_every_module_is_refused(
    small_sequence: tuple[SimulatedSequence, Path],
) -> None:
    frames = _in_memory(_floats(small_sequence[0])[:1])
    with pytest.raises(InspectionError, match=r"no module of 4 rows .* at \(1, 2\) px; the"):
        _finish(detect(frames, ModuleLayout(4, 6), (1.0, 2.0)))


def test_frames_that_all_cut_the_module_are_one_sentence_of_their_own(
    small_sequence: tuple[SimulatedSequence, Path],
) -> None:
    frames = [frame[:, 100:] for frame in _floats(small_sequence[0])[:2]]
    with pytest.raises(InspectionError, match=r"in all 2 .* must show the whole module"):
        _finish(detect(_in_memory(frames), ModuleLayout(4, 6)))


def test_a_bright_picture_without_a_module_is_not_told_that_it_cuts_one() -> None:
    rows, cols = np.mgrid[0:200, 0:260]
    picture = (0.2 + 0.002 * cols + 0.1 * np.sin(rows / 17)).astype(np.float32)
    with pytest.raises(InspectionError, match="No frame shows a module") as refused:
        _finish(detect(_in_memory([picture]), ModuleLayout(4, 6)))
    assert "cuts" not in str(refused.value)


def test_dead_cells_in_a_corner_do_not_hide_the_module(
    small_sequence: tuple[SimulatedSequence, Path],
) -> None:
    simulation, _ = small_sequence
    frame = _floats(simulation)[0]
    corner = simulation.crossings_px(0).reshape(5, 7, 2)[:3, 5:][[0, 0, -1, -1], [0, -1, -1, 0]]
    cv2.fillConvexPoly(frame, np.round(corner).astype(np.int32), 0.02)
    crossings = _finish(detect(_in_memory([frame]), ModuleLayout(4, 6)))
    assert crossings.frames[0].why == ""
    assert _rmse(crossings, simulation, 0) < 0.5


@pytest.fixture(scope="module")
def half_dead() -> SimulatedSequence:
    """One frame of 5 x 8 cells of which about half are nearly dead."""
    size = {"width": 320, "height": 240, "pixels_per_unit": 120, "supersampling": 3}
    return simulated(
        SimulationSettings(seed=6, rows=5, cols=8, dark_cell_share=0.5, n_frames=1, **size)
    )


def test_a_module_of_half_dead_cells_is_found(half_dead: SimulatedSequence) -> None:
    frames = _floats(half_dead)
    with pytest.raises(OutlineError):
        find_module(frames[0], ModuleLayout(5, 8))
    crossings = _finish(detect(_in_memory(frames), ModuleLayout(5, 8)))
    assert crossings.frames[0].why == ""
    assert _rmse(crossings, half_dead, 0) < 0.5


@pytest.mark.parametrize(("rows", "cols"), [(6, 8), (5, 7)])
def test_a_row_or_column_more_or_less_is_refused_where_half_of_the_cells_are_dead(
    half_dead: SimulatedSequence, rows: int, cols: int
) -> None:
    with pytest.raises(InspectionError):
        _finish(detect(_in_memory(_floats(half_dead)), ModuleLayout(rows, cols)))


def test_outer_edges_that_are_not_seen_follow_their_side() -> None:
    layout = ModuleLayout(4, 6)
    edges = cell_edges(layout)
    found = np.ones(len(edges.inner), bool)
    right = ~edges.inner & (edges.normal[:, 0] == 1) & (edges.side == -1)
    found[np.flatnonzero(right)[0]] = False
    offsets = EdgeOffsets(
        np.where(right, 0.05, 0.0), np.full(len(found), 0.01), found, np.ones_like(found)
    )
    shifts = _side_shifts(layout, edges, offsets, found).reshape(5, 7, 2)
    np.testing.assert_allclose(shifts[:, -1, 0], 0.05)
    np.testing.assert_allclose(shifts[:, :-1], 0)


def test_the_order_of_the_frames_does_not_matter(
    small_sequence: tuple[SimulatedSequence, Path],
) -> None:
    simulation, _ = small_sequence
    frames = _floats(simulation)[:3]
    layout = ModuleLayout(4, 6)
    one = _finish(detect(_in_memory(frames), layout))
    other = _finish(detect(_in_memory(frames[::-1]), layout))
    for a, b in zip(one.frames, other.frames[::-1], strict=True):
        np.testing.assert_allclose(a.points_px, b.points_px)


def test_the_intensity_scale_does_not_matter(
    small_sequence: tuple[SimulatedSequence, Path],
) -> None:
    simulation, _ = small_sequence
    frame = _floats(simulation)[0]
    layout = ModuleLayout(4, 6)
    one = _finish(detect(_in_memory([frame]), layout)).frames[0]
    other = _finish(detect(_in_memory([np.float32(0.25) * frame]), layout)).frames[0]
    np.testing.assert_allclose(one.points_px, other.points_px, atol=0.01)


def test_a_frame_upside_down_is_brought_the_same_way_up(
    small_sequence: tuple[SimulatedSequence, Path],
) -> None:
    simulation, _ = small_sequence
    frames = _floats(simulation)[:3]
    frames[1] = np.ascontiguousarray(frames[1][::-1, ::-1])
    crossings = _finish(detect(_in_memory(frames), ModuleLayout(4, 6)))
    height, width = frames[0].shape
    turned = [width - 1, height - 1] - simulation.crossings_px(1)
    found = crossings.frames[1]
    # Which way is up is arbitrary, but must be the same in all frames.
    first = crossings.frames[0].points_px - simulation.crossings_px(0)
    if np.nanmax(np.abs(first)) > 5:
        turned = turned[::-1]
    assert np.abs(found.points_px - turned)[found.measured].max() < 2


def test_crossings_turn_with_the_module() -> None:
    layout = ModuleLayout(3, 3)
    ideal = layout.crossings()
    frame = FrameCrossings(ideal, np.ones(16), np.ones(16, bool))
    once = frame.turned(layout, 1).points_px
    np.testing.assert_array_equal(once[:2], [[3, 0], [3, 1]])
    np.testing.assert_array_equal(frame.turned(layout, 2).points_px, ideal[::-1])


@pytest.mark.parametrize("photo", [0, 4, 12])
def test_the_central_module_of_a_field_photograph_is_found(
    shared_sequences: Path, photo: int
) -> None:
    folder = shared_sequences.parent / "field"
    truth = json.loads((folder / "truth.json").read_text(encoding="utf-8"))
    of_photo = next(one for one in truth["images"] if one["file"] == f"field_{photo:02d}.png")
    layout = ModuleLayout(of_photo["rows"], of_photo["cols"])
    crossings = _finish(detect(FrameSequence.open([folder / of_photo["file"]]), layout))
    error = np.linalg.norm(crossings.frames[0].points_px - of_photo["crossings_px"], axis=1)
    assert np.median(error) < 0.5
    assert error.max() < 2
