"""What a user may say of the module: its cells, and where it lies in the frames."""

from __future__ import annotations

from functools import partial
from typing import Annotated

from pydantic import AfterValidator, Field

from pv_inspect.common.gap_text import checked_gaps, checked_sizes
from pv_inspect.settings.declaration import Declaration, DeclaredModel, Group, tunable
from pv_inspect.settings.stages import Stage

__all__ = ["Finite", "ModuleSettings"]

_module = partial(Declaration, Stage.DETECT, Group.MODULE)

Finite = Annotated[float, Field(allow_inf_nan=False)]
GapText = Annotated[str, AfterValidator(checked_gaps)]
SizeText = Annotated[str, AfterValidator(checked_sizes)]
Pixel = Annotated[float, Field(allow_inf_nan=False, ge=-1e6, le=1e6)]


class ModuleSettings(DeclaredModel):
    """The part of `pv_inspect.settings.Settings` that describes the module."""

    rows: int | None = tunable(
        None,
        _module("rows", "cells", automatic="?"),
        "Rows of cells; taken from module.json if not given.",
        ge=1,
        le=200,
    )
    cols: int | None = tunable(
        None,
        _module("columns", "cells", automatic="?"),
        "Columns of cells; taken from module.json if not given.",
        ge=1,
        le=200,
    )
    cell_aspect: Finite | None = tunable(
        None,
        _module("aspect", decimals=3, automatic="auto"),
        "Cell width / cell height; from module.json if not given, else 1.",
        ge=0.1,
        le=10,
    )
    row_gaps: GapText | None = tunable(
        None,
        _module("wide row gaps", "cell widths", automatic="as seen", advanced=True),
        "Gaps between rows that are wider than the others, as AFTER:WIDTH: 6:0.1 is one below the "
        "sixth row that is wider by a tenth of a cell's width, 6:16mm one by 16 mm (with "
        "cell_width_mm); several with commas, or none. Found in the frames if no gap is given.",
    )
    col_gaps: GapText | None = tunable(
        None,
        _module("wide column gaps", "cell widths", automatic="as seen", advanced=True),
        "Gaps between columns that are wider than the others, written as row_gaps.",
    )
    cell_gap: Finite | None = tunable(
        None,
        _module("cell gap", "cell widths", decimals=3, automatic="as seen", advanced=True),
        "Width of the gap between all cells where it is a good part of a cell, as in mini-modules; "
        "0 for the usual few millimetres. Found in the frames if no gap is given.",
        ge=0,
        le=0.5,
    )
    row_heights: SizeText | None = tunable(
        None,
        _module("row heights", "cell widths", automatic="alike", advanced=True),
        "Rows of other cells than the usual ones, written as col_widths.",
    )
    col_widths: SizeText | None = tunable(
        None,
        _module("column widths", "cell widths", automatic="alike", advanced=True),
        "Columns of narrower or wider cells than the usual ones, as NUMBER:WIDTH: 12:0.5 is a "
        "twelfth column half as wide as most, 12:78mm one of 78 mm (with cell_width_mm); several "
        "with commas, or none. All are alike if not given.",
    )
    module_at: tuple[Pixel, Pixel] | None = tunable(
        None,
        _module("point inside", "LR px", automatic="centre", advanced=True),
        "x and y of a point inside of the wanted module in the first frame; the completely "
        "visible module nearest to the centre if not given.",
    )
