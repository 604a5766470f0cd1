from __future__ import annotations

import re
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tifffile
from numpy.typing import NDArray

from pv_inspect.common.work import result_of
from pv_inspect.detection import detect
from pv_inspect.detection.uneven_cells import said_of_uneven, uneven_in_frame
from pv_inspect.errors import InspectionError
from pv_inspect.geometry.layout import ModuleLayout
from pv_inspect.sequence.sequence import FrameSequence
from pv_inspect.simulate import SimulatedSequence, SimulationSettings, simulated, write_sequence


@cache
def made(n_frames: int = 1, **cells: Any) -> SimulatedSequence:
    return simulated(
        SimulationSettings(
            seed=6, n_frames=n_frames, width=260, height=240, pixels_per_unit=120,
            supersampling=3, dark_cell_share=0.0, **cells,
        )
    )  # fmt: skip


def frame(**cells: Any) -> NDArray[np.float32]:
    return (made(**cells).frames[0].astype(np.float32) - 64) / 4031


def test_a_narrow_last_column_is_seen_with_its_width() -> None:
    seen = uneven_in_frame(frame(rows=4, cols=5, col_widths="5:0.55"), ModuleLayout(4, 5))
    assert seen is not None
    ((number, width),) = seen.col_widths
    assert number == 5
    assert width == pytest.approx(0.55, abs=0.01)
    assert seen.row_heights == ()


def test_a_cut_column_among_whole_ones_is_seen() -> None:
    seen = uneven_in_frame(frame(rows=4, cols=6, col_widths="3:0.5"), ModuleLayout(4, 6))
    assert seen is not None
    ((number, width),) = seen.col_widths
    assert number == 3
    assert width == pytest.approx(0.5, abs=0.01)


@pytest.mark.parametrize("layout", [ModuleLayout(4, 5), ModuleLayout(4, 6)])
def test_no_widths_are_seen_in_a_plain_module_however_it_was_counted(layout: ModuleLayout) -> None:
    assert uneven_in_frame(frame(rows=4, cols=5), layout) is None


def test_a_wide_gap_is_no_narrow_row() -> None:
    image = frame(rows=6, cols=4, row_gap=0.4)
    assert uneven_in_frame(image, ModuleLayout(7, 4)) is None


def test_the_widths_that_are_seen_are_told_with_their_option(tmp_path: Path) -> None:
    write_sequence(made(1, rows=4, cols=5, col_widths="5:0.55"), tmp_path / "sequence")
    frames = FrameSequence.open(tmp_path / "sequence")
    said = said_of_uneven(frames, ModuleLayout(4, 5), None)
    assert re.search(r"column 5 0\.5\d* wide .* perhaps give --col-widths 5:0\.5\d*\.$", said)
    told = ModuleLayout(4, 5, col_widths=((2, 0.5),))
    assert said_of_uneven(frames, told, None) == ""


def test_a_refusal_ends_with_what_is_seen_of_uneven_cells(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for k in range(2):
        tifffile.imwrite(tmp_path / f"{k}.tif", np.full((64, 64), 100 + k, np.uint16))
    monkeypatch.setattr(detect, "said_of_uneven", lambda *_: " Perhaps uneven.")
    with pytest.raises(InspectionError, match=r"No frame shows .* Perhaps uneven\.$"):
        result_of(detect.detect(FrameSequence.open(tmp_path), ModuleLayout(4, 5)))
