"""Wide gaps of a module as people write them: "10:0.1, 12:16mm"."""

from __future__ import annotations

import re

__all__ = ["NO_GAPS", "WideGaps", "checked_gaps", "gap_text", "gaps_from"]

WideGaps = tuple[tuple[int, float], ...]
"""Pairs of the number of the row (or column) after which a gap is wider, and by how much."""

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
    if text.strip().lower() in ("", NO_GAPS):
        return ()
    gaps = []
    for part in text.split(","):
        found = _ONE.fullmatch(part.strip())
        if found is None:
            raise ValueError(
                f"{part.strip()[:40]!r} is no gap: write AFTER:WIDTH, for example 10:0.1 (cell "
                'widths) or 10:16mm, with commas between several, or "none"'
            )
        after, width, unit = found.groups()
        if unit and cell_width_mm is None:
            raise ValueError(
                f"{part.strip()!r} is in millimetres: give cell_width_mm as well, or the width of "
                "the gap in cell widths"
            )
        gaps.append((int(after), float(width) / (cell_width_mm or 1.0 if unit else 1.0)))
    return tuple(sorted(gaps))


def checked_gaps(text: str) -> str:
    """Return the text if `gaps_from` can read it; else raise its ValueError."""
    gaps_from(text, cell_width_mm=1.0)
    return text


def gap_text(gaps: WideGaps) -> str:
    """Write the gaps as `gaps_from` reads them."""
    return ", ".join(f"{after}:{width:.4g}" for after, width in gaps) or NO_GAPS
