"""State of the workbench: the sequence, the settings, what is known so far. No Qt, no napari.

Views listen to the signals; only controllers change the state, and only in the main thread.
"""

from __future__ import annotations

from collections.abc import Generator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from enum import Enum
from typing import Any

import numpy as np
from psygnal import Signal

from pv_inspect.detection.layout_guess import LayoutGuess
from pv_inspect.errors import InspectionError
from pv_inspect.geometry.layout import ModuleLayout
from pv_inspect.inspection.inspection import Inspection, Step
from pv_inspect.sequence.sequence import FrameSequence
from pv_inspect.settings import Settings, Stage

__all__ = ["Failure", "RunState", "WorkbenchModel"]

_SIGNALS = {
    "run_changed": "run_state",
    "cell_selected": "selected_cell",
    "sequence_changed": "sequence",
    "settings_changed": "settings",
    "inspection_changed": "shown",
    "result_opened": "result",
}
"""What each signal tells, in the order in which they are emitted."""

FRAMES_GONE = "The frames of this result are not there: nothing can be computed from it."


class RunState(Enum):
    """Whether a run is under way."""

    IDLE = "idle"
    RUNNING = "running"
    STOPPING = "stopping"


@dataclass(frozen=True)
class Failure:
    """Why the last run failed, and in which stage."""

    stage: Stage
    why: str


class WorkbenchModel:
    """The open sequence and all that was found out about it.

    Attributes
    ----------
    sequence : FrameSequence or None
    settings : Settings
        What the controls say; the next run uses it.
    result : Inspection or None
        A result folder that is looked at without its frames: nothing of it is computed again.
    frames_gone : str
        One sentence while there is such a result: why its frames can't be used; "" else.
    run_settings : Settings
        What the current run was started with.
    run_until : Stage or None
        Where the current run stops; None: it does all stages.
    running_stage : Stage or None
        What the current run is working on.
    failure : Failure or None
        Of the last run; the next one, or another sequence, makes it forgotten.
    inspection : Inspection or None
        What is shown and saved. A cancelled run leaves a complete one as it was.
    guess : LayoutGuess or None
        What was guessed from the frames because the sequence came without rows and columns.
    guessing : bool
        Whether rows and columns are being guessed just now.
    draft : Inspection or None
        What the current or the last, cancelled run has found so far; a later run resumes from it.
    selected_cell : (row, col) or None
        The cell that gallery, live view and review show, from 0.
    """

    changed = Signal()
    """Once for all that changed together, after those of the following that say what."""
    sequence_changed = Signal(object)
    settings_changed = Signal(object)
    inspection_changed = Signal(object)
    result_opened = Signal(object)
    preview_changed = Signal(object)
    run_changed = Signal(object)
    progress_changed = Signal(float, str)
    noticed = Signal(str, bool)
    cell_selected = Signal(object)

    def __init__(self) -> None:
        self.sequence: FrameSequence | None = None
        self.settings = self.run_settings = Settings()
        self.inspection: Inspection | None = None
        self.draft: Inspection | None = None
        self.guess: LayoutGuess | None = None
        self.guessing = False
        self.result: Inspection | None = None
        self.frames_gone = ""
        self.run_state = RunState.IDLE
        self.run_until: Stage | None = None
        self.running_stage: Stage | None = None
        self.failure: Failure | None = None
        self.selected_cell: tuple[int, int] | None = None
        self._depth = 0
        self._touched: set[str] = set()

    @contextmanager
    def _one_change(self) -> Generator[None]:
        """Emit each signal once for all that changes inside the context, at its end."""
        self._depth += 1
        try:
            yield
        finally:
            self._depth -= 1
            if self._depth == 0 and self._touched:
                touched, self._touched = self._touched, set()
                for name, value in _SIGNALS.items():
                    if name in touched:
                        getattr(self, name).emit(getattr(self, value))
                self.changed.emit()

    def _tell(self, *names: str) -> None:
        """Note what is another now, by its signal; `changed` comes in any case."""
        with self._one_change():
            self._touched.update(names or ("changed",))

    @property
    def shown(self) -> Inspection | None:
        """What the views draw: the growing draft while a run goes on, else the inspection."""
        return self.draft if self.run_state is not RunState.IDLE else self.inspection

    @property
    def to_do(self) -> frozenset[Stage]:
        """Stages that the next run has to do again, or for the first time."""
        if self.inspection is None:
            return frozenset(Stage)
        return self.inspection.stale(self.settings)

    @property
    def doubts(self) -> tuple[str, ...]:
        """Why what is shown must not be relied on; empty while a run works on something new."""
        if self.run_state is not RunState.IDLE:
            return ()
        known = self.inspection or self.result
        return () if known is None else known.doubts

    @property
    def why_hidden(self) -> str:
        """Why the result of other rows and columns is not shown; "" if there is none such.

        As long as no run has failed it is what the user may go back to; after a run with the new
        ones has failed it must not be taken for the result of that run.
        """
        old, asked = self.inspection, self.settings
        failed = self.failure is not None and self.run_state is RunState.IDLE
        if not failed or old is None or old.reconstruction is None:
            return ""
        layout = old.layout
        if Stage.DETECT not in self.to_do or (layout.rows, layout.cols) == (asked.rows, asked.cols):
            return ""
        return (
            f"The run with {asked.rows} x {asked.cols} cells failed. The earlier result with "
            f"{layout.rows} x {layout.cols} is hidden: set rows and columns back to see it again."
        )

    def open(self, sequence: FrameSequence) -> None:
        """Open another sequence; settings about the module come from its sidecar."""
        hint = {
            k: v for k, v in sequence.layout_hint.items() if k in {"rows", "cols", "cell_aspect"}
        }
        unknown = dict.fromkeys(("rows", "cols", "cell_aspect", "kappa", "module_at"))
        frames = {"keep_frames": (), "skip_frames": ()}
        self._put(sequence, self.settings.changed(**{**unknown, **frames, **hint}))

    def reopen(self, sequence: FrameSequence) -> None:
        """Take over the same frames, read in another way; the settings stay."""
        guess = self.guess
        with self._one_change():
            self._put(sequence, self.settings)
            self.guess = guess

    def restore(self, inspection: Inspection) -> None:
        """Open an inspection out of a result folder, with its frames and settings."""
        settings = _with_layout(inspection.settings, inspection.layout)
        with self._one_change():
            self._put(inspection.frames, settings)
            self.inspection = replace(inspection, settings=settings)

    def _put(self, sequence: FrameSequence | None, settings: Settings) -> None:
        with self._one_change():
            self.sequence = sequence
            self.guess, self.guessing = None, False
            self.inspection = self.draft = self.result = None
            self.frames_gone = ""
            self.failure = self.run_until = self.running_stage = None
            self._enter(RunState.IDLE)
            self.settings = settings
            self.select_cell(None)
            self._tell("sequence_changed", "settings_changed", "inspection_changed")

    def offer_layout(self, sequence: FrameSequence, guess: LayoutGuess | None) -> None:
        """Enter a guessed layout into the settings, unless the user has given one.

        Parameters
        ----------
        sequence : FrameSequence
            What was guessed from; another one that is open by now makes the guess void.
        guess : LayoutGuess or None
            None: the layout can't be guessed from the frames.
        """
        with self._one_change():
            if sequence is self.sequence:
                self.set_guessing(False)
                self._take_layout(guess)

    def _take_layout(self, guess: LayoutGuess | None) -> None:
        given = self.settings.rows is not None or self.settings.cols is not None
        if (given and not self.layout_is_guessed) or self.run_state is not RunState.IDLE:
            return
        if guess is None:
            self.notice("The frames do not tell how many cells the module has: give rows, columns.")
            return
        layout = guess.layout
        self.guess = guess
        self.change_settings(rows=layout.rows, cols=layout.cols, cell_aspect=layout.cell_aspect)

    def set_guessing(self, guessing: bool) -> None:
        """Say whether rows and columns are being guessed just now."""
        if guessing != self.guessing:
            self.guessing = guessing
            self._tell()

    @property
    def layout_is_guessed(self) -> bool:
        """Whether rows, columns and aspect still are what was guessed from the frames."""
        if self.guess is None:
            return False
        layout = self.guess.layout
        settings = self.settings
        return (settings.rows, settings.cols, settings.cell_aspect) == (
            layout.rows,
            layout.cols,
            layout.cell_aspect,
        )

    def confirm_layout(self) -> None:
        """Say that the guessed rows and columns are right."""
        if self.guess is not None:
            self.guess = None
            self._tell("settings_changed")

    def select_cell(self, cell: tuple[int, int] | None) -> None:
        """Show another cell in all views."""
        if cell != self.selected_cell:
            self.selected_cell = cell
            self._tell("cell_selected")

    def open_result(self, result: Inspection, why: str = FRAMES_GONE) -> None:
        """Show a result folder without its frames; its settings go into the controls.

        Parameters
        ----------
        result : Inspection
            Without a sequence.
        why : str
            One sentence: why the frames can't be used.
        """
        with self._one_change():
            self._put(None, _with_layout(result.settings, result.layout))
            self.result, self.frames_gone = result, why
            self._tell("result_opened")

    def change_settings(self, **values: Any) -> None:
        """Change some settings; a value out of its range becomes a notice and changes nothing."""
        try:
            settings = self.settings.changed(**values)
        except InspectionError as error:
            self.notice(str(error), is_error=True)
            return
        if settings != self.settings:
            self.settings = settings
            self._tell("settings_changed")

    def revise(self, inspection: Inspection | None) -> None:
        """Show an inspection that the user has changed; the next run resumes from it."""
        if self.run_state is RunState.IDLE:
            self.inspection, self.draft = inspection, None
            self._tell("inspection_changed")

    def notice(self, text: str, is_error: bool = False) -> None:
        """Show the user one sentence."""
        self.noticed.emit(text, is_error)

    def begin_run(self, until: Stage | None = None) -> Inspection | None:
        """Enter the running state.

        Parameters
        ----------
        until : Stage, optional
            Where the run is going to stop.

        Returns
        -------
        Inspection or None
            What the run may resume from.

        Raises
        ------
        InspectionError
            If there is no sequence, the layout is unknown, or a run is under way.
        """
        if self.sequence is None:
            raise InspectionError("There is no sequence to inspect: open a folder of frames first.")
        if self.run_state is not RunState.IDLE:
            raise InspectionError("A run is under way: wait for it, or cancel it first.")
        start = best_start(self.settings, self.inspection, self.draft)
        layout = self.sequence.layout(self.settings)
        self.draft = start or Inspection(self.sequence, self.settings, layout)
        self.run_settings = self.settings
        self.run_until, self.running_stage, self.failure = until, None, None
        self._enter(RunState.RUNNING)
        return start

    @property
    def run_is_outdated(self) -> bool:
        """Whether the settings were changed since the current run was started."""
        return self.run_state is not RunState.IDLE and self.settings != self.run_settings

    def take_step(self, step: Step) -> None:
        """Take over the part of the inspection that one step of a run has made."""
        with self._one_change():
            if step.stage is not self.running_stage:
                self.running_stage = step.stage
                self._tell()
            self.progress_changed.emit(step.fraction, step.message)
            if isinstance(step.partial, np.ndarray):
                self.preview_changed.emit(step.partial)
            elif step.partial is not None and self.draft is not None:
                grown = self.draft.with_part(step.partial)
                layout, found = grown.frames.layout(self.run_settings), grown.crossings
                if found and (found.layout.rows, found.layout.cols) == (layout.rows, layout.cols):
                    # With the wide gaps that the frames show.
                    layout = found.layout
                self.draft = replace(grown, settings=self.run_settings, layout=layout)
                self._tell("inspection_changed")

    def stopping(self) -> None:
        """Say that the run was asked to stop."""
        self._enter(RunState.STOPPING)

    def end_run(self, result: Inspection | None, keep_draft: bool, why: str = "") -> None:
        """Leave the running state.

        Parameters
        ----------
        result : Inspection or None
            What the run returned; None if it was cancelled, stopped early or failed.
        keep_draft : bool
            Show what the run found so far in place of the earlier inspection.
        why : str
            Why it failed; "" if it did not.
        """
        if why and self.draft is not None:
            # The stage that follows the last one that brought its part.
            missing = self.draft.stale(self.run_settings)
            self.failure = Failure(min(missing, default=Stage.CRACKS), why)
        self.run_until = self.running_stage = None
        if result is not None:
            self.inspection, self.draft = result, None
        elif keep_draft or self.inspection is None or not self.inspection.complete:
            self.inspection = self.draft
        self.preview_changed.emit(None)
        with self._one_change():
            self._enter(RunState.IDLE)
            self._tell("inspection_changed")

    def _enter(self, state: RunState) -> None:
        if state is not self.run_state:
            self.run_state = state
            self._tell("run_changed")


def _with_layout(settings: Settings, layout: ModuleLayout) -> Settings:
    """Return the settings with a layout, which counts as known."""
    return settings.changed(rows=layout.rows, cols=layout.cols, cell_aspect=layout.cell_aspect)


def best_start(settings: Settings, *candidates: Inspection | None) -> Inspection | None:
    """Return the candidate that leaves the fewest stages to do, None if there is none."""
    known = [candidate for candidate in candidates if candidate is not None]
    return min(known, key=lambda one: len(one.stale(settings)), default=None)
