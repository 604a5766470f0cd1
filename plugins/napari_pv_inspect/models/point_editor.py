"""Edits of crossing points: undoable, kept apart from what was detected. No Qt, no napari."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import replace
from functools import partial

import numpy as np
from numpy.typing import NDArray
from psygnal import Signal

from napari_pv_inspect.models.history import Action, History
from napari_pv_inspect.models.point_edits import Place, Point, PointEdits
from napari_pv_inspect.models.workbench import RunState, WorkbenchModel
from pv_inspect.calibration.calibrate import Calibration
from pv_inspect.calibration.refit import refit_frame
from pv_inspect.detection.crossings import Crossings
from pv_inspect.inspection.inspection import Inspection

__all__ = ["PointEditor"]

Array = NDArray[np.float64]


class PointEditor:
    """The crossing points of the shown inspection, and the geometry that follows an edit.

    An edit puts other crossing points into the inspection, which drops what was made of the
    earlier ones; undoing all edits brings the inspection of the detected points back. Edits end
    with the points that they correct: a detection for another layout discards them, and says so.

    Attributes
    ----------
    edits : PointEdits
    crossings : Crossings or None
        The points with the edits in them.
    calibration : Calibration or None
        The newest geometry: after an edit only the pose of its frame is new, until a calibration
        of all frames is entered into the inspection.
    """

    edits: PointEdits
    crossings: Crossings | None
    calibration: Calibration | None
    _detected: Crossings | None
    _of_the_run: Crossings | None
    _base: Inspection | None

    changed = Signal()

    def __init__(self, model: WorkbenchModel, history: History) -> None:
        self._model = model
        self._history = history
        self._forget()
        model.inspection_changed.connect(self._on_inspection)
        model.run_changed.connect(self._on_run)

    @property
    def provisional(self) -> bool:
        """Whether `calibration` still waits for a fit of all frames."""
        inspection = self._model.inspection
        return inspection is not None and inspection.calibration is not self.calibration

    def predicted(self, frame: int) -> Array:
        """Where the crossings of a frame should lie: (n_crossings, 2) px.

        A frame without a pose borrows that of the nearest one: the module hardly moves between
        them, and its points can be dragged to their places.
        """
        fit = self.calibration
        if fit is None or not fit.used.any():
            n = 0 if self.crossings is None else self.crossings.layout.n_crossings
            return np.full((n, 2), np.nan)
        return fit.crossings_px(nearest_used(fit, frame))

    def move(self, frame: int, points: Mapping[int, Point]) -> bool:
        """Put crossings, by their number, at other places; False if that can't be."""
        return self._edit(frame, dict(points), "Move")

    def with_points(self, frame: int, points: Mapping[int, Point]) -> Crossings | None:
        """Return the crossings with some of a frame at other places, which is no edit yet."""
        crossings = self.crossings
        if crossings is None or not points:
            return crossings
        frames = list(crossings.frames)
        frames[frame] = frames[frame].with_edits(dict(points))
        return replace(crossings, frames=tuple(frames))

    def add(self, frame: int, points: Iterable[Point]) -> bool:
        """Set the crossings nearest to some places; False if one is too far from all of them."""
        predicted = self.predicted(frame)
        if not np.isfinite(predicted).any():
            self._model.notice("There is no grid to add a point to: detect the grid first.")
            return False
        changes: dict[int, Point] = {}
        for x, y in points:
            k = nearest_crossing(predicted, (x, y))
            if k is None:
                self._model.notice(
                    "No crossing of the grid is within half a cell of this place: "
                    "add the point nearer to one."
                )
                return False
            changes[k] = (x, y)
        return self._edit(frame, changes, "Add")

    def remove(self, frame: int, crossings: Iterable[int]) -> bool:
        """Take measured points away; the fit predicts them from then on."""
        if self.crossings is None:
            return False
        measured = self.crossings.frames[frame].measured
        there = [k for k in crossings if measured[k]]
        if not there:
            self._model.notice("A predicted point can't be deleted: it shows the fit.")
            return False
        return self._edit(frame, dict.fromkeys(there), "Delete")

    def _edit(self, frame: int, changes: Mapping[int, Point | None], verb: str) -> bool:
        detected = self._detected
        if detected is None or not changes:
            return False
        if self._model.run_state is not RunState.IDLE:
            self._model.notice("Points can be edited when the run has ended.")
            return False
        width = detected.layout.cols + 1
        places: dict[Place, Point | None] = {
            (frame, k // width, k % width): point for k, point in changes.items()
        }
        what = "a crossing point" if len(places) == 1 else f"{len(places)} crossing points"
        before, after = self.edits, self.edits.changed(places)
        self._history.perform(
            Action(
                f"{verb} {what}",
                partial(self._put, detected, after),
                partial(self._put, detected, before),
            )
        )
        return True

    def _put(self, detected: Crossings, edits: PointEdits) -> None:
        if detected is not self._detected:
            return  # Of points that are no longer there.
        frames = edits.frames_that_differ(self.edits)
        self.edits = edits
        self.crossings = edits.apply(detected)
        if self.calibration is not None:
            for i in frames:
                self.calibration = refit_frame(self.calibration, self.crossings, i)
        if self._model.run_state is RunState.IDLE:
            self._enter()
        else:
            self.changed.emit()

    def _enter(self) -> None:
        """Put the points into the shown inspection."""
        current = self._model.inspection
        if current is None or self.crossings is None:
            return
        if not self.edits and self._base is not None:
            self.calibration = self._base.calibration or self.calibration
            self._model.revise(self._base)
        else:
            self._model.revise(current.with_part(self.crossings))

    def _on_inspection(self, inspection: Inspection | None) -> None:
        if inspection is None:
            self._forget()
            self.changed.emit()
        elif self._model.run_state is RunState.IDLE and inspection.crossings is not None:
            self._take(inspection)

    def _take(self, inspection: Inspection) -> None:
        found = inspection.crossings
        of_the_run, self._of_the_run = self._of_the_run, None
        if found is not self.crossings and found is not self._detected and found is not of_the_run:
            if self.edits:
                self._model.notice(
                    f"The points were detected anew: {len(self.edits.points)} edited points of "
                    "the earlier grid are discarded."
                )
            self._forget()
            self._detected = self.crossings = found
        if found is self._detected:
            self._base = inspection
        if found is not self.crossings:
            # Undone or redone while the run went on.
            self._enter()
        elif inspection.calibration is not None:
            self.calibration = inspection.calibration
        self.changed.emit()

    def _on_run(self, state: RunState) -> None:
        if state is RunState.RUNNING:
            self._of_the_run = self.crossings

    def _forget(self) -> None:
        self.edits = PointEdits()
        self.crossings = self._detected = self._of_the_run = None
        self.calibration = self._base = None


def nearest_used(fit: Calibration, frame: int) -> int:
    """Number of the used frame that is nearest in the sequence."""
    used = np.flatnonzero(fit.used)
    return int(used[np.argmin(np.abs(used - frame))])


def nearest_crossing(predicted: Array, place: Point) -> int | None:
    """Number of the crossing within half a cell of a place, None if there is none.

    Parameters
    ----------
    predicted : (n_crossings, 2) float64
        (x, y) px; NaN where unknown.
    place : (x, y)
    """
    away = np.hypot(*(predicted - place).T)
    if not np.isfinite(away).any():
        return None
    k = int(np.nanargmin(away))
    apart = np.hypot(*(predicted - predicted[k]).T)
    apart[k] = np.nan
    if not np.isfinite(apart).any():
        return None
    return k if away[k] <= 0.5 * np.nanmin(apart) else None
