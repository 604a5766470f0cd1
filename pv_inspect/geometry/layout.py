"""The module plane: how many cells, where they and their crossing points lie."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from pv_inspect.common.gap_text import CellSizes, WideGaps
from pv_inspect.errors import InspectionError

__all__ = ["ModuleLayout"]

Points = NDArray[np.float64]
MAX_GAP = 2.0
"""Widest extra gap, module units: two cells."""
MAX_CELL_GAP = 0.5
SMALLEST, LARGEST = 0.1, 2.0
"""Of a cell that is not like the others, in parts of a usual one."""


@dataclass(frozen=True)
class ModuleLayout:
    """Cells of a module in the module plane.

    The unit of the plane is the pitch of the usual columns, the same in x and y. A crossing point
    is the middle of the gap between four cells; at the outer ones the module ends half a usual gap
    beside the cells.

    Parameters
    ----------
    rows, cols : int
        Number of cells along y and x.
    cell_aspect : float
        Width / height of the usual cells (2 for half-cut cells lying flat).
    row_gaps, col_gaps : tuple of (int, float)
        Gaps that are wider than the usual ones, in the middle of a half-cut module for example:
        (3, 0.1) is one below the third row (or right of the third column) that is wider by 0.1
        module units.
    cell_gap : tuple of float
        Width and height of the dark gap between all cells, module units, as far as the pitch
        leaves cells that are clearly smaller (mini-modules): 0 for the usual 1 to 3 mm.
    row_heights, col_widths : tuple of (int, float)
        Rows and columns whose cells are smaller or larger than the usual ones: (12, 0.5) is a
        twelfth column with a pitch of 0.5 module units.
    """

    rows: int
    cols: int
    cell_aspect: float = 1.0
    row_gaps: WideGaps = ()
    col_gaps: WideGaps = ()
    cell_gap: tuple[float, float] = (0.0, 0.0)
    row_heights: CellSizes = ()
    col_widths: CellSizes = ()

    def __post_init__(self) -> None:
        if self.rows < 1 or self.cols < 1:
            raise InspectionError(
                f"A module of {self.rows} rows x {self.cols} columns has no cells: "
                "give rows and cols of at least 1."
            )
        if not (np.isfinite(self.cell_aspect) and 0.1 <= self.cell_aspect <= 10):
            raise InspectionError(
                f"cell_aspect is {self.cell_aspect:g}, but cell width / cell height must lie "
                "between 0.1 and 10."
            )
        for what, gaps, cells in (
            ("row", self.row_gaps, self.rows),
            ("column", self.col_gaps, self.cols),
        ):
            _check_gaps(what, gaps, cells)
        _check_sizes("row", self.row_heights, self.rows, 1.0 / self.cell_aspect)
        _check_sizes("column", self.col_widths, self.cols, 1.0)
        largest = MAX_CELL_GAP * np.array([self.widths.min(), self.heights.min()])
        if not all(0 <= gap <= most for gap, most in zip(self.cell_gap, largest, strict=True)):
            raise InspectionError(
                f"cell_gap is {self.cell_gap[0]:g} x {self.cell_gap[1]:g} cell widths, but the gap "
                "between all cells must lie between 0 and half of a cell."
            )

    @property
    def plain(self) -> ModuleLayout:
        """The same rows and columns without any wide gap, all cells alike."""
        return ModuleLayout(self.rows, self.cols, self.cell_aspect)

    @property
    def widths(self) -> NDArray[np.float64]:
        """Pitch of each column, (cols,) module units."""
        return _sizes(self.col_widths, self.cols, 1.0)

    @property
    def heights(self) -> NDArray[np.float64]:
        """Pitch of each row, (rows,) module units."""
        return _sizes(self.row_heights, self.rows, 1.0 / self.cell_aspect)

    @property
    def col_starts(self) -> NDArray[np.float64]:
        """Where the pitch of each column begins, (cols,) module units."""
        return self._evenly_x[:-1] + _before(self.col_gaps, self.cols)

    @property
    def row_starts(self) -> NDArray[np.float64]:
        """Where the pitch of each row begins, (rows,) module units."""
        return self._evenly_y[:-1] + _before(self.row_gaps, self.rows)

    @property
    def col_lines(self) -> NDArray[np.float64]:
        """X of the lines of crossing points, (cols + 1,) module units."""
        return self._evenly_x + _lines(self.col_gaps, self.cols)

    @property
    def row_lines(self) -> NDArray[np.float64]:
        """Y of the lines of crossing points, (rows + 1,) module units."""
        return self._evenly_y + _lines(self.row_gaps, self.rows)

    @property
    def _evenly_x(self) -> NDArray[np.float64]:
        """Where columns begin and the last one ends without wide gaps, (cols + 1,)."""
        return np.arange(self.cols + 1) + _before(self._more_x, self.cols + 1)

    @property
    def _evenly_y(self) -> NDArray[np.float64]:
        return np.arange(self.rows + 1) / self.cell_aspect + _before(self._more_y, self.rows + 1)

    @property
    def _more_x(self) -> CellSizes:
        """By how much columns are wider than the usual ones; negative where they are narrower."""
        return tuple((number, width - 1.0) for number, width in self.col_widths)

    @property
    def _more_y(self) -> CellSizes:
        return tuple((n, height - 1.0 / self.cell_aspect) for n, height in self.row_heights)

    @property
    def size(self) -> tuple[float, float]:
        """Width and height of the module in module units."""
        extra_x = sum(more for _, more in (*self.col_gaps, *self._more_x))
        extra_y = sum(more for _, more in (*self.row_gaps, *self._more_y))
        return float(self.cols) + extra_x, self.rows / self.cell_aspect + extra_y

    @property
    def outline(self) -> Points:
        """Corners of the area of the cells, (4, 2) module units, clockwise from the top left."""
        (width, height), (gap_x, gap_y) = self.size, self.cell_gap
        left, top, right, bottom = gap_x / 2, gap_y / 2, width - gap_x / 2, height - gap_y / 2
        return np.array([[left, top], [right, top], [right, bottom], [left, bottom]])

    @property
    def n_crossings(self) -> int:
        """Number of crossing points, outer ones included: (rows + 1) * (cols + 1)."""
        return (self.rows + 1) * (self.cols + 1)

    def crossings(self) -> Points:
        """Crossing points in the module plane.

        Returns
        -------
        (n_crossings, 2) float64
            (x, y), row-major: without wide gaps, crossing (row i, column j) lies at
            (j, i / cell_aspect).
        """
        x, y = np.meshgrid(self.col_lines, self.row_lines)
        return np.column_stack([x.ravel(), y.ravel()])

    def places_in_cells(self, across: Points, down: Points) -> tuple[Points, Points]:
        """Places that lie alike in the pitch of every cell.

        Parameters
        ----------
        across, down : (nx,), (ny,) float64
            Shares of the pitch from its left and its top, 0 to 1.

        Returns
        -------
        x : (cols * nx,) float64
        y : (rows * ny,) float64
            Module units, cell by cell.
        """
        x = (self.col_starts[:, None] + across * self.widths[:, None]).ravel()
        y = (self.row_starts[:, None] + down * self.heights[:, None]).ravel()
        return x, y

    def cell_centres(self) -> Points:
        """Middles of all cells in the module plane, (rows * cols, 2), row-major."""
        x, y = np.meshgrid(*self.places_in_cells(np.array([0.5]), np.array([0.5])))
        return np.column_stack([x.ravel(), y.ravel()])

    def cell_corners(self, row: int, col: int) -> Points:
        """Corners of one cell in the module plane, (4, 2), clockwise from the top left."""
        gap_x, gap_y = self.cell_gap
        left, top = self.col_starts[col] + gap_x / 2, self.row_starts[row] + gap_y / 2
        right = left + self.widths[col] - gap_x
        bottom = top + self.heights[row] - gap_y
        return np.array([[left, top], [right, top], [right, bottom], [left, bottom]])

    def grid_lines(self, per_cell: int) -> list[Points]:
        """Lines through the crossing points, along x first, as points (n, 2) some per cell."""
        width, height = self.size
        across = np.linspace(0.0, width, self.cols * per_cell + 1)
        down = np.linspace(0.0, height, self.rows * per_cell + 1)
        lines = [np.column_stack([across, np.full_like(across, y)]) for y in self.row_lines]
        lines += [np.column_stack([np.full_like(down, x), down]) for x in self.col_lines]
        return lines

    @property
    def gaps_in_words(self) -> str:
        """What is said of wide gaps, as part of a sentence; "" if there are none."""
        words = [
            f"{gap:.3g} after {what} {after}"
            for what, gaps in (("row", self.row_gaps), ("column", self.col_gaps))
            for after, gap in gaps
        ]
        gap_x, gap_y = self.cell_gap
        if gap_x or gap_y:
            words.append(f"{gap_x:.3g} x {gap_y:.3g} between all cells")
        return " and ".join(words)

    @property
    def sizes_in_words(self) -> str:
        """What is said of cells unlike the usual ones, as part of a sentence; "" without any."""
        words = [
            f"{what} {number} {size:.3g} {how}"
            for what, how, sizes in (
                ("row", "high", self.row_heights),
                ("column", "wide", self.col_widths),
            )
            for number, size in sizes
        ]
        return " and ".join(words)

    def with_rows_around(self, n: int) -> ModuleLayout:
        """Return the layout with n more rows and columns on every side."""
        return replace(
            self,
            rows=self.rows + 2 * n,
            cols=self.cols + 2 * n,
            row_gaps=tuple((after + n, gap) for after, gap in self.row_gaps),
            col_gaps=tuple((after + n, gap) for after, gap in self.col_gaps),
            row_heights=tuple((number + n, height) for number, height in self.row_heights),
            col_widths=tuple((number + n, width) for number, width in self.col_widths),
        )

    def halved(self) -> ModuleLayout:
        """Return the layout with every cell cut in four; its unit is half of this one's."""
        return ModuleLayout(
            2 * self.rows,
            2 * self.cols,
            self.cell_aspect,
            tuple((2 * after, 2 * gap) for after, gap in self.row_gaps),
            tuple((2 * after, 2 * gap) for after, gap in self.col_gaps),
            row_heights=_cut_in_two(self.row_heights),
            col_widths=_cut_in_two(self.col_widths),
        )

    @property
    def turns(self) -> tuple[int, ...]:
        """Quarter turns that bring the crossing points onto each other."""
        halfway = all(
            np.allclose(lines, lines[-1] - lines[::-1], atol=1e-3)
            for lines in (self.col_lines, self.row_lines)
        )
        square = self.rows == self.cols and self.cell_aspect == 1.0
        alike = square and np.allclose(self.col_lines, self.row_lines, atol=1e-3)
        if halfway and alike:
            return (0, 1, 2, 3)
        return (0, 2) if halfway else (0,)


def _check_gaps(what: str, gaps: WideGaps, cells: int) -> None:
    numbers = [after for after, _ in gaps]
    if numbers != sorted(set(numbers)) or not all(1 <= after < cells for after in numbers):
        raise InspectionError(
            f"The wider gaps after {what}s {', '.join(map(str, numbers))} don't fit {cells} "
            f"{what}s: give each {what} once, in order, from 1 to {cells - 1}."
        )
    for after, gap in gaps:
        if not 0 < gap <= MAX_GAP:
            raise InspectionError(
                f"The gap after {what} {after} is wider by {gap:g} cell widths, but a value above "
                f"0 and up to {MAX_GAP:g} is expected."
            )


def _check_sizes(what: str, sizes: CellSizes, cells: int, usual: float) -> None:
    numbers = [number for number, _ in sizes]
    if numbers != sorted(set(numbers)) or not all(1 <= number <= cells for number in numbers):
        raise InspectionError(
            f"The sizes of {what}s {', '.join(map(str, numbers))} don't fit {cells} {what}s: give "
            f"each {what} once, in order, from 1 to {cells}."
        )
    if sizes and len(sizes) == cells:
        raise InspectionError(
            f"All {cells} {what}s are said to differ from the usual ones: leave out those that are "
            "as wide as most; what is 1 cell width is theirs."
        )
    for number, size in sizes:
        if not SMALLEST * usual <= size <= LARGEST * usual:
            raise InspectionError(
                f"{what.capitalize()} {number} is said to be {size:g} cell widths, but "
                f"{SMALLEST * usual:g} to {LARGEST * usual:g} are expected: a tenth of a usual "
                f"{what} to twice as much."
            )


def _sizes(sizes: CellSizes, cells: int, usual: float) -> NDArray[np.float64]:
    """Pitch of each of the cells."""
    pitch = np.full(cells, usual)
    for number, size in sizes:
        pitch[number - 1] = size
    return pitch


def _cut_in_two(sizes: CellSizes) -> CellSizes:
    """Both halves of each; the unit is halved as well."""
    return tuple((2 * n + k, size) for n, size in sizes for k in (-1, 0))


def _before(gaps: WideGaps, cells: int) -> NDArray[np.float64]:
    """Sum of the wide gaps before each of the cells."""
    extra = np.zeros(cells)
    for after, gap in gaps:
        extra[after:] += gap
    return extra


def _lines(gaps: WideGaps, cells: int) -> NDArray[np.float64]:
    """How far the wide gaps move each of the cells + 1 lines: a line lies in the middle of one."""
    extra = np.zeros(cells + 1)
    for after, gap in gaps:
        extra[after] += gap / 2
        extra[after + 1 :] += gap
    return extra
