"""What a person wants to know about the cracks of one cell, in numbers."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

from pv_inspect.cracks.areas import (
    UNSUPPORTED,
    dark_shares,
    isolated,
    support_on,
    unsupported_share,
)
from pv_inspect.cracks.blocks import LEAST_BLOCK, cut_off_blocks
from pv_inspect.cracks.centreline import branches, length_of
from pv_inspect.cracks.fingers import InterruptedFinger, interrupted_fingers
from pv_inspect.cracks.isolation import Busbars
from pv_inspect.cracks.marks import OperatingPoint, crack_marks
from pv_inspect.cracks.seen import sight_known, would_show

__all__ = [
    "FEATURES",
    "UNSUPPORTED",
    "CellFeatures",
    "OperatingPoint",
    "crack_marks",
    "from_texts",
    "measure_cell",
    "texts",
]

# A cell that is dark in at least this share has no current through it: what looks like a crack in
# it is noise, or can't be told from noise.
_DARK_CELL_SHARE = 0.5
# The score looks at as many pixels as a mark of this length and width has.
_SCORE_LENGTH_CELLS = 0.1
_SCORE_WIDTH_CELLS = 0.01
_UNSUPPORTED_SHARE = 0.5
# Classes: less than this share of the cell counts as nothing cut off, and brightness of what would
# be cut off relative to the rest of the cell.
_LEAST_ISOLATED = 0.01
_CONNECTED, _DISCONNECTED = 0.8, 0.4


@dataclass(frozen=True)
class CellFeatures:
    """Crack features of one cell.

    Parameters
    ----------
    row, col : int
        Position in the module, from 0.
    crack_length_cells : float
        Length of all crack instances together along their centre lines, in cell widths.
    crack_instances : int
        Connected marks that are long and slender enough for a crack (`crack_marks`). 0 in a dark
        cell: nothing can be read from it.
    dark_area_share : float
        Share of the cell that emits less than half of what is usual in the module; thin lines
        (cracks, busbars) do not count.
    mean_intensity : float
        Mean of the tile, full scale = 1.
    crack_score : float
        In [0, 1]: mean probability of the most suspicious pixels, as many as a crack of a tenth
        of the cell's width has. It does not depend on the threshold.
    crack_branches : int
        Pieces of the centre lines between ends and junctions.
    crack_length_mm : float
        ``crack_length_cells`` in millimetres; NaN if the size of the cell is not known.
    largest_dark_share : float
        Largest connected part of ``dark_area_share``.
    isolated_area_share : float
        Share of the cell that the cracks would cut off from every busbar in the worst case
        (`isolated_share`); NaN if no busbars were found.
    isolated_brightness : float
        Mean brightness there divided by that of the rest of the cell; NaN if nothing is cut off.
    crack_support : float
        Mean support of the image on the marks, or over the cell if there are none: the share of
        its finest detail that the frames have determined. Where it is low, fine cracks can
        neither be trusted nor excluded. NaN if no support map is known.
    unsupported_share : float
        Share of the crack length, or of the area of a cell without cracks, that lies on pixels
        with a support under 0.1. NaN if no support map is known.
    unsure : bool
        Whether cracks would not show in the cell (`wording.CLASS_RULE`).
    weak_marks : bool
        Whether there are marks, but all are too short or too faint for a class
        (`OperatingPoint.least_length_cells`, ``least_score``); marks without length always are.
    novelty : float
        How far the look of the cell is from all that the detector has learnt; from 1 on its
        cracks can't be judged. NaN if the detector does not say.
    cut_off_share : float
        Share of the cell that is dark and ends at a sharp, straight edge: cut off, or broken off
        (`cut_off_blocks`). 0 where there are no marks; NaN in a table of an older version.
    crack_detail : float
        Share of a detail as fine as cracks that comes from the frames (`CellSight.detail`); NaN if
        it is not known: then ``unsupported_share`` says what the frames did not earn.
    edge_blur : float
        Blur of the image at the edges of the cell, standard deviation in cell widths; NaN if it is
        not known.
    finger_interruptions : float
        Number of dark bars along fingers (`interrupted_fingers`); they are no cracks and count in
        no other feature. NaN where they are not looked for: in dark cells, in cells in which
        cracks would not show, without busbars, in a table of an older version.
    finger_interruption_length_cells : float
        Their length together, in cell widths; NaN as above.
    """

    row: int
    col: int
    crack_length_cells: float
    crack_instances: int
    dark_area_share: float
    mean_intensity: float
    crack_score: float
    crack_branches: int = 0
    crack_length_mm: float = float("nan")
    largest_dark_share: float = 0.0
    isolated_area_share: float = float("nan")
    isolated_brightness: float = float("nan")
    crack_support: float = float("nan")
    unsupported_share: float = float("nan")
    unsure: bool = False
    weak_marks: bool = False
    novelty: float = float("nan")
    cut_off_share: float = float("nan")
    crack_detail: float = float("nan")
    edge_blur: float = float("nan")
    finger_interruptions: float = float("nan")
    finger_interruption_length_cells: float = float("nan")

    @property
    def has_marks(self) -> bool:
        """Whether there is at least one mark that a crack could have made, supported or not."""
        return self.crack_instances > 0

    @property
    def undecidable(self) -> bool:
        """Whether it is left open what the class is: neither suspected nor clean."""
        return (self.unsure or self.weak_marks or self.unfamiliar) and not self.dark

    @property
    def unfamiliar(self) -> bool:
        """Whether the cell looks unlike all that the detector has learnt."""
        return self.novelty >= 1

    @property
    def crack_suspected(self) -> bool:
        """Whether cracks are suspected: there are marks, and the cell could be judged."""
        return self.has_marks and not self.undecidable and not self.dark

    @property
    def dark(self) -> bool:
        """Whether most of the cell is dark, so that its cracks are not judged."""
        return self.dark_area_share >= _DARK_CELL_SHARE

    @property
    def supported(self) -> bool:
        """Whether cracks would show in the cell (`seen.would_show`).

        Where that is not known: whether less than half of the cracks (of a cell without: of its
        area) is unsupported; true if no support map is known either.
        """
        if sight_known(self.crack_detail):
            return would_show(self.crack_detail, self.edge_blur)
        return not self.unsupported_share >= _UNSUPPORTED_SHARE

    @property
    def marked_class(self) -> str:
        """Class after `wording.CLASS_RULE` if every mark is right; A, B, C are modes of [1]_.

        References
        ----------
        .. [1] M. Koentges et al., "The risk of power loss in crystalline silicon based
               photovoltaic modules due to micro-cracks", Solar Energy Materials and Solar
               Cells 95, 2011. doi:10.1016/j.solmat.2010.10.034
        """
        if self.dark:
            return "dark"
        if self.has_marks and self.cut_off_share >= LEAST_BLOCK:
            return "C"
        return _class_of(self.crack_instances, self.isolated_area_share, self.isolated_brightness)

    @property
    def crack_class(self) -> str:
        """Class after `wording.CLASS_RULE`; "unsure" is the id of a cell that can't be judged."""
        return "unsure" if self.undecidable else self.marked_class


def _class_of(instances: int, isolated_share: float, isolated_brightness: float) -> str:
    if not instances:
        return "none"
    if math.isnan(isolated_share):
        return "unknown"
    if isolated_share < _LEAST_ISOLATED or math.isnan(isolated_brightness):
        return "A"
    if isolated_brightness >= _CONNECTED:
        return "A"
    return "B" if isolated_brightness >= _DISCONNECTED else "C"


# Names of the features, as in tables.
FEATURES = tuple(spec.name for spec in fields(CellFeatures))[2:]


def texts(cell: CellFeatures) -> list[str]:
    """Features in the order of `FEATURES`, for a table."""
    return [f"{getattr(cell, name):.6g}" for name in FEATURES]


def from_texts(row: int, col: int, line: Mapping[str, str]) -> CellFeatures:
    """Read features from a line of a table; what a table of an older version lacks is unknown.

    Raises
    ------
    KeyError, ValueError, TypeError
        If a value is missing or no number.
    """
    kinds: dict[str, Callable[[str], float]] = {
        "int": int,
        "float": float,
        "bool": lambda text: bool(int(text)),
    }
    values = {
        spec.name: kinds[str(spec.type)](line[spec.name])
        for spec in fields(CellFeatures)
        if spec.name in FEATURES and spec.name in line
    }
    return CellFeatures(row=row, col=col, **values)  # type: ignore[arg-type]


def measure_cell(
    tile: NDArray[np.float32],
    probability: NDArray[np.float32],
    threshold: float,
    *,
    row: int,
    col: int,
    cell_width_px: float,
    usual_intensity: float,
    busbars: Busbars | None = None,
    cell_width_mm: float | None = None,
    least_extent_cells: float = OperatingPoint.least_extent_cells,
    support: NDArray[np.float32] | None = None,
    marks: list[NDArray[np.bool_]] | None = None,
    least_length_cells: float = OperatingPoint.least_length_cells,
    least_score: float = OperatingPoint.least_score,
    novelty: float = math.nan,
    blocks: NDArray[np.bool_] | None = None,
    seen: tuple[float, float] = (math.nan, math.nan),
) -> CellFeatures:
    """Measure the cracks of one cell.

    Parameters
    ----------
    tile, probability : (h, w) float32
        Image of the cell and crack probability of its pixels.
    threshold : float
        Pixels with at least this probability count as crack.
    row, col : int
        Position of the cell in the module.
    cell_width_px : float
        Pixels per cell width.
    usual_intensity : float
        Median intensity of the module, in the units of ``tile``.
    busbars : Busbars, optional
        Where the busbars lie; without them nothing is said about isolated areas.
    cell_width_mm : float, optional
    least_extent_cells : float
        See `crack_marks`.
    support : (h, w) float32, optional
        Support map of the cell.
    marks : list of (h, w) bool, optional
        What a person has marked as cracks, instead of what `crack_marks` finds; none is too weak.
    least_length_cells, least_score : float
        See `OperatingPoint`.
    novelty : float
        See `CellFeatures`.
    blocks : (h, w) bool, optional
        Of `cut_off_blocks`, looked for if not given.
    seen : (float, float)
        How well the cell was seen, `CellFeatures.crack_detail` and ``edge_blur``.

    Returns
    -------
    CellFeatures
    """
    dark_share, largest_dark = dark_shares(tile, usual_intensity, cell_width_px)
    readable = dark_share < _DARK_CELL_SHARE
    by_hand = marks is not None
    if marks is None:
        found = crack_marks(probability, threshold, cell_width_px, least_extent_cells)
        marks = found if readable else []
    lines = [branches(mark) for mark in marks]
    lengths = [sum(map(length_of, chains)) / cell_width_px for chains in lines]
    length, longest = sum(lengths), max(lengths, default=0.0)
    cut_off, brightness = isolated(tile, marks, busbars)
    if marks and blocks is None:
        blocks = cut_off_blocks(tile)
    block_share = float(blocks.mean()) if marks and blocks is not None else 0.0
    unsupported, unsure = float("nan"), False
    if support is not None:
        unsupported = unsupported_share([chain for chains in lines for chain in chains], support)
    if sight_known(seen[0]):  # a broad dark area is seen in any frame
        unsure = readable and block_share < LEAST_BLOCK and not would_show(*seen)
    elif support is not None:
        shares = [unsupported_share(chains, support) for chains in lines]
        if readable and not marks:
            unsure = unsupported >= _UNSUPPORTED_SHARE
        elif marks and block_share < LEAST_BLOCK:
            firm = [m for m, share in zip(marks, shares, strict=True) if share < _UNSUPPORTED_SHARE]
            without = _class_of(len(firm), *isolated(tile, firm, busbars))
            unsure = without != _class_of(len(marks), cut_off, brightness)
    fingers: list[InterruptedFinger] | None = None
    if busbars is not None and readable and (not sight_known(seen[0]) or would_show(*seen)):
        fingers = interrupted_fingers(tile, busbars, marks)
    n_score = round(_SCORE_LENGTH_CELLS * _SCORE_WIDTH_CELLS * cell_width_px**2)
    n_score = min(max(n_score, 1), probability.size)
    highest = np.partition(probability, probability.size - n_score, axis=None)[-n_score:]
    score = float(highest.mean(dtype=np.float64))
    weak = longest <= 0 or longest < least_length_cells or score < least_score
    return CellFeatures(
        row=row,
        col=col,
        crack_length_cells=float(length),
        crack_instances=len(marks),
        dark_area_share=dark_share,
        mean_intensity=float(tile.mean(dtype=np.float64)),
        crack_score=score,
        crack_branches=sum(map(len, lines)),
        crack_length_mm=float("nan") if cell_width_mm is None else float(length * cell_width_mm),
        largest_dark_share=largest_dark,
        isolated_area_share=cut_off,
        isolated_brightness=brightness,
        crack_support=support_on(support, marks),
        unsupported_share=unsupported,
        unsure=unsure,
        weak_marks=bool(marks) and not by_hand and weak and block_share < LEAST_BLOCK,
        novelty=novelty,
        cut_off_share=block_share,
        crack_detail=seen[0],
        edge_blur=seen[1],
        **_finger_features(fingers, cell_width_px),
    )


def _finger_features(
    fingers: list[InterruptedFinger] | None, cell_width_px: float
) -> dict[str, float]:
    if fingers is None:
        return {}
    return {
        "finger_interruptions": float(len(fingers)),
        "finger_interruption_length_cells": sum(bar.length_px for bar in fingers) / cell_width_px,
    }
