"""Runs the pipeline in a background thread; its steps arrive in the main thread."""

from __future__ import annotations

from collections.abc import Generator
from dataclasses import dataclass
from typing import Any

from napari.qt.threading import GeneratorWorker
from qtpy.QtCore import QObject, QThreadPool

from napari_pv_inspect.models.workbench import RunState, WorkbenchModel
from napari_pv_inspect.tasks.guard import explained
from pv_inspect import pipeline
from pv_inspect.errors import InspectionError
from pv_inspect.inspection.inspection import Inspection, Step
from pv_inspect.memory import release
from pv_inspect.sequence.sequence import FrameSequence
from pv_inspect.settings import Settings, Stage

__all__ = ["Outcome", "RunController"]


@dataclass(frozen=True)
class Outcome:
    """How a run ended: with an inspection, with a sentence for the user, or stopped on purpose."""

    inspection: Inspection | None = None
    failure: str = ""


def pipeline_steps(
    sequence: FrameSequence, settings: Settings, start: Inspection | None, until: Stage | None
) -> Generator[Step, None, Outcome]:
    """Yield the steps of the pipeline and return an Outcome, whatever happens.

    Parameters
    ----------
    until : Stage, optional
        Stop when this stage has brought its part.
    """
    steps = pipeline.inspect_steps(sequence, settings, start)
    try:
        while True:
            try:
                step = next(steps)
            except StopIteration as end:
                return Outcome(end.value)
            yield step
            if until is not None and _past(step, until):
                return Outcome()
    except Exception as error:
        # A worker that lets a RuntimeError through never reports its end.
        return Outcome(failure=str(explained(error, "The run failed unexpectedly")))
    finally:
        steps.close()


def _past(step: Step, until: Stage) -> bool:
    if step.stage.index > until.index:
        return True
    return step.stage is until and step.partial is not None


@dataclass(frozen=True)
class _NextRun:
    """A run that waits for the current one to end."""

    until: Stage | None
    even_after_failure: bool


class InspectionWorker(GeneratorWorker):  # type: ignore[misc]
    """A worker that closes its generator in its own thread, so that cancelling frees it at once."""

    def work(self) -> Any:
        """Consume the generator until its end or until asked to quit."""
        try:
            return super().work()
        finally:
            self._gen.close()


class RunController(QObject):
    """Starts, cancels and ends runs; one at a time, and one that waits.

    The newest request counts: with changed settings it ends the current run and takes its place,
    else it waits for that run to end and continues from there.

    The signals of a worker are connected to bound methods of this object, which lives in the main
    thread: Qt then delivers them there, and drops them when the object is gone.
    """

    def __init__(self, model: WorkbenchModel) -> None:
        super().__init__()
        self.model = model
        self._worker: InspectionWorker | None = None
        # The run of a sequence that is no longer open; it still has to stop.
        self._stopping: InspectionWorker | None = None
        self._outcome: Outcome | None = None
        self._until: Stage | None = None
        self._waiting: _NextRun | None = None
        model.sequence_changed.connect(self._on_sequence)

    @property
    def waiting(self) -> bool:
        """Whether another run starts when the current one ends."""
        return self._waiting is not None

    def start(self, until: Stage | None = None) -> bool:
        """Start a run with the model's settings, now or when the current one has ended.

        Returns
        -------
        bool
            False if it can't start, or if just this run is under way.
        """
        if self.model.run_state is not RunState.IDLE:
            return self._wait(until)
        try:
            start = self.model.begin_run(until)
        except InspectionError as error:
            self.model.notice(str(error), is_error=True)
            return False
        self._until, self._outcome = until, None
        worker = InspectionWorker(
            pipeline_steps, self.model.sequence, self.model.settings, start, until
        )
        worker.yielded.connect(self._on_step)
        worker.returned.connect(self._on_return)
        worker.finished.connect(self._on_finish)
        self._worker = worker
        if self._stopping is None:
            worker.start()
        else:
            self.model.progress_changed.emit(0.0, "waiting for the run before to stop")
        return True

    def cancel(self) -> None:
        """Ask the run to stop, which it does at its next step; none follows it."""
        self._waiting = None
        self._stop()

    def _stop(self) -> None:
        if self._worker is not None and self.model.run_state is RunState.RUNNING:
            self.model.stopping()
            self._worker.quit()

    def _wait(self, until: Stage | None) -> bool:
        stopping = self.model.run_state is RunState.STOPPING
        if self.model.run_is_outdated:
            self._waiting = _NextRun(until, even_after_failure=True)
            self._stop()
        elif stopping or until != self._until:
            self._waiting = _NextRun(until, even_after_failure=stopping)
            self.model.notice("Another run follows when this one has ended.")
        else:
            self.model.notice("Just this run is under way: change a setting, or cancel it.")
            return False
        return True

    def shutdown(self, wait_ms: int = 3000) -> None:
        """Stop for good: nothing reaches the model any more; wait briefly for the thread."""
        self._abandon()
        worker, self._stopping = self._stopping, None
        if worker is not None:
            worker.finished.disconnect(self._on_finish)
            QThreadPool.globalInstance().waitForDone(wait_ms)

    def _abandon(self) -> None:
        """Ask the run to stop, without waiting: nothing of it reaches the model any more."""
        worker, self._worker = self._worker, None
        self._waiting = self._outcome = None
        if worker is None:
            return
        worker.yielded.disconnect(self._on_step)
        worker.returned.disconnect(self._on_return)
        worker.quit()
        # One that waits for another to stop never began.
        self._stopping = self._stopping or worker

    def _on_sequence(self, _: FrameSequence | None) -> None:
        self._abandon()

    def _on_step(self, step: Step) -> None:
        if self._worker is not None and self._stopping is None:
            self.model.take_step(step)

    def _on_return(self, outcome: Outcome) -> None:
        self._outcome = outcome

    def _on_finish(self) -> None:
        if self._stopping is not None:
            self._stopping = None
            release()
            if self._worker is not None:
                self._worker.start()
            return
        if self._worker is None:
            return
        self._worker = None
        outcome, self._outcome = self._outcome, None
        following, self._waiting = self._waiting, None
        if outcome is None:
            self.model.end_run(None, keep_draft=False)
            shown = self.model.inspection
            whole = shown is not None and shown.complete
            kept = "the last whole result" if whole else "what was found so far"
            self.model.notice(f"Cancelled; {kept} is kept.")
        elif outcome.failure:
            self.model.end_run(None, keep_draft=False, why=outcome.failure)
            self.model.notice(outcome.failure, is_error=True)
            if following is not None and not following.even_after_failure:
                following = None
        else:
            self.model.end_run(outcome.inspection, keep_draft=self._until is not None)
            self.model.notice(_summary(self.model.inspection), is_error=bool(self.model.doubts))
        release()
        if following is not None:
            self.start(following.until)


def _summary(inspection: Inspection | None) -> str:
    if inspection is None:
        return ""
    frames = inspection.registration or inspection.calibration
    used = "" if frames is None else f"{int(frames.used.sum())} of {len(frames.used)} frames used"
    if inspection.complete:
        seconds = f"{sum(inspection.seconds.values()):.0f} s"
        if inspection.doubts:
            more = len(inspection.doubts) - 1
            return f"In doubt: {inspection.doubts[0]}" + (f" ({more} more below)" if more else "")
        return f"Done: {used}, {seconds}."
    return f"Grid fitted: {used}."
