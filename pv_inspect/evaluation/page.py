"""The page of a comparison: crops side by side, Table I, and quality over time."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pv_inspect.evaluation.case import Cell
from pv_inspect.evaluation.cell_images import ComparedSequence
from pv_inspect.evaluation.image_metrics import fitted
from pv_inspect.evaluation.scoring import PROTOCOLS, Row
from pv_inspect.evaluation.tables import average_rows
from pv_inspect.reports.pictures import grey, jpeg_url
from pv_inspect.reports.templates import rendered

__all__ = ["Strip", "page", "strips_of"]

Image = NDArray[np.float32]

TRUTH = "truth"
# Cells of each sequence and magnification on the page, and their side there.
_CELLS_SHOWN = 3
# Axes of the plot of quality over time, in its own units.
_PLOT = (640.0, 300.0)


@dataclass(frozen=True)
class Strip:
    """One cell by all methods, side by side.

    Parameters
    ----------
    title : str
    pictures : tuple of (str, str)
        Name of the method and address of the picture.
    """

    title: str
    pictures: tuple[tuple[str, str], ...]


def strips_of(made: ComparedSequence, truth: dict[Cell, Image] | None) -> list[Strip]:
    """Show some cells of one sequence by all methods.

    Parameters
    ----------
    made : ComparedSequence
    truth : dict of (row, col) to (h, w) float32, optional
        All pictures of a cell have the contrast of the truth, or of the last method without it.
    """
    present = {name: images for name, images in made.images.items() if images}
    if not present:
        return []
    cells = list(next(iter(present.values())))
    shown = [cells[k] for k in np.linspace(0, len(cells) - 1, _CELLS_SHOWN).astype(int)]
    strips = []
    for cell in dict.fromkeys(shown):
        target = truth[cell] if truth is not None else list(present.values())[-1][cell]
        low, high = (float(v) for v in np.percentile(target, [0.5, 99.8]))
        pictures = [
            (name, jpeg_url(grey(np.asarray(fitted(images[cell], target), np.float32), low, high)))
            for name, images in present.items()
        ]
        if truth is not None:
            pictures.append((TRUTH, jpeg_url(grey(target, low, high))))
        title = (
            f"{made.plan.name}, {made.plan.settings.magnification:g}x, "
            f"row {cell[0] + 1}, column {cell[1] + 1}"
        )
        strips.append(Strip(title, tuple(pictures)))
    return strips


def page(rows: Sequence[Row], strips: Sequence[Strip], command: str, versions: str) -> str:
    """Return the page as one HTML file without anything from elsewhere.

    Parameters
    ----------
    rows : sequence of Row
    strips : sequence of Strip
    command : str
        What made it.
    versions : str
    """
    averages = average_rows(rows)
    tables = [row.figures() for row in rows if not row.failed] + averages
    return rendered(
        "compare.html.j2",
        tables=tables,
        failed=[row for row in rows if row.failed],
        strips=strips,
        protocols={
            name: told for name, told in PROTOCOLS.items() if f"{name}_ap" in _names(tables)
        },
        plots=_plots(averages or tables),
        size=_PLOT,
        notes={row.method: row.note for row in rows},
        command=command,
        versions=versions,
    )


def _names(tables: Sequence[dict[str, object]]) -> set[str]:
    return {name for table in tables for name in table}


def _plots(tables: Sequence[dict[str, object]]) -> list[dict[str, object]]:
    """Points of crack AP over CPU seconds (paper, Fig. 10), one plot for each magnification."""
    plots = []
    name = "table1_ap"
    for magnification in dict.fromkeys(table["magnification"] for table in tables):
        points = []
        for table in tables:
            seconds, quality = table.get("cpu_s"), table.get(name)
            known = isinstance(seconds, float) and isinstance(quality, float)
            if table["magnification"] == magnification and known and seconds > 0:  # type: ignore[operator]
                points.append((str(table["method"]), float(seconds), float(quality)))  # type: ignore[arg-type]
        if not points:
            continue
        times = np.log10([seconds for _, seconds, _ in points])
        first, last = np.floor(times.min()), max(np.ceil(times.max()), np.floor(times.min()) + 1)
        width, height = _PLOT
        at = [
            {
                "method": method,
                "x": float((t - first) / (last - first) * width),
                "y": float((1 - quality) * height),
                "told": f"{method}: {seconds:.3g} CPU s, AP {quality:.3f}",
            }
            for (method, seconds, quality), t in zip(points, times, strict=True)
        ]
        ticks = [
            {"x": float((e - first) / (last - first) * width), "text": f"{10.0**e:g}"}
            for e in np.arange(first, last + 1)
        ]
        plots.append({"magnification": magnification, "points": at, "ticks": ticks})
    return plots
