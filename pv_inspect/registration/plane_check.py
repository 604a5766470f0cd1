"""Whether the module plane is right: its lines and gaps, compared with the image of all frames.

A wrong gap bends a grid, or makes it end elsewhere, by a few tenths of a pixel, and every frame is
wrong in the same way: the frames still agree with each other. What is seen here was not used to
choose the gaps (see `pv_inspect.registration.seen_lines`).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pv_inspect.common.gap_text import WideGaps
from pv_inspect.geometry.grid import HrGrid
from pv_inspect.geometry.layout import ModuleLayout
from pv_inspect.registration.module_mean import module_mean
from pv_inspect.registration.registration import Registration
from pv_inspect.registration.seen_lines import SeenLines, seen_lines
from pv_inspect.sequence.sequence import FrameSequence

__all__ = ["check_lines", "check_plane"]

Array = NDArray[np.float64]

MAGNIFICATION = 2.0
MARGIN = 0.3
"""Around the module, cell widths: its outer cells must be seen to end."""
CLEAR_SIGMA = 5.0
PITCH_UNITS, PITCH_PX = 0.015, 0.25
WIDTH_UNITS, WIDTH_PX = 0.02, 0.5
END_UNITS, END_PX = 0.03, 0.75
LINE_UNITS, LINE_PX = 0.02, 0.4
TREND_PX = 0.25
"""What differs by more from the layout, and by more than `CLEAR_SIGMA`, is a doubt: the larger of
both limits. Chosen on simulated modules (benchmarks/gapped_modules.py): of seeds 0 to 24, 67, 83
and 87, and of 49 drawn ones with a blur of 0.5 to 3 px, none was doubted; of 14 of these seeds with
gaps told wrong by 0.025 cell widths and more all were but one (by 0.026, crossing points off by
0.11 px). At 4 sigma one of the drawn ones would be doubted. The smooth part of what lines lie off
was at most 0.1 px in right modules and 0.5 in a wrong one."""
MOST_FREE = 8
"""Of fewer lines a step can't be told from perspective and lens."""
LINE_FLOOR_PX = 0.05
"""Unevenness of a line by itself: cells are not cut and laid to less."""
RESOLVED_PX, RESOLVED_BLURS = 1.0, 2.4
"""Blur makes a narrow gap seem wider, up to the sum of so many pixels and standard deviations."""
USUAL_WIDEST = 0.06
"""Of the gaps that a layout need not have, cell widths."""


@dataclass(frozen=True)
class _Direction:
    """Lines of one direction with what the layout says of them."""

    lines: SeenLines
    pitch: float
    gaps: WideGaps
    between: float


def check_plane(sequence: FrameSequence, registration: Registration) -> str:
    """Compare the module plane with the image of all frames.

    Parameters
    ----------
    sequence : FrameSequence
    registration : Registration

    Returns
    -------
    str
        A sentence on what does not fit; empty if all fits, or if too little is seen.
    """
    layout = registration.layout
    grid = HrGrid.covering(layout, registration.lr_px_per_unit, MAGNIFICATION, MARGIN)
    module, _ = module_mean(sequence, registration, grid)
    return check_lines(layout, *seen_lines(module, grid))


def check_lines(layout: ModuleLayout, columns: SeenLines, rows: SeenLines) -> str:
    """Say what does not fit of the lines that were seen.

    Parameters
    ----------
    layout : ModuleLayout
    columns, rows : SeenLines

    Returns
    -------
    str
        A sentence; empty if all fits.
    """
    directions = (
        _Direction(columns, 1.0, layout.col_gaps, layout.cell_gap[0]),
        _Direction(rows, 1 / layout.cell_aspect, layout.row_gaps, layout.cell_gap[1]),
    )
    for one in directions:
        checks = (_between_all, _wide_gaps, _pitch, _trend, _offsets, _ends)
        fault = next((said for check in checks if (said := check(one))), "")
        if fault:
            return (
                f"The layout does not fit what the frames show together: {fault} Cells, lengths "
                "and cracks near the borders may be misplaced: check rows, cols, the gaps "
                "(--row-gaps, --col-gaps, --cell-gap), and whether all rows and columns are alike "
                "(--row-heights, --col-widths)."
            )
    return ""


def _usual(one: _Direction) -> tuple[Array, Array]:
    """Widths of the gaps at the inner lines, module units; NaN at the wide ones; with sigma."""
    widths, sigma = one.lines.widths
    widths = widths.copy()
    for after, _ in one.gaps:
        widths[after - 1] = np.nan
    return widths, sigma


def _between_all(one: _Direction) -> str:
    """Say whether the gaps between all cells are of another width."""
    widths, sigma = _usual(one)
    known = np.isfinite(widths)
    if not known.any():
        return ""
    lr_px = one.lines.lr_px
    seen = float(np.median(widths[known]))
    off = float(np.median(sigma[known])) / np.sqrt(known.sum())
    resolved = RESOLVED_PX / lr_px + RESOLVED_BLURS * one.lines.blur
    if one.between:
        # Blur leaves a narrow gap as wide as itself.
        told = max(one.between, seen) if seen < resolved else one.between
        wrong = abs(seen - told)
        limit = max(WIDTH_UNITS, WIDTH_PX / lr_px)
    else:
        wrong = seen - max(USUAL_WIDEST, resolved)
        limit = 0.0
    if not wrong > max(limit, CLEAR_SIGMA * off):
        return ""
    has = f"{one.between:.3g}" if one.between else "no such gap"
    return (
        f"between all {one.lines.name}s a gap of {seen:.3g} cell widths is seen, and the layout "
        f"has {has}."
    )


def _wide_gaps(one: _Direction) -> str:
    """Say whether a single gap is wider or narrower than the layout has it."""
    widths, sigma = one.lines.widths
    usual, _ = _usual(one)
    lr_px = one.lines.lr_px
    told = dict(one.gaps)
    for k, (width, off) in enumerate(zip(widths, sigma, strict=True)):
        others = np.delete(usual, k)
        others = others[np.isfinite(others)]
        if not np.isfinite(width) or not others.size:
            continue
        gap = told.get(k + 1, 0.0)
        # Of a usual gap blur shows more than there is: a wide one adds something in between.
        most = float(np.median(others)) + gap
        least = max(gap + one.between, 0.0 if gap else most)
        spread = float(np.median(np.abs(others - np.median(others)))) * 1.4826
        clear = CLEAR_SIGMA * float(np.hypot(off, spread))
        limit = max(WIDTH_UNITS, 2 * WIDTH_PX / lr_px, clear)
        if least - limit <= width <= most + limit:
            continue
        return (
            f"the gap after {one.lines.name} {k + 1} is {width:.3g} cell widths wide, and the "
            f"layout has {gap:.3g} more than the usual {float(np.median(others)):.2g}."
        )
    return ""


def _pitch(one: _Direction) -> str:
    """Say whether the cells on both sides of a line lie nearer or further than the layout says."""
    offsets, sigma = one.lines.offsets
    lr_px = one.lines.lr_px
    known = np.isfinite(offsets) & np.isfinite(sigma)
    n = int(known.sum())
    if n < MOST_FREE:
        return ""
    base = _smooth(len(offsets))
    at = np.hypot(sigma, LINE_FLOOR_PX / lr_px)
    best, line, step = 0.0, 0, 0.0
    for k in range(len(offsets)):
        moved = 0.5 * np.sign(np.arange(len(offsets)) - k)
        design = np.column_stack([base, moved])[known] / at[known, None]
        values = offsets[known] / at[known]
        solution, *_ = np.linalg.lstsq(design, values, rcond=None)
        rest = values - design @ solution
        spread = max(1.0, float(np.sqrt(rest @ rest / max(n - 5, 1))))
        error = spread * float(np.sqrt(np.linalg.pinv(design.T @ design)[4, 4]))
        if error > 0 and abs(solution[4]) / error > best:
            best, line, step = abs(float(solution[4])) / error, k + 1, float(solution[4])
    if best > CLEAR_SIGMA and abs(step) > max(PITCH_UNITS, PITCH_PX / lr_px):
        what = "further apart" if step > 0 else "nearer together"
        return (
            f"the cells on both sides of the line after {one.lines.name} {line} lie "
            f"{abs(step):.3g} cell widths {what} than the layout says."
        )
    return ""


def _smooth(n: int) -> Array:
    """How perspective and lens may move n lines: (n, 4)."""
    return np.vander(2 * np.arange(1, n + 1) / (n + 1) - 1, 4)


def _trend(one: _Direction) -> str:
    """Say whether the lines lie off more and more towards a side, or bow."""
    offsets, sigma = one.lines.offsets
    known = np.isfinite(offsets) & np.isfinite(sigma)
    base = _smooth(len(offsets))[:, max(5 - int(known.sum()), 0) :]
    if not known.any() or not base.shape[1]:
        return ""
    lr_px = one.lines.lr_px
    at = np.hypot(sigma, LINE_FLOOR_PX / lr_px)[known]
    solution, *_ = np.linalg.lstsq(base[known] / at[:, None], offsets[known] / at, rcond=None)
    smooth = base @ solution
    cov = np.linalg.pinv((base[known] / at[:, None]).T @ (base[known] / at[:, None]))
    error = np.sqrt(np.einsum("ki,ij,kj->k", base, cov, base))
    worst = int(np.argmax(np.where(known, np.abs(smooth), 0.0)))
    if abs(smooth[worst]) <= max(TREND_PX / lr_px, CLEAR_SIGMA * error[worst]):
        return ""
    return (
        f"the lines between {one.lines.name}s lie up to {abs(smooth[worst]) * lr_px:.2g} px of a "
        f"frame beside their places, most near {one.lines.name} {worst + 1}."
    )


def _offsets(one: _Direction) -> str:
    """Say whether a line lies elsewhere."""
    offsets, sigma = one.lines.offsets
    lr_px = one.lines.lr_px
    limit = np.maximum(max(LINE_UNITS, LINE_PX / lr_px), CLEAR_SIGMA * sigma)
    with np.errstate(invalid="ignore"):
        wrong = np.abs(offsets) > limit
    if not wrong.any():
        return ""
    worst = int(np.nanargmax(np.where(wrong, np.abs(offsets), 0.0)))
    return (
        f"the line after {one.lines.name} {worst + 1} lies {abs(offsets[worst]):.3g} cell widths "
        "beside its place."
    )


def _ends(one: _Direction) -> str:
    """Say whether the outer cells end elsewhere."""
    ends, sigma = one.lines.ends
    lr_px = one.lines.lr_px
    for end, off, which in zip(ends, sigma, ("first", "last"), strict=True):
        if not np.isfinite(end):
            continue
        least, most = one.between / 2, max(one.between / 2, USUAL_WIDEST / 2)
        limit = max(END_UNITS, END_PX / lr_px, CLEAR_SIGMA * off)
        if least - limit <= end <= most + limit:
            continue
        return (
            f"the {which} {one.lines.name} ends {abs(end - least):.3g} cell widths "
            f"{'inside' if end > least else 'outside'} of its place."
        )
    return ""
