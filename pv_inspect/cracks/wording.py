"""The features of a cell in words, for tooltips and reports."""

from __future__ import annotations

import math
from collections.abc import Iterable

from pv_inspect.cracks.counts import CellState
from pv_inspect.cracks.features import UNSUPPORTED, CellFeatures
from pv_inspect.cracks.seen import LEAST_DETAIL, MOST_BLUR, sight_known, why_unseen

__all__ = [
    "CLASS_RULE",
    "CLASS_WORDS",
    "SUPPORT_RULE",
    "class_text",
    "described",
    "finger_text",
    "length_text",
    "tooltip",
    "undecidable_because",
    "unseen_because",
]

# What the class with the id "unsure" is called: "unsure" is a verdict that an expert gives.
_UNDECIDABLE = CellState.UNDECIDABLE.value

CLASS_RULE = f"""\
dark             at least half of the cell is dark: cracks are not judged
none             no mark that a crack could have made
A                cracks that cut off less than 1 % of the cell even if no current crossed them, or
                 what they would cut off is at least 0.8 times as bright as the rest: connected
B                what the cracks would cut off is 0.4 to 0.8 times as bright as the rest: badly
                 connected
C                it is less than 0.4 times as bright as the rest: cut off; or a part of at least
                 1 % of the cell is as dark and ends at a sharp, straight edge, whatever the marks:
                 cut off, or broken off (chipped corners)
unknown          cracks, but no busbars were found
{_UNDECIDABLE}  the marks are too short or too faint for a class, or the cell looks unlike all
                 that the detector has learnt, or
                 cracks would not show: less than {LEAST_DETAIL:g} of a detail as fine as they are
                 (14 to 28 periods per cell width, in four fifths of the cell) comes from the
                 frames, or the image is blurred by more than {MOST_BLUR:g} cell widths
                 ("unsure" in cells.csv, verdicts.csv and result.json)
"""

# By the id of the class, in the order of how much they matter to an expert, the worst first.
CLASS_WORDS = {
    "C": "cracks, a part is cut off",
    "B": "cracks, a part is badly connected",
    "A": "cracks, all parts are connected",
    "unknown": "cracks, but no busbars were found",
    "unsure": "left open",
    "dark": "cracks are not judged",
    "none": "no cracks",
}
SUPPORT_RULE = (
    f"Cracks would not show: less than {LEAST_DETAIL:.0%} of a detail of 14 to 28 periods per cell "
    "width comes from the frames, because of noise, coarse pixels or overexposure, or the image is "
    f"blurred over more than {MOST_BLUR:.2%} of the cell's width (standard deviation, measured at "
    "the edges of the cells). Results of earlier versions count by the support map instead: at "
    "least half of the crack length, or of the area of a cell without cracks, lies on pixels with "
    f"a support under {UNSUPPORTED:g}."
)
"""What the mark of cells that are not `CellFeatures.supported` means."""


def length_text(cell: CellFeatures) -> str:
    """Length of the cracks with its unit: mm if the size of the cell is known."""
    if math.isnan(cell.crack_length_mm):
        return f"{cell.crack_length_cells:.2f} cell widths"
    return f"{cell.crack_length_mm:.0f} mm"


def undecidable_because(cell: CellFeatures) -> str:
    """Return why a cell can't be judged."""
    if cell.unfamiliar:
        return "looks unlike all that the detector has learnt"
    if cell.weak_marks:
        return "marks too short or too faint for a crack"
    return unseen_because(cell)


def unseen_because(cell: CellFeatures) -> str:
    """Return why cracks would not show in a cell, or that they are not supported by the frames."""
    if sight_known(cell.crack_detail):
        return why_unseen(cell.crack_detail, cell.edge_blur)
    return "not supported by the frames"


def class_text(cell: CellFeatures) -> str:
    """Class of a cell as it is shown: ``can't be judged (A)`` has marks of an A, if they are right.

    Parameters
    ----------
    cell : CellFeatures

    Returns
    -------
    str
    """
    if not cell.undecidable:
        return cell.crack_class
    return f"{_UNDECIDABLE} ({cell.marked_class})" if cell.has_marks else _UNDECIDABLE


def described(cell: CellFeatures) -> list[tuple[str, str]]:
    """Describe a cell in pairs of what was measured and a readable value with its unit.

    Parameters
    ----------
    cell : CellFeatures

    Returns
    -------
    list of (str, str)
    """
    kind = CLASS_WORDS[cell.crack_class]
    if cell.undecidable:
        kind = undecidable_because(cell)
        kind += f"; {cell.marked_class} if the marks are right" if cell.has_marks else "; no marks"
    name = _UNDECIDABLE if cell.undecidable else cell.crack_class
    pairs = [("class", f"{name} ({kind})")]
    if cell.has_marks:
        n = cell.crack_branches
        cracks = f"{cell.crack_instances}, {n} {'branch' if n == 1 else 'branches'}"
        pairs += [("cracks", cracks), ("crack length", length_text(cell))]
        cut_off, brightness = cell.isolated_area_share, cell.isolated_brightness
        if math.isnan(cut_off):
            pairs.append(("cut off at worst", "unknown, no busbars were found"))
        else:
            bright = "" if math.isnan(brightness) else f", {brightness:.0%} as bright as the rest"
            pairs.append(("cut off at worst", f"{cut_off:.1%} of the cell{bright}"))
    if cell.cut_off_share > 0:
        pairs.append(("cut off, by its edge", f"{cell.cut_off_share:.1%} of the cell"))
    if cell.finger_interruptions > 0:
        length = f"together {cell.finger_interruption_length_cells:.2f} cell widths, no cracks"
        pairs.append(("interrupted fingers", f"{cell.finger_interruptions:.0f}, {length}"))
    elif not math.isnan(cell.finger_interruptions):
        pairs.append(("interrupted fingers", "none seen"))
    dark = f"{cell.dark_area_share:.1%} of the cell, largest piece {cell.largest_dark_share:.1%}"
    pairs += [
        ("dark area", dark),
        ("mean brightness", f"{cell.mean_intensity:.1%} of full scale"),
        ("crack score", f"{cell.crack_score:.2f} of 1"),
    ]
    if not math.isnan(cell.novelty):
        pairs.append(("novelty of its look", f"{cell.novelty:.2f}, from 1 on it can't be judged"))
    if sight_known(cell.crack_detail):
        show = why_unseen(cell.crack_detail, cell.edge_blur) or "cracks would show"
        blur = (
            "unknown" if math.isnan(cell.edge_blur) else f"{cell.edge_blur:.2%} of a cell's width"
        )
        pairs.append(("seen", f"{cell.crack_detail:.0%} of fine detail, blur {blur}: {show}"))
    elif not math.isnan(cell.unsupported_share):
        where = "crack length" if cell.has_marks else "cell"
        supported = "yes" if cell.supported else "no"
        share = f"{cell.unsupported_share:.0%} of the {where} is unsupported"
        pairs.append(("supported by the frames", f"{supported}, {share}"))
    return pairs


def finger_text(cells: Iterable[CellFeatures]) -> str:
    """Sum up the interrupted fingers of a module, with the cells in which none was looked for.

    Parameters
    ----------
    cells : iterable of CellFeatures

    Returns
    -------
    str
        No full stop; "" if none was seen.
    """
    cells = list(cells)
    known = [cell for cell in cells if not math.isnan(cell.finger_interruptions)]
    n = round(sum(cell.finger_interruptions for cell in known))
    if not n:
        return ""
    affected = sum(cell.finger_interruptions > 0 for cell in known)
    text = f"{n} interrupted {'finger' if n == 1 else 'fingers'} in {affected} of {len(cells)} "
    text += f"{'cell' if len(cells) == 1 else 'cells'}, no cracks by themselves"
    left = len(cells) - len(known)
    return f"{text}; not looked for in {left}" if left else text


def tooltip(cell: CellFeatures) -> str:
    """Everything about a cell, one feature per line, its place first."""
    lines = [f"Row {cell.row + 1}, column {cell.col + 1}"]
    lines += [f"{what}: {value}" for what, value in described(cell)]
    return "\n".join(lines)
