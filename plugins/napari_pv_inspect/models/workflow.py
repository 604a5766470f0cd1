"""The steps from opening frames to the review: how far each is, and which comes next.

No Qt: `steps_of` and `next_step` read the model, docks/pages/workflow.py draws what they say.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

from napari_pv_inspect.models.workbench import RunState, WorkbenchModel
from pv_inspect.inspection.inspection import Inspection, stages
from pv_inspect.settings import Stage

__all__ = ["REVIEW", "NextStep", "Status", "StepAction", "StepView", "next_step", "steps_of"]

REVIEW = "review"

_WHAT: dict[str, str] = {
    "load": "The frames are open.",
    "detect": "The crossing points of the cells in every frame.",
    "calibrate": "Camera, distortion of the lens, and the pose of every frame.",
    "register": "The poses to a fraction of a pixel, each frame against the module.",
    "reconstruct": "One sharp image of the module out of all frames.",
    "cells": "The module image cut into its cells.",
    "cracks": "The probability of a crack for every pixel.",
    REVIEW: "An expert's verdict on every cell.",
}


class Status(Enum):
    """How far a step is."""

    DONE = "done"
    WORKING = "being done now"
    NEXT = "comes next"
    STALE = "out of date: a setting was changed since"
    FAILED = "failed"
    DOUBTED = "in doubt"
    WAITING = "not done yet"


class StepAction(Enum):
    """What the button of the next step does."""

    OPEN = "open"
    WAIT = "wait"
    GIVE_LAYOUT = "give layout"
    CONFIRM = "confirm"
    DETECT = "detect"
    RUN = "run"
    CANCEL = "cancel"
    REVIEW = "review"


@dataclass(frozen=True)
class StepView:
    """One step as it is drawn: its name, how far it is, and a sentence for the pointer."""

    name: str
    status: Status
    tip: str


@dataclass(frozen=True)
class NextStep:
    """What the next click does."""

    action: StepAction
    text: str
    tip: str


def steps_of(model: WorkbenchModel) -> tuple[StepView, ...]:
    """Return all steps from load to review."""
    statuses = _from_folder() if _only_looked_at(model) else _statuses(model)
    if model.doubts:
        doubted = (name for name in _DOUBTED if statuses.get(name, Status.WAITING) is Status.DONE)
        statuses.update(dict.fromkeys(doubted, Status.DOUBTED))
    views = []
    for name, status in statuses.items():
        why = status.value
        if model.failure and status is Status.FAILED:
            why = model.failure.why.rstrip(".")
        elif status is Status.DOUBTED:
            why = f"{status.value}: {' '.join(model.doubts).rstrip('.')}"
        views.append(StepView(name, status, f"{name}: {why}. {_WHAT[name]}"))
    return tuple(views)


def next_step(model: WorkbenchModel) -> NextStep:
    """Return what the next click does."""
    settings = model.settings
    if model.run_state is not RunState.IDLE:
        return _while_running(model)
    if model.sequence is None:
        if _only_looked_at(model):
            return NextStep(StepAction.REVIEW, "Review cells", "Show the cells of this result.")
        return NextStep(
            StepAction.OPEN, "Open folder...", "Choose a folder of frames, or of a result."
        )
    if settings.rows is None or settings.cols is None:
        if model.guessing:
            return NextStep(
                StepAction.WAIT,
                "Counting cells ...",
                "Rows and columns are guessed from the frames.",
            )
        return NextStep(
            StepAction.GIVE_LAYOUT,
            "Give rows and columns",
            "Go to the fields for rows and columns.",
        )
    if model.layout_is_guessed:
        return NextStep(
            StepAction.CONFIRM,
            f"Confirm {settings.rows} x {settings.cols} cells",
            "Rows x columns were guessed from the frames: say that they are right, or change them "
            "on the page Grid.",
        )
    to_do = model.to_do - {Stage.LOAD}
    if not to_do:
        return NextStep(StepAction.REVIEW, "Review cells", "Show the cells, one by one.")
    if Stage.DETECT in to_do:
        again = "Detect grid again" if model.failure else "Detect grid"
        return NextStep(
            StepAction.DETECT, again, "Find the crossing points and fit camera and grid."
        )
    first = min(to_do)
    text = f"Try again from {first.value}" if model.failure else f"Run from {first.value}"
    return NextStep(StepAction.RUN, text, f"Do {', '.join(s.value for s in sorted(to_do))}.")


def _while_running(model: WorkbenchModel) -> NextStep:
    if model.run_state is RunState.STOPPING:
        return NextStep(StepAction.WAIT, "Stopping ...", "The run ends at its next step.")
    if model.run_is_outdated:
        return NextStep(
            StepAction.RUN, "Run anew", "Settings were changed: end this run, start one with them."
        )
    if model.run_until is not None:
        return NextStep(
            StepAction.RUN, "Then run to the end", "Go on with the run after this step."
        )
    return NextStep(StepAction.CANCEL, "Cancel the run", "A whole result from before stays.")


def _statuses(model: WorkbenchModel) -> dict[str, Status]:
    statuses = {"load": Status.NEXT if model.sequence is None else Status.DONE}
    running = model.run_state is not RunState.IDLE
    shown = model.shown
    settings = model.run_settings if running else model.settings
    stale = frozenset(Stage) if shown is None else shown.stale(settings)
    ready = model.sequence is not None and not running
    for stage in stages():
        if running and stage is model.running_stage and stage in stale:
            status = Status.WORKING
        elif stage not in stale:
            status = Status.DONE
        elif ready and model.failure is not None and model.failure.stage is stage:
            status = Status.FAILED
        elif not running and _has(shown, stage):
            status = Status.STALE
        else:
            status = Status.WAITING
        if ready and status is not Status.DONE:
            ready = False
            status = Status.NEXT if status is Status.WAITING else status
        statuses[stage.value] = status
    statuses[REVIEW] = Status.NEXT if ready else Status.WAITING
    return statuses


def _from_folder() -> dict[str, Status]:
    """Return the steps of a result whose frames are not there."""
    done = dict.fromkeys((stage.value for stage in stages()), Status.DONE)
    return {"load": Status.WAITING, **done, REVIEW: Status.NEXT}


# What a doubt is about: the image, and all that is read from it.
_DOUBTED = tuple(stage.value for stage in (Stage.RECONSTRUCT, Stage.CELLS, Stage.CRACKS))


def _only_looked_at(model: WorkbenchModel) -> bool:
    return model.result is not None


def _has(inspection: Inspection | None, stage: Stage) -> bool:
    return inspection is not None and inspection.part(stage) is not None
