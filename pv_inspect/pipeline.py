"""The stages of the method in their order (paper, Fig. 2).

The command line, the workbench, a notebook and a batch all drive `inspect_steps`: progress is a
yield, a preview is ``Step.partial``, cancelling is closing the generator. `inspect` drives it to
its end.
"""

from __future__ import annotations

from collections.abc import Callable, Generator
from dataclasses import dataclass, replace
from time import perf_counter
from typing import Any, Generic, NamedTuple, TypeVar

import numpy as np

from pv_inspect.calibration.calibrate import Calibration, calibrate
from pv_inspect.cells import CellTiles, cut_cells
from pv_inspect.common.parallel import one_at_a_time
from pv_inspect.common.solver_errors import explained_errors
from pv_inspect.common.work import Progress, result_of
from pv_inspect.cracks import CrackMap, read_cracks
from pv_inspect.detection.crossings import Crossings
from pv_inspect.detection.detect import detect
from pv_inspect.detection.layout_guess import LayoutGuess, guess_layout, is_known
from pv_inspect.detection.wide_gaps import layout_with_gaps
from pv_inspect.errors import InspectionError
from pv_inspect.geometry.layout import ModuleLayout
from pv_inspect.inspection.doubts import doubts_of, warnings_of
from pv_inspect.inspection.inspection import Inspection, Part, Step, stages
from pv_inspect.memory import need_memory, release
from pv_inspect.progress.follow import follow
from pv_inspect.progress.notebook_bar import in_notebook
from pv_inspect.reconstruction.reconstruct import reconstruct
from pv_inspect.reconstruction.reconstruction import Reconstruction
from pv_inspect.registration.homography import register_by_homography
from pv_inspect.registration.plane_check import check_plane
from pv_inspect.registration.register import register
from pv_inspect.registration.registration import Registration
from pv_inspect.sequence.sequence import FrameSequence
from pv_inspect.settings import Settings, Stage

__all__ = ["inspect", "inspect_steps"]

P = TypeVar("P")


def inspect(
    sequence: FrameSequence,
    settings: Settings | None = None,
    start: Inspection | None = None,
    *,
    progress: bool | None = None,
) -> Inspection:
    """Run the whole method on one sequence (paper, Fig. 2) and return the result.

    Parameters
    ----------
    sequence : FrameSequence
    settings : Settings, optional
        The defaults if not given.
    start : Inspection, optional
        An earlier, possibly partial result of the same `FrameSequence` object: what the settings do
        not make stale is taken over instead of computed.
    progress : bool, optional
        Show a bar in the terminal or the notebook; by default in a notebook only.

    Returns
    -------
    Inspection
        Complete.

    Raises
    ------
    InspectionError
        If the layout is unknown and can't be guessed, or no frame can be used.

    See Also
    --------
    inspect_steps : The same, step by step, for programs that show progress or cancel.
    """
    steps = inspect_steps(sequence, settings, start)
    shown = in_notebook() if progress is None else progress
    return follow(steps) if shown else result_of(steps)


def inspect_steps(
    sequence: FrameSequence, settings: Settings | None = None, start: Inspection | None = None
) -> Generator[Step, None, Inspection]:
    """Do what `inspect` does, step by step: see there for parameters and errors.

    Yields
    ------
    Step
        What is going on. Closing the generator cancels the run.

    Returns
    -------
    Inspection
        Complete.
    """
    settings = settings if settings is not None else Settings()
    _check_lock_in(sequence, settings)
    begun = perf_counter()
    kept = start if start is not None and start.sequence is sequence else None
    with explained_errors(Stage.DETECT.value):
        known = _layout(sequence, settings, kept)
    fresh = Inspection(sequence, settings, known.layout)
    state = replace(
        fresh if kept is None else kept.under(settings),
        layout=known.layout,
        layout_guessed=known.guessed,
        gaps_found=known.gaps_found,
        runner_up=known.runner_up,
    )
    todo = [stage for stage in stages() if stage in state.stale(settings)]
    seconds = dict(state.seconds)
    seconds.setdefault(Stage.LOAD.value, perf_counter() - begun)
    total = sum(_WORK[stage].share for stage in todo) or 1.0
    done = 0.0
    yield Step(
        Stage.LOAD, 0.0, f"{len(sequence)} frames of {sequence.shape[1]} x {sequence.shape[0]}"
    )
    for stage in todo:
        share = _WORK[stage].share
        work = _WORK[stage].run(state)
        spent = 0.0
        try:
            while True:
                begun = perf_counter()
                try:
                    with one_at_a_time(), explained_errors(stage.value):
                        event = next(work)
                except StopIteration as end:
                    part: Part = end.value
                    release()
                    spent += perf_counter() - begun
                    break
                spent += perf_counter() - begun
                fraction = done + share * min(max(event.fraction, 0.0), 1.0)
                yield Step(stage, fraction / total, event.message, event.image)
        finally:
            work.close()
        state = state.with_part(part)
        seconds[stage.value] = spent
        state = replace(state, seconds=dict(seconds))
        done += share
        yield Step(stage, min(done / total, 1.0), _WORK[stage].summary(part), part)
    state = replace(state, seconds=seconds)
    return replace(state, warnings=warnings_of(state), doubts=doubts_of(state))


def _check_lock_in(sequence: FrameSequence, settings: Settings) -> None:
    """Refuse frames that were opened in another way than the settings want them."""
    if settings.lock_in not in (None, sequence.lock_in is not None):
        raise InspectionError(
            f"The settings want lock_in = {settings.lock_in}, but the frames were opened without "
            "that: give it to open_sequence as well."
        )


class _Known(NamedTuple):
    """The layout of a run: whether it was guessed, and whether its wide gaps were seen."""

    layout: ModuleLayout
    guessed: bool
    gaps_found: bool
    runner_up: ModuleLayout | None = None


def _layout(sequence: FrameSequence, settings: Settings, start: Inspection | None) -> _Known:
    """Return the layout that was given, or else guessed, with the wide gaps that frames show."""
    if start is not None and Stage.DETECT not in start.stale(settings):
        return _Known(start.layout, start.layout_guessed, start.gaps_found, start.runner_up)
    guess: LayoutGuess | None = None
    if not is_known(sequence, settings):
        if sequence.says_sizes(settings):
            raise InspectionError(
                "Widths of single rows or columns are given, but not how many there are: give "
                "--rows and --cols as well."
            )
        guess = guess_layout(sequence, settings, settings.module_at)
    layout = sequence.layout(settings) if guess is None else guess.layout
    runner_up = None if guess is None else guess.runner_up
    if sequence.says_gaps(settings) or layout.row_heights or layout.col_widths:
        return _Known(layout, guess is not None, False, runner_up)
    wide = layout_with_gaps(sequence, layout, settings.module_at)
    return _Known(wide, guess is not None, wide != layout.plain, runner_up)


def _detect(state: Inspection) -> Generator[Progress, None, Crossings]:
    sequence, settings = state.frames, state.settings
    frame = sequence.frame(sequence.measured[0]).image
    need_memory(frame, len(sequence), state.layout, settings.magnification)
    return (yield from detect(sequence, state.layout, settings.module_at))


def _calibrate(state: Inspection) -> Generator[Progress, None, Calibration]:
    crossings = state.need(Crossings)
    _need_a_frame(state.frames, [frame.why for frame in crossings.frames], state.layout)
    yield Progress(0.0, "fitting the camera and the poses")
    return calibrate(crossings, state.frames.shape, state.settings)


def _register(state: Inspection) -> Generator[Progress, None, Registration]:
    sequence, settings = state.frames, state.settings
    calibration = state.need(Calibration)
    _need_a_frame(sequence, _reasons(calibration), state.layout)
    if settings.registration_model == "homography":
        # Without a lens lines are bent whatever the layout is: nothing to compare it with.
        crossings = state.need(Crossings)
        return (yield from register_by_homography(sequence, crossings, settings, calibration))
    registration = yield from register(sequence, calibration, settings)
    return replace(registration, misfit=check_plane(sequence, registration))


def _reconstruct(state: Inspection) -> Generator[Progress, None, Reconstruction]:
    registration = state.need(Registration)
    _need_a_frame(state.frames, _reasons(registration), state.layout)
    return (yield from reconstruct(state.frames, registration, state.settings))


def _cut(state: Inspection) -> Generator[Progress, None, CellTiles]:
    yield Progress(0.0, "cutting the module into cells")
    return cut_cells(state.need(Reconstruction))


def _read_cracks(state: Inspection) -> Generator[Progress, None, CrackMap]:
    return (yield from read_cracks(state.need(CellTiles), state.settings))


def _reasons(poses: Calibration | Registration) -> list[str]:
    """Reason per frame; "" for the used ones."""
    pairs = zip(poses.used, poses.why, strict=True)
    return ["" if used else why or "not used" for used, why in pairs]


def _need_a_frame(sequence: FrameSequence, reasons: list[str], layout: ModuleLayout) -> None:
    if "" in reasons:
        return
    first = reasons[0].rstrip(".")
    which = "the frame" if len(reasons) == 1 else f"any of the {len(reasons)} frames"
    raise InspectionError(
        f"No module of {layout.rows} x {layout.cols} cells (rows x columns) could be found in "
        f"{which} ({sequence.names[0]}: {first}): check rows and cols, and that the frames show "
        "one whole module."
    )


def _crossings_found(crossings: Crossings) -> str:
    good = sum(not frame.why for frame in crossings.frames)
    return f"module found in {good} of {len(crossings.frames)} frames"


def _camera_fitted(calibration: Calibration) -> str:
    rms = np.median(calibration.rms_px[calibration.used]) if calibration.used.any() else np.nan
    kappa = f"preliminary kappa {calibration.camera.kappa:+.4f}"
    return f"camera fitted, {kappa}, crossing points {rms:.2f} px from the grid"


def _frames_registered(registration: Registration) -> str:
    return f"{int(registration.used.sum())} of {len(registration.used)} frames registered"


def _image_made(reconstruction: Reconstruction) -> str:
    height, width = reconstruction.image.shape
    return f"module image of {width} x {height} pixels"


def _cells_cut(tiles: CellTiles) -> str:
    return f"{len(tiles.places)} cells cut"


def _cracks_read(cracks: CrackMap) -> str:
    return cracks.counts.text


@dataclass(frozen=True)
class _Work(Generic[P]):
    """What a stage does: the share of a run that it takes, its work, and what to say at its end.

    Which field of `Inspection` it fills is declared there.
    """

    share: float
    run: Callable[[Inspection], Generator[Progress, None, P]]
    summary: Callable[[P], str]


_WORK: dict[Stage, _Work[Any]] = {
    Stage.DETECT: _Work(0.15, _detect, _crossings_found),
    Stage.CALIBRATE: _Work(0.02, _calibrate, _camera_fitted),
    Stage.REGISTER: _Work(0.25, _register, _frames_registered),
    Stage.RECONSTRUCT: _Work(0.5, _reconstruct, _image_made),
    Stage.CELLS: _Work(0.005, _cut, _cells_cut),
    Stage.CRACKS: _Work(0.075, _read_cracks, _cracks_read),
}
"""The shares were read off runs of the sample at 3x."""
