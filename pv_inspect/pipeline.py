"""The stages of the method in their order, as one generator of Step events.

The command line, the workbench, a notebook and a batch all drive `inspect`: progress is a yield,
a preview is ``Step.partial``, cancelling is closing the generator.
"""

from __future__ import annotations

from collections.abc import Generator
from dataclasses import dataclass, field, replace
from time import perf_counter
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np

from pv_inspect.calibration.calibrate import Calibration, calibrate
from pv_inspect.cells import CellTiles, cut_cells
from pv_inspect.common.parallel import in_turn
from pv_inspect.common.solver_errors import in_words
from pv_inspect.common.work import relayed, result_of
from pv_inspect.cracks import CrackMap, read_cracks
from pv_inspect.detection.crossings import Crossings
from pv_inspect.detection.detect import detect
from pv_inspect.detection.layout_guess import guess_layout, is_known
from pv_inspect.doubts import doubts_of, warnings_of
from pv_inspect.errors import InspectionError
from pv_inspect.geometry.layout import ModuleLayout
from pv_inspect.memory import need_memory, release
from pv_inspect.notebook.progress_bar import in_notebook
from pv_inspect.reconstruction.reconstruct import Reconstruction, reconstruct
from pv_inspect.registration.homography import register_by_homography
from pv_inspect.registration.register import Registration, register
from pv_inspect.sequence.sequence import Sequence
from pv_inspect.settings import Settings, Stage

if TYPE_CHECKING:
    from matplotlib.axes import Axes

__all__ = ["Inspection", "Step", "inspect", "run_to_end"]

Part = Crossings | Calibration | Registration | Reconstruction | CellTiles | CrackMap
T = TypeVar("T")

# The field of Inspection that a stage fills, and roughly what share of a run it takes.
_FIELD: dict[Stage, str] = {
    Stage.DETECT: "crossings",
    Stage.CALIBRATE: "calibration",
    Stage.REGISTER: "registration",
    Stage.RECONSTRUCT: "reconstruction",
    Stage.CELLS: "tiles",
    Stage.CRACKS: "cracks",
}
_WEIGHT: dict[Stage, float] = {
    Stage.DETECT: 0.15,
    Stage.CALIBRATE: 0.02,
    Stage.REGISTER: 0.25,
    Stage.RECONSTRUCT: 0.5,
    Stage.CELLS: 0.005,
    Stage.CRACKS: 0.075,
}
_STAGE_OF_PART: dict[type, Stage] = {
    Crossings: Stage.DETECT,
    Calibration: Stage.CALIBRATE,
    Registration: Stage.REGISTER,
    Reconstruction: Stage.RECONSTRUCT,
    CellTiles: Stage.CELLS,
    CrackMap: Stage.CRACKS,
}


@dataclass(frozen=True, eq=False)
class Step:
    """One event of a run.

    Parameters
    ----------
    stage : Stage
        The stage that is working.
    fraction : float
        Share of the whole run that is done, 0 to 1; never falls.
    message : str
        What is being done, for a person.
    partial : object or None
        What a stage has made, in the step that ends it (`Crossings`, `Calibration`,
        `Registration`, `Reconstruction`, `CellTiles`, `CrackMap`); during the reconstruction at
        times the (H, W) float32 image so far, full scale = 1.
    """

    stage: Stage
    fraction: float
    message: str
    partial: object | None = None


@dataclass(frozen=True, eq=False)
class Inspection:
    """All that is known about one sequence; parts of stages that have not run are None.

    Parameters
    ----------
    sequence : Sequence
    settings : Settings
        The settings that all present parts were made with.
    layout : ModuleLayout
    crossings, calibration, registration, reconstruction, tiles, cracks
        What the stages have made.
    seconds : dict of str to float
        Wall time of every stage that ran, without the time in which the caller of the generator
        held it; reused parts keep the seconds of the run that made them.
    warnings : tuple of str
        What a user should know about the result, one sentence each.
    layout_guessed : bool
        Whether rows and columns were guessed from the frames because nobody gave them.
    doubts : tuple of str
        Why the result must not be relied on, one sentence each; empty if there is no doubt.
    """

    sequence: Sequence
    settings: Settings
    layout: ModuleLayout
    crossings: Crossings | None = None
    calibration: Calibration | None = None
    registration: Registration | None = None
    reconstruction: Reconstruction | None = None
    tiles: CellTiles | None = None
    cracks: CrackMap | None = None
    seconds: dict[str, float] = field(default_factory=dict)
    warnings: tuple[str, ...] = ()
    layout_guessed: bool = False
    doubts: tuple[str, ...] = ()

    @property
    def complete(self) -> bool:
        """Whether every stage has run."""
        return all(getattr(self, name) is not None for name in _FIELD.values())

    def stale(self, settings: Settings) -> frozenset[Stage]:
        """Return the stages that have to run (again) for these settings.

        Parameters
        ----------
        settings : Settings
            The settings wanted now.

        Returns
        -------
        frozenset of Stage
            Every stage from the first that the change touches, or that has not run.
        """
        first = self.settings.first_stale_stage(settings)
        missing = [stage for stage, name in _FIELD.items() if getattr(self, name) is None]
        start = min([*missing, *([first] if first else [])], key=_position, default=None)
        return frozenset(stage for stage in Stage if start and stage.index >= start.index)

    def with_part(self, part: Part) -> Inspection:
        """Return a copy with one part put in and all that was made from its predecessor dropped.

        This is how a caller keeps what a cancelled run has made (``Step.partial``), or enters
        with own crossing points, a known camera or a finished registration.

        Parameters
        ----------
        part : Crossings, Calibration, Registration, Reconstruction, CellTiles or CrackMap

        Returns
        -------
        Inspection
        """
        stage = _STAGE_OF_PART[type(part)]
        later = [s for s in _FIELD if s.index > stage.index]
        seconds = {k: v for k, v in self.seconds.items() if k not in {s.value for s in later}}
        emptied = dict.fromkeys((_FIELD[s] for s in later), None)
        # What was said about the whole result is not true of this one.
        said: dict[str, Any] = {"seconds": seconds, "warnings": (), "doubts": ()}
        # `replace` can't know which type belongs to which field; _STAGE_OF_PART does.
        return replace(self, **said, **{**emptied, _FIELD[stage]: part})  # type: ignore[arg-type]

    def plot_grid(self, frame: int | None = None, ax: Axes | None = None) -> Axes:
        """Plot a frame with its crossing points and the fitted grid; see `plotting`."""
        from pv_inspect.notebook.plots import plot_grid

        return plot_grid(self, frame, ax)

    def plot_cells(self, ax: Axes | None = None) -> Axes:
        """Plot the cells of the module with their cracks; see `plotting`."""
        from pv_inspect.notebook.plots import plot_cells

        return plot_cells(self, ax)

    def plot_residuals(self, ax: Axes | None = None) -> Axes:
        """Plot the residual of every frame; see `plotting`."""
        from pv_inspect.notebook.plots import plot_residuals

        return plot_residuals(self, ax)

    def __repr__(self) -> str:
        done = [stage.value for stage, name in _FIELD.items() if getattr(self, name) is not None]
        cells = f"{self.layout.rows} x {self.layout.cols} cells"
        where = str(self.sequence.source)
        return f"<Inspection of {where!r}: {cells}; done: {', '.join(done) or 'nothing'}>"

    def _repr_html_(self) -> str:
        from pv_inspect.notebook.display import inspection_html

        return inspection_html(self)

    def _only(self, settings: Settings) -> Inspection:
        """Return what of this is still true under other settings."""
        stale = self.stale(settings)
        emptied = {_FIELD[stage]: None for stage in stale if stage in _FIELD}
        seconds = {k: v for k, v in self.seconds.items() if Stage(k) not in stale}
        kept: Inspection = replace(self, settings=settings, seconds=seconds, **emptied)  # type: ignore[arg-type]
        return replace(kept, warnings=(), doubts=()) if emptied else kept


def _position(stage: Stage) -> int:
    return stage.index


def inspect(
    sequence: Sequence, settings: Settings | None = None, start: Inspection | None = None
) -> Generator[Step, None, Inspection]:
    """Run the whole method on one sequence (paper, Fig. 2).

    Parameters
    ----------
    sequence : Sequence
    settings : Settings, optional
        The defaults if not given.
    start : Inspection, optional
        An earlier, possibly partial result of the same `Sequence` object: what the settings do
        not make stale is taken over instead of computed.

    Yields
    ------
    Step
        What is going on. Closing the generator cancels the run.

    Returns
    -------
    Inspection
        Complete.

    Raises
    ------
    InspectionError
        If the layout is unknown and can't be guessed, or no frame can be used.
    """
    settings = settings if settings is not None else Settings()
    begun = perf_counter()
    kept = start if start is not None and start.sequence is sequence else None
    with in_words(Stage.DETECT.value):
        layout, guessed = _layout(sequence, settings, kept)
    if kept is None:
        state = Inspection(sequence, settings, layout, layout_guessed=guessed)
    else:
        state = replace(kept._only(settings), layout=layout, layout_guessed=guessed)
    todo = [stage for stage in _FIELD if stage in state.stale(settings)]
    seconds = dict(state.seconds)
    seconds.setdefault(Stage.LOAD.value, perf_counter() - begun)
    total = sum(_WEIGHT[stage] for stage in todo) or 1.0
    done = 0.0
    yield Step(
        Stage.LOAD, 0.0, f"{len(sequence)} frames of {sequence.shape[1]} x {sequence.shape[0]}"
    )
    for stage in todo:
        work = _run_stage(stage, state)
        spent = 0.0
        try:
            while True:
                begun = perf_counter()
                try:
                    with in_turn(), in_words(stage.value):
                        inner, message, preview = next(work)
                except StopIteration as end:
                    part: Part = end.value
                    release()
                    spent += perf_counter() - begun
                    break
                spent += perf_counter() - begun
                share = done + _WEIGHT[stage] * min(max(inner, 0.0), 1.0)
                yield Step(stage, share / total, message, preview)
        finally:
            work.close()
        state = state.with_part(part)
        seconds[stage.value] = spent
        state = replace(state, seconds=dict(seconds))
        done += _WEIGHT[stage]
        yield Step(stage, min(done / total, 1.0), _ended(stage, state), part)
    state = replace(state, seconds=seconds)
    return replace(state, warnings=warnings_of(state), doubts=doubts_of(state))


def run_to_end(steps: Generator[Step, None, Inspection]) -> Inspection:
    """Drive `inspect` to its end and return the result; in a notebook with a progress bar.

    Parameters
    ----------
    steps : generator
        What `inspect` returned.

    Returns
    -------
    Inspection
    """
    if in_notebook():
        from pv_inspect.progress import follow

        return follow(steps)
    return result_of(steps)


def _layout(
    sequence: Sequence, settings: Settings, start: Inspection | None
) -> tuple[ModuleLayout, bool]:
    """Return the layout that was given, or else guessed, and whether it was guessed."""
    if is_known(sequence, settings):
        return sequence.layout(settings), False
    if start is not None and Stage.DETECT not in start.stale(settings):
        return start.layout, start.layout_guessed
    return guess_layout(sequence, settings, settings.module_at).layout, True


_Event = tuple[float, str, object | None]


def _run_stage(stage: Stage, state: Inspection) -> Generator[_Event, None, Part]:
    """Run one stage; yields (fraction of the stage, message, preview)."""
    sequence, settings = state.sequence, state.settings
    if stage is Stage.DETECT:
        frame = sequence.frame(0).image
        need_memory(frame, len(sequence), state.layout, settings.magnification)
        steps = detect(sequence, state.layout, settings.module_at)
        return (yield from _told(steps, "looking for the cell crossings"))
    if stage is Stage.CALIBRATE:
        crossings = _present(state.crossings)
        _need_a_frame(sequence, [frame.why for frame in crossings.frames], state.layout)
        yield 0.0, "fitting the camera and the poses", None
        return calibrate(crossings, sequence.shape, settings)
    if stage is Stage.REGISTER:
        calibration = _present(state.calibration)
        _need_a_frame(sequence, _reasons(calibration), state.layout)
        if settings.registration_model == "homography":
            crossings = _present(state.crossings)
            poses = register_by_homography(sequence, crossings, settings, calibration)
        else:
            poses = register(sequence, calibration, settings)
        return (yield from _told(poses, "registering the frames against the module"))
    if stage is Stage.RECONSTRUCT:
        registration = _present(state.registration)
        _need_a_frame(sequence, _reasons(registration), state.layout)
        return (
            yield from relayed(
                reconstruct(sequence, registration, settings),
                lambda progress: (progress.fraction, progress.message, progress.image),
            )
        )
    if stage is Stage.CELLS:
        yield 0.0, "cutting the module into cells", None
        return cut_cells(_present(state.reconstruction))
    tiles = _present(state.tiles)
    return (yield from _told(read_cracks(tiles, settings), "looking for cracks"))


def _told(work: Generator[float, None, T], message: str) -> Generator[_Event, None, T]:
    """Turn the bare fractions of a stage into events with a message."""
    return (yield from relayed(work, lambda fraction: (fraction, message, None)))


def _present(part: T | None) -> T:
    assert part is not None, "stages run in their order"
    return part


def _reasons(poses: Calibration | Registration) -> list[str]:
    """Reason per frame; "" for the used ones."""
    pairs = zip(poses.used, poses.why, strict=True)
    return ["" if used else why or "not used" for used, why in pairs]


def _need_a_frame(sequence: Sequence, reasons: list[str], layout: ModuleLayout) -> None:
    if "" in reasons:
        return
    first = reasons[0].rstrip(".")
    which = "the frame" if len(reasons) == 1 else f"any of the {len(reasons)} frames"
    raise InspectionError(
        f"No module of {layout.rows} x {layout.cols} cells (rows x columns) could be found in "
        f"{which} ({sequence.names[0]}: {first}): check rows and cols, and that the frames show "
        "one whole module."
    )


def _ended(stage: Stage, state: Inspection) -> str:
    """What a stage has come to, for a person."""
    if stage is Stage.DETECT:
        frames = _present(state.crossings).frames
        good = sum(not frame.why for frame in frames)
        return f"module found in {good} of {len(frames)} frames"
    if stage is Stage.CALIBRATE:
        calibration = _present(state.calibration)
        rms = np.median(calibration.rms_px[calibration.used]) if calibration.used.any() else np.nan
        kappa = f"preliminary kappa {calibration.camera.kappa:+.4f}"
        return f"camera fitted, {kappa}, crossing points {rms:.2f} px from the grid"
    if stage is Stage.REGISTER:
        registration = _present(state.registration)
        return f"{int(registration.used.sum())} of {len(registration.used)} frames registered"
    if stage is Stage.RECONSTRUCT:
        height, width = _present(state.reconstruction).image.shape
        return f"module image of {width} x {height} pixels"
    if stage is Stage.CELLS:
        return f"{state.layout.rows * state.layout.cols} cells cut"
    return _present(state.cracks).counts.text
