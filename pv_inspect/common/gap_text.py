"""Wide gaps and uneven cells of a module as people write them: "10:0.1, 12:16mm"."""

from __future__ import annotations

import re

__all__ = [
    "NO_GAPS",
    "CellSizes",
    "WideGaps",
    "checked_gaps",
    "checked_sizes",
    "gap_text",
    "gaps_from",
    "sizes_from",
]

WideGaps = tuple[tuple[int, float], ...]
"""Pairs of the number of the row (or column) after which a gap is wider, and by how much."""

CellSizes = tuple[tuple[int, float], ...]
"""Pairs of the number of a column (or row) that differs from the usual ones, and its width."""

NO_GAPS = "none"
_ONE = re.compile(r"(\d{1,3})\s*:\s*(\d*\.?\d+)\s*(mm)?")


def gaps_from(text: str, cell_width_mm: float | None = None) -> WideGaps:
    """Read the wider gaps of the rows or of the columns.

    Parameters
    ----------
    text : str
        Pairs AFTER:WIDTH with commas between them: after which row (or column) a gap is wider than
        the others, and by how much, in widths of a cell or, with "mm" behind it, in millimetres;
        "none" for none.
    cell_width_mm : float, optional
        Pitch of the cells along a row.

    Returns
    -------
    tuple of (int, float)
        In widths of a cell.

    Raises
    ------
    ValueError
        With what is wrong as part of a sentence.
    """
    return _pairs(text, cell_width_mm, "gap: write AFTER:WIDTH, for example 10:0.1", "10:16mm")


def checked_gaps(text: str) -> str:
    """Return the text if `gaps_from` can read it; else raise its ValueError."""
    gaps_from(text, cell_width_mm=1.0)
    return text


def sizes_from(text: str, cell_width_mm: float | None = None) -> CellSizes:
    """Read the widths of the columns, or the heights of the rows, that differ from the usual ones.

    Parameters
    ----------
    text : str
        Pairs NUMBER:WIDTH with commas between them: which column (or row), and its pitch in usual
        cell widths or, with "mm" behind it, in millimetres; "none" for none.
    cell_width_mm : float, optional
        Pitch of the usual columns.

    Returns
    -------
    tuple of (int, float)
        In usual cell widths.

    Raises
    ------
    ValueError
        With what is wrong as part of a sentence.
    """
    return _pairs(text, cell_width_mm, "width: write NUMBER:WIDTH, for example 12:0.5", "12:78mm")


def checked_sizes(text: str) -> str:
    """Return the text if `sizes_from` can read it; else raise its ValueError."""
    sizes_from(text, cell_width_mm=1.0)
    return text


def _pairs(
    text: str, cell_width_mm: float | None, expected: str, in_mm: str
) -> tuple[tuple[int, float], ...]:
    if text.strip().lower() in ("", NO_GAPS):
        return ()
    pairs = []
    for part in text.split(","):
        found = _ONE.fullmatch(part.strip())
        if found is None:
            raise ValueError(
                f"{part.strip()[:40]!r} is no {expected} (cell widths) or {in_mm}, with commas "
                'between several, or "none"'
            )
        number, width, unit = found.groups()
        if unit and cell_width_mm is None:
            raise ValueError(
                f"{part.strip()!r} is in millimetres: give cell_width_mm as well, or the width in "
                "cell widths"
            )
        pairs.append((int(number), float(width) / (cell_width_mm or 1.0 if unit else 1.0)))
    return tuple(sorted(pairs))


def gap_text(gaps: WideGaps | CellSizes) -> str:
    """Write gaps, or widths of cells, as `gaps_from` and `sizes_from` read them."""
    return ", ".join(f"{after}:{width:.4g}" for after, width in gaps) or NO_GAPS
