"""The report of a review: one self-contained page that prints well, and the table of verdicts."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from datetime import date
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pv_inspect.common.versions import versions
from pv_inspect.cracks import CellFeatures, CrackMap
from pv_inspect.cracks.wording import class_text
from pv_inspect.errors import printable
from pv_inspect.geometry.grid import HrGrid
from pv_inspect.inspection.figures import RESIDUAL_MEANING, median_text
from pv_inspect.inspection.inspection import Inspection
from pv_inspect.inspection.stored import StoredResult
from pv_inspect.reconstruction.reconstruction import Reconstruction
from pv_inspect.registration.registration import Registration
from pv_inspect.reports.module_report import with_review_state
from pv_inspect.reports.pictures import contrast_of, crack_mask, grey, jpeg_url, overlay_url, shrunk
from pv_inspect.reports.templates import rendered
from pv_inspect.results.read import check_unchanged
from pv_inspect.review.selection import progress
from pv_inspect.review.store import ReviewStore
from pv_inspect.review.tables import DISAGREED, agreed, raters_of, verdicts_csv
from pv_inspect.review.verdicts import Cell, ModuleData, Verdict, VerdictKind, fingerprint, of_rater
from pv_inspect.settings import Settings
from pv_inspect.storage.folders import replace_file
from pv_inspect.storage.reservations import changing

__all__ = ["REVIEW_PAGE", "VERDICTS_TABLE", "export_review", "render_review"]

REVIEW_PAGE = "review.html"
VERDICTS_TABLE = "verdicts.csv"
Mask = NDArray[np.bool_]

# Longest sides, pixels.
_MODULE_PX = 1600
_CLOSE_UP_PX = 280
_N_CLOSE_UPS = 80


@dataclass(frozen=True)
class _Box:
    """A cell on the module picture, in its pixels, with one letter and colour per verdict."""

    cell: Cell
    x: float
    y: float
    width: float
    height: float
    kinds: tuple[VerdictKind, ...]

    @property
    def letter(self) -> float:
        """Side of the square with a letter."""
        return 0.24 * min(self.width, self.height)


def export_review(result: Inspection, store: ReviewStore) -> tuple[Path, Path]:
    """Write ``verdicts.csv`` and ``review.html`` into the result folder.

    ``review.html`` is the report to hand on; ``report.html`` says so, and how far the review is.

    Parameters
    ----------
    result : Inspection
        From `read_result`.
    store : ReviewStore
        Of the same folder.

    Returns
    -------
    (Path, Path)
        The table and the page.

    Raises
    ------
    InspectionError
        If the review can't be read or a file can't be written; then an earlier one is as it was.
        If another run has replaced the result since it was read.
    """
    stored, verdicts = _stored(result), store.current()
    page = render_review(result, verdicts, store.module_data(), store.masks())
    table_path, page_path = stored.folder / VERDICTS_TABLE, stored.folder / REVIEW_PAGE
    with changing(stored.folder):
        check_unchanged(stored)
        replace_file(table_path, verdicts_csv(result.need(CrackMap).cells, verdicts).encode())
        replace_file(page_path, page.encode())
        technical = stored.folder / "report.html"
        with suppress(OSError):  # one that is gone or locked is no reason to fail
            before = technical.read_bytes()
            raters, done = raters_of(verdicts), progress(verdicts, result.layout).text
            state = f"{done} by {', '.join(raters)}" if raters else done
            replace_file(technical, with_review_state(before, state))
    return table_path, page_path


def render_review(
    result: Inspection,
    verdicts: Sequence[Verdict],
    module: ModuleData | None = None,
    corrected: Mapping[Cell, Mask] | None = None,
) -> str:
    """Render the report of a review.

    Parameters
    ----------
    result : Inspection
        From `read_result`.
    verdicts : sequence of Verdict
        The current ones of all raters.
    module : ModuleData, optional
        What is not known gets a line to fill in by hand.
    corrected : mapping of (row, column) to (h, w) bool, optional
        Crack masks that are shown instead of the detector's.

    Returns
    -------
    str
        HTML with everything in it.
    """
    content = _content(result, verdicts, module or ModuleData(), corrected or {})
    return rendered("review.html.j2", **content)


def _content(
    result: Inspection,
    verdicts: Sequence[Verdict],
    module: ModuleData,
    corrected: Mapping[Cell, Mask],
) -> dict[str, Any]:
    made, cracks, layout = result.need(Reconstruction), result.need(CrackMap), result.layout
    image, grid = made.image, made.grid
    verdicts = [v for v in verdicts if v.row < layout.rows and v.col < layout.cols]
    raters = raters_of(verdicts)
    by_rater = {rater: of_rater(verdicts, rater) for rater in raters}
    by_cell: dict[Cell, dict[str, Verdict]] = {}
    for verdict in verdicts:
        by_cell.setdefault(verdict.cell, {})[verdict.rater] = verdict
    marks = _marks(cracks, grid, corrected)
    low, high = contrast_of(image, grid)
    picture = grey(shrunk(image, _MODULE_PX), low, high)
    close_ups = []
    for cell in cracks.cells:
        said = by_cell.get((cell.row, cell.col), {})
        if all(verdict.kind is VerdictKind.OK for verdict in said.values()):
            continue
        where = grid.cell_slices(cell.row, cell.col)
        close_ups.append(
            {
                "cell": cell,
                "verdicts": said,
                "image": jpeg_url(grey(shrunk(image[where], _CLOSE_UP_PX), low, high)),
                "overlay": overlay_url(marks[where], marks[where], _CLOSE_UP_PX),
            }
        )
    made_by = fingerprint(result.settings)
    return {
        "title": printable(_stored(result).folder.name),
        "date": date.today().isoformat(),
        "layout": layout,
        "module": module,
        "raters": raters,
        "progress": progress(verdicts, layout),
        "progress_of": {rater: progress(by_rater[rater].values(), layout) for rater in raters},
        "disagreed": [cell for cell, said in agreed(verdicts).items() if said == DISAGREED],
        "stale": sorted({v.cell for v in verdicts if v.settings and v.settings != made_by}),
        "kinds": list(VerdictKind),
        "picture": jpeg_url(picture),
        "picture_size": picture.shape[1::-1],
        "overlay": overlay_url(marks, marks, _MODULE_PX),
        "boxes": _boxes(cracks.cells, grid, by_cell, picture.shape[1] / grid.shape[1]),
        "close_ups": close_ups[:_N_CLOSE_UPS],
        "n_more": max(len(close_ups) - _N_CLOSE_UPS, 0),
        "rows": _rows(cracks.cells, by_cell, corrected),
        "quality": _quality(result),
        "settings": _settings(result.settings),
        "fingerprint": made_by,
        "warnings": result.warnings,
        "doubts": result.doubts,
        "counts": cracks.counts,
        "class_text": class_text,
        "made_with": _stored(result).versions,
        "versions": versions(),
    }


def _marks(cracks: CrackMap, grid: HrGrid, corrected: Mapping[Cell, Mask]) -> NDArray[np.float32]:
    """1 on the marks of cracks, a person's where there are some."""
    marks = crack_mask(cracks, grid)
    for cell in cracks.cells:
        part = marks[grid.cell_slices(cell.row, cell.col)]
        drawn = corrected.get((cell.row, cell.col))
        if drawn is not None and drawn.shape == part.shape:
            part[:] = drawn
    return marks


def _boxes(
    cells: Sequence[CellFeatures],
    grid: HrGrid,
    by_cell: Mapping[Cell, Mapping[str, Verdict]],
    scale: float,
) -> list[_Box]:
    found = []
    for cell in cells:
        y, x = grid.cell_slices(cell.row, cell.col)
        width, height = scale * (x.stop - x.start), scale * (y.stop - y.start)
        inset = 0.015 * min(width, height)  # frames of neighbours stay apart
        said = by_cell.get((cell.row, cell.col), {})
        kinds = tuple(dict.fromkeys(said[rater].kind for rater in sorted(said)))
        found.append(
            _Box(
                (cell.row, cell.col),
                scale * x.start + inset,
                scale * y.start + inset,
                width - 2 * inset,
                height - 2 * inset,
                kinds,
            )
        )
    return found


def _rows(
    cells: Sequence[CellFeatures],
    by_cell: Mapping[Cell, Mapping[str, Verdict]],
    corrected: Mapping[Cell, Mask],
) -> list[dict[str, Any]]:
    return [
        {
            "cell": cell,
            "verdicts": by_cell.get((cell.row, cell.col), {}),
            "corrected": (cell.row, cell.col) in corrected,
        }
        for cell in cells
    ]


def _quality(result: Inspection) -> list[tuple[str, str]]:
    """Numbers that tell how far the image can be trusted."""
    registration, made = result.need(Registration), result.need(Reconstruction)
    cracks, used = result.need(CrackMap), registration.used
    px, py = made.grid.pixels_per_cell
    residual = np.array(made.residual_rms)[used]
    return [
        ("Frames used", f"{int(used.sum())} of {len(used)}"),
        ("Magnification", f"{made.grid.magnification:.2f}×"),
        ("HR pixels per cell", f"{px:.0f} × {py:.0f}"),
        (f"Residual ({RESIDUAL_MEANING})", median_text(residual)),
        ("Support by the frames, mean (0 to 1)", f"{np.nanmean(made.support):.2f}"),
        ("Optical blur, sigma (frame pixels)", _known(made.psf_sigma_lr_px, ".2f")),
        ("Weight of the prior, lambda", _known(made.prior_weight, ".3g")),
        ("Distortion, kappa", f"{registration.camera.kappa:+.4f}"),
        ("Crack detector", f"{cracks.detector}, threshold {cracks.threshold:.2f}"),
    ]


def _stored(result: Inspection) -> StoredResult:
    assert result.stored is not None, "a review is of a result folder"
    return result.stored


def _known(value: float, form: str) -> str:
    return format(value, form) if np.isfinite(value) else "not known"


def _settings(settings: Settings) -> list[tuple[str, str, str]]:
    """Name, value and unit of every setting that has a value."""
    found = []
    for name in Settings.model_fields:
        value, unit = getattr(settings, name), Settings.unit_of(name)
        if value is not None and value != ():
            found.append((name, str(value), "" if unit in ("1", "file") else unit))
    return found
