"""Scoring the images of a comparison: one row for every sequence, magnification and method."""

from __future__ import annotations

from collections.abc import Generator
from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

from pv_inspect.common.work import Progress
from pv_inspect.cracks.network import NetworkDetector
from pv_inspect.cracks.training.scores import CoarseScore, coarse_score
from pv_inspect.errors import InspectionError
from pv_inspect.evaluation.case import Cell
from pv_inspect.evaluation.cell_images import ComparedSequence
from pv_inspect.evaluation.image_metrics import (
    ImageScore,
    fitted,
    fourier_ring_correlation,
    image_score,
    ring_cutoff,
)
from pv_inspect.evaluation.truth import Truth, read_truth

__all__ = ["PROTOCOLS", "KnownCells", "Row", "known_cells", "rows_of"]

Image = NDArray[np.float32]
Mask = NDArray[np.bool_]

PROTOCOLS = {
    "table1": "network of sharp cells, against its segmentation of the truth (paper, Table I)",
    "labels": "network of sharp cells, against the labels",
    "default": "default network, against the labels",
}
"""How cracks are scored."""
_BLOCK_PX = 16  # HR px (Sec. IV-D)


@dataclass(frozen=True)
class Row:
    """What is said of one method on one sequence at one magnification.

    Parameters
    ----------
    sequence, method, note : str
    magnification : float
    cpu_s : float
        Of the image, without the geometry that most methods share.
    geometry_cpu_s : float
    cells : int
    failed : str
        Why there are no figures; empty if there are.
    image : ImageScore or None
        None without truth.
    cracks : dict of str to CoarseScore
        By `PROTOCOLS`; empty without truth.
    half_frc_cutoff : float or None
        Where the images of two halves of the frames first correlate by less than 1/7, cycles per
        LR px; None if they were not made.
    """

    sequence: str
    magnification: float
    method: str
    note: str
    cpu_s: float
    geometry_cpu_s: float
    cells: int
    failed: str
    image: ImageScore | None
    cracks: dict[str, CoarseScore]
    half_frc_cutoff: float | None = None

    def figures(self) -> dict[str, float | str | int]:
        """Return all figures by name, flat, as a tidy table has them."""
        found: dict[str, float | str | int] = {
            "sequence": self.sequence,
            "magnification": self.magnification,
            "method": self.method,
            "cells": self.cells,
            "cpu_s": round(self.cpu_s, 2),
            "geometry_cpu_s": round(self.geometry_cpu_s, 2),
        }
        if self.image is not None:
            for entry in fields(self.image):
                value = getattr(self.image, entry.name)
                if entry.name == "shift_px":
                    found["shift_x_lr_px"], found["shift_y_lr_px"] = value
                else:
                    found[entry.name] = value
        for protocol, score in self.cracks.items():
            for entry in fields(score):
                found[f"{protocol}_{entry.name}"] = getattr(score, entry.name)
        if self.half_frc_cutoff is not None:
            found["half_frc_cutoff"] = self.half_frc_cutoff
        found["note"], found["failed"] = self.note, self.failed
        return found


@dataclass(frozen=True, eq=False)
class KnownCells:
    """The truth of the compared cells, on the pixels of their images.

    Parameters
    ----------
    radiance : dict of (row, col) to (h, w) float32
    cracks : dict of (row, col) to (h, w) bool, or None
        None if nobody has marked them.
    """

    radiance: dict[Cell, Image]
    cracks: dict[Cell, Mask] | None


def rows_of(
    made: ComparedSequence, known: KnownCells | None
) -> Generator[Progress, None, list[Row]]:
    """Score all methods on one sequence.

    Parameters
    ----------
    made : ComparedSequence
    known : KnownCells or None
        Of `known_cells`; without it nothing is scored.

    Yields
    ------
    Progress

    Returns
    -------
    list of Row
        In the order of the methods.
    """
    detectors = {name: NetworkDetector(name) for name in ("sharp", "default")}
    rows = []
    reference = None if known is None else _reference(known, detectors["sharp"])
    for k, method in enumerate(made.plan.methods):
        record, images = made.records[method.name], made.images[method.name]
        scored: ImageScore | None = None
        cracks: dict[str, CoarseScore] = {}
        if known is not None and reference is not None and images:
            pairs = [(image, known.radiance[cell]) for cell, image in images.items()]
            scored = image_score(pairs, made.grid.magnification)
            cracks = _cracks(images, known.cracks, reference, detectors)
        rows.append(
            Row(
                made.plan.name,
                made.plan.settings.magnification,
                method.name,
                record.note,
                record.cpu_s,
                made.grid.geometry_cpu_s,
                len(images),
                record.failed,
                scored,
                cracks,
                _half_frc(made, method.name),
            )
        )
        yield Progress((k + 1) / len(made.plan.methods), f"scoring {made.plan.name}, {method.name}")
    return rows


def _half_frc(made: ComparedSequence, name: str) -> float | None:
    """Compare the images of two halves of the frames: what is in both is no noise."""
    first, second = made.halves.get(name, ({}, {}))
    if not first or not second:
        return None
    pairs = [(first[c].astype(np.float64), second[c].astype(np.float64)) for c in first]
    return ring_cutoff(*fourier_ring_correlation(pairs, made.grid.magnification))


def _cracks(
    images: dict[Cell, Image],
    labels: dict[Cell, Mask] | None,
    reference: dict[Cell, Mask],
    detectors: dict[str, NetworkDetector],
) -> dict[str, CoarseScore]:
    maps = {
        name: [detector.probability(np.ascontiguousarray(image)) for image in images.values()]
        for name, detector in detectors.items()
    }
    threshold = {name: one.operating_point.threshold for name, one in detectors.items()}
    found = {
        "table1": coarse_score(
            zip(maps["sharp"], [reference[cell] for cell in images], strict=True),
            threshold["sharp"],
            _BLOCK_PX,
        )
    }
    if labels is not None:
        masks = [labels[cell] for cell in images]
        for protocol, name in (("labels", "sharp"), ("default", "default")):
            pairs = zip(maps[name], masks, strict=True)
            found[protocol] = coarse_score(pairs, threshold[name], _BLOCK_PX)
    return found


def _reference(known: KnownCells, detector: NetworkDetector) -> dict[Cell, Mask]:
    """Segmentation of the truth on the pixels of the grid: what Table I is measured against."""
    threshold = detector.operating_point.threshold
    return {cell: detector.probability(t) >= threshold for cell, t in known.radiance.items()}


def known_cells(made: ComparedSequence) -> KnownCells | None:
    """Read the truth of the compared cells, once for all methods.

    Parameters
    ----------
    made : ComparedSequence

    Returns
    -------
    KnownCells or None
        None if the sequence has no folder ``truth``, or no method has an image.

    Raises
    ------
    InspectionError
        If it is damaged or of another module.
    """
    truth, grid = _truth_of(made), made.grid
    if truth is None:
        return None
    windows = {cell: grid.window(cell) for cell in grid.cells}
    marked = {cell: truth.cracks_on(grid, window) for cell, window in windows.items()}
    cracks = {cell: mask for cell, mask in marked.items() if mask is not None}
    radiance = {cell: truth.on(grid, window) for cell, window in windows.items()}
    return KnownCells(radiance, cracks or None)


def _truth_of(made: ComparedSequence) -> Truth | None:
    """Read the truth and turn it as the result lies: a module looks the same upside down."""
    read = read_truth(made.plan.sequence)
    some = next((images for images in made.images.values() if images), None)
    if read is None or some is None:
        return None
    truth, shape = read
    grid = made.grid
    same, across = shape == (grid.rows, grid.cols), shape == (grid.cols, grid.rows)
    turns = [k for k in range(4) if (same if k % 2 == 0 else across)]
    width, height = grid.size
    candidates = {
        k: truth.turned(k, (width, height) if k % 2 == 0 else (height, width)) for k in turns
    }

    def unlike(turned: Truth) -> float:
        errors = []
        for cell, image in some.items():
            true = turned.on(grid, grid.window(cell))
            errors.append(
                float(((fitted(image, true) - true) ** 2).mean() / max(true.var(), 1e-12))
            )
        return float(np.mean(errors))

    if not candidates:
        raise InspectionError(
            f"The truth of {made.plan.name} is of a module of {shape[0]} x {shape[1]} cells, but "
            f"the frames show {grid.rows} x {grid.cols}: compare without truth (--no-truth)."
        )
    return min(candidates.values(), key=unlike)
