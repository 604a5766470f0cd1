from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any, ClassVar

import numpy as np
import pytest

from pv_inspect.detection.layout_guess import guess_layout, is_known
from pv_inspect.errors import InspectionError
from pv_inspect.geometry.layout import ModuleLayout
from pv_inspect.sequence.sequence import FrameSequence
from pv_inspect.settings import Settings
from pv_inspect.simulate import SimulationSettings, simulated


def _in_memory(frames: list[np.ndarray]) -> Any:
    class Frames:
        names = tuple(f"frame_{i}.tif" for i in range(len(frames)))
        shape = frames[0].shape if frames else (0, 0)
        layout_hint: ClassVar[dict[str, float]] = {}
        no_measurements: ClassVar[dict[int, str]] = {}
        lock_in = None
        measured = tuple(range(len(frames)))

        def __len__(self) -> int:
            return len(frames)

        def frame(self, index: int) -> Any:
            return SimpleNamespace(image=frames[index])

    return Frames()


def _simulated(**settings: Any) -> Any:
    values = {"n_frames": 1, "width": 320, "height": 256, "pixels_per_unit": 80} | settings
    simulation = simulated(SimulationSettings(supersampling=3, **values))
    return _in_memory([(frame.astype(np.float32) - 64) / 4031 for frame in simulation.frames])


@pytest.mark.parametrize(
    ("rows", "cols", "aspect", "busbars", "wafer"),
    [
        (4, 6, 1.0, 2, "multi"),
        (6, 10, 1.0, 3, "mono"),
        (5, 6, 1.0, 5, "multi"),
        (6, 12, 0.5, 6, "mono"),
        (8, 5, 2.0, 4, "multi"),
    ],
)
def test_rows_columns_and_cell_aspect_are_read_off_the_gaps_not_the_busbars(
    rows: int, cols: int, aspect: float, busbars: int, wafer: str
) -> None:
    sequence = _simulated(
        seed=rows, rows=rows, cols=cols, cell_aspect=aspect, busbars=busbars, wafer=wafer
    )
    guess = guess_layout(sequence)
    assert (guess.layout.rows, guess.layout.cols, guess.layout.cell_aspect) == (rows, cols, aspect)
    assert guess.confidence > 0.2
    assert guess.layout not in guess.alternatives


@pytest.mark.parametrize(
    ("layout", "wide"),
    [
        ((12, 4, 2.0), {"row_gap": 0.13}),
        ((3, 12, 0.5), {"col_gap": 0.3}),
        ((4, 6, 1.0), {"cell_gap": 0.12}),
        ((4, 12, 1 / 3), {}),
    ],
)
def test_wide_gaps_and_cut_cells_do_not_hide_the_rows_and_columns(
    layout: tuple[int, int, float], wide: dict[str, float]
) -> None:
    rows, cols, aspect = layout
    sequence = _simulated(seed=3, rows=rows, cols=cols, cell_aspect=aspect, busbars=3, **wide)
    guess = guess_layout(sequence)
    assert (guess.layout.rows, guess.layout.cols, guess.layout.cell_aspect) == layout
    assert guess.layout == guess.layout.plain


def test_a_layout_that_fits_nearly_as_well_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    sequence, right, other = _simulated(rows=4, cols=6), ModuleLayout(4, 6), ModuleLayout(8, 12)

    def guessed(score: float) -> ModuleLayout | None:
        monkeypatch.setattr(
            "pv_inspect.detection.layout_guess.ranked_layouts",
            lambda *_: [(right, 0.8), (other, score)],
        )
        monkeypatch.setattr(
            "pv_inspect.detection.layout_guess._in_place",
            lambda views, _: [(view, view.pose) for view in views],
        )
        guess = guess_layout(sequence)
        assert guess.layout == right
        return guess.runner_up

    assert guessed(0.4) == other
    assert guessed(0.2) is None


def test_a_guess_keeps_to_what_is_known() -> None:
    sequence = _simulated(rows=4, cols=6)
    assert guess_layout(sequence, Settings(rows=4)).layout.cols == 6
    with pytest.raises(InspectionError, match="can't be guessed"):
        guess_layout(sequence, Settings(rows=7))


def test_the_layout_is_known_from_settings_and_sidecar_together(
    small_sequence: tuple[Any, Path],
) -> None:
    sequence = FrameSequence.open(small_sequence[1])
    assert is_known(sequence, Settings())
    bare = _in_memory([])
    assert not is_known(bare, Settings(rows=3))
    assert is_known(bare, Settings(rows=3, cols=4))


def test_a_bright_area_without_gaps_is_refused_in_one_sentence() -> None:
    picture = np.random.default_rng(0).normal(0.02, 0.004, (200, 260)).astype(np.float32)
    picture[40:160, 50:210] += 0.4
    with pytest.raises(InspectionError, match=r"can't be guessed .*: give rows and cols"):
        guess_layout(_in_memory([picture]))
    with pytest.raises(InspectionError, match="no frame shows a whole module"):
        guess_layout(_in_memory([picture[:, 100:]]))


@pytest.mark.parametrize("name", ["D2", "D5"])
def test_the_layout_of_the_shared_sequences_is_guessed(shared_sequences: Path, name: str) -> None:
    frames = sorted((shared_sequences / name / "frames").iterdir())[:1]
    sequence = FrameSequence.open(frames)
    told = FrameSequence.open(shared_sequences / name).layout(Settings())
    assert guess_layout(sequence).layout == told
