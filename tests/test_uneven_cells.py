"""Modules whose columns or rows are not alike, from the simulator to the tables."""

from __future__ import annotations

import json
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pv_inspect.detection.single_frame import find_module
from pv_inspect.errors import InspectionError
from pv_inspect.geometry.layout import ModuleLayout
from pv_inspect.pipeline import inspect
from pv_inspect.sequence.sequence import FrameSequence
from pv_inspect.settings import Settings
from pv_inspect.simulate import SimulatedSequence, SimulationSettings, simulated, write_sequence


@cache
def made(turned: bool = False, **values: Any) -> SimulatedSequence:
    """A narrow last column, or the same module on its side."""
    cells = {"rows": 4, "cols": 5, "col_widths": "5:0.55"}
    if turned:
        cells = {"rows": 5, "cols": 4, "row_heights": "5:0.55"}
    return simulated(
        SimulationSettings(
            seed=6, **cells, n_frames=3, width=260, height=240, pixels_per_unit=120,
            supersampling=3, dark_cell_share=0.0, **values,
        )
    )  # fmt: skip


def frame_of(sequence: SimulatedSequence) -> np.ndarray[Any, Any]:
    return (sequence.frames[0].astype(np.float32) - 64) / 4031


@pytest.mark.parametrize("turned", [False, True])
@pytest.mark.parametrize("upside_down", [False, True])
def test_crossing_points_of_uneven_cells_are_found(turned: bool, upside_down: bool) -> None:
    sequence = made(turned)
    frame, true = frame_of(sequence), sequence.crossings_px(0)
    if upside_down:
        frame = np.ascontiguousarray(frame[::-1, ::-1])
        true = np.array([frame.shape[1], frame.shape[0]]) - 1.0 - true
    found = find_module(frame, sequence.settings.layout)
    off = np.linalg.norm(found.crossings.points_px - true, axis=1)
    assert np.sqrt(np.mean(off**2)) < 0.15
    assert found.share > 0.9


def test_told_widths_come_from_the_command_line_or_from_the_file_beside_the_frames(
    tmp_path: Path,
) -> None:
    write_sequence(made(), tmp_path / "sequence")
    frames = FrameSequence.open(tmp_path / "sequence")
    assert frames.layout(Settings()) == made().settings.layout
    mm = Settings(col_widths="2:78mm", cell_width_mm=156.0)
    assert frames.layout(mm).col_widths == ((2, 0.5),)
    assert frames.layout(Settings(col_widths="none")) == ModuleLayout(4, 5)
    with pytest.raises(InspectionError, match="from 1 to 5"):
        frames.layout(Settings(col_widths="6:0.5"))


def test_widths_without_rows_and_columns_are_refused(tmp_path: Path) -> None:
    write_sequence(made(), tmp_path / "sequence")
    said = json.dumps({"col_widths": {"5": 0.55}})
    (tmp_path / "sequence" / "module.json").write_text(said, encoding="utf-8")
    with pytest.raises(InspectionError, match="give --rows and --cols as well"):
        inspect(FrameSequence.open(tmp_path / "sequence"), Settings())
