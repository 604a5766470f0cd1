"""All that is known about one sequence, and the events of a run that makes it."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import Field, dataclass, field, fields, replace
from functools import cache
from pathlib import Path
from typing import Any, TypeVar, get_args, get_type_hints

import numpy as np
from numpy.typing import NDArray

from pv_inspect.calibration.calibrate import Calibration
from pv_inspect.cells import CellTiles
from pv_inspect.cracks import CrackMap
from pv_inspect.detection.crossings import Crossings
from pv_inspect.errors import InspectionError
from pv_inspect.geometry.layout import ModuleLayout
from pv_inspect.inspection.stored import StoredResult
from pv_inspect.reconstruction.reconstruction import Reconstruction
from pv_inspect.registration.registration import Registration
from pv_inspect.sequence.sequence import FrameSequence
from pv_inspect.settings import Settings, Stage

__all__ = ["Inspection", "Part", "Step", "stages"]

Part = Crossings | Calibration | Registration | Reconstruction | CellTiles | CrackMap
P = TypeVar("P", Crossings, Calibration, Registration, Reconstruction, CellTiles, CrackMap)


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
    partial: Part | NDArray[np.float32] | None = None


@dataclass(frozen=True, eq=False)
class Inspection:
    """All that is known about one sequence; parts of stages that have not run are None.

    Parameters
    ----------
    sequence : FrameSequence or None
        None: what was read from a result folder, without its frames; see `frames`.
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
    runner_up : ModuleLayout or None
        A layout that fits the frames nearly as well as the guessed one.
    gaps_found : bool
        Whether the wide gaps of the layout were seen in the frames; nobody gave them.
    doubts : tuple of str
        Why the result must not be relied on, one sentence each; empty if there is no doubt.
    stored : StoredResult or None
        What it was read from; None if no result folder was.
    """

    sequence: FrameSequence | None
    settings: Settings
    layout: ModuleLayout
    crossings: Crossings | None = field(default=None, metadata={"stage": Stage.DETECT})
    calibration: Calibration | None = field(default=None, metadata={"stage": Stage.CALIBRATE})
    registration: Registration | None = field(default=None, metadata={"stage": Stage.REGISTER})
    reconstruction: Reconstruction | None = field(
        default=None, metadata={"stage": Stage.RECONSTRUCT}
    )
    tiles: CellTiles | None = field(default=None, metadata={"stage": Stage.CELLS})
    cracks: CrackMap | None = field(default=None, metadata={"stage": Stage.CRACKS})
    seconds: dict[str, float] = field(default_factory=dict)
    warnings: tuple[str, ...] = ()
    layout_guessed: bool = False
    runner_up: ModuleLayout | None = None
    gaps_found: bool = False
    doubts: tuple[str, ...] = ()
    stored: StoredResult | None = None

    def __post_init__(self) -> None:
        if self.sequence is None and self.stored is None:
            raise ValueError("an inspection is of a sequence, or was read from a result folder")

    @property
    def frames(self) -> FrameSequence:
        """The open frames.

        Raises
        ------
        InspectionError
            If it was read from a result folder without them.
        """
        if self.sequence is None:
            raise InspectionError(
                f"The frames of {self.source} are not open: open the sequence for what needs them."
            )
        return self.sequence

    @property
    def names(self) -> tuple[str, ...]:
        """File names of the frames."""
        if self.sequence is not None:
            return self.sequence.names
        assert self.stored is not None
        return self.stored.names

    @property
    def source(self) -> Path:
        """Where the frames lie; the result folder, if they are not open."""
        if self.sequence is not None:
            return self.sequence.source
        assert self.stored is not None
        return self.stored.folder

    @property
    def complete(self) -> bool:
        """Whether every stage has run."""
        return all(self.part(stage) is not None for stage in stages())

    def part(self, stage: Stage) -> Part | None:
        """Return what a stage has made, None if it has not run.

        Parameters
        ----------
        stage : Stage
            One of `stages`: loading makes no part.
        """
        made: Part | None = getattr(self, _fields()[stage].name)
        return made

    def need(self, kind: type[P]) -> P:
        """Return a part that has to be there.

        Parameters
        ----------
        kind : type
            `Crossings`, `Calibration`, `Registration`, `Reconstruction`, `CellTiles` or `CrackMap`.

        Raises
        ------
        InspectionError
            If its stage has not run.
        """
        stage = _stage_of(kind)
        made = self.part(stage)
        if not isinstance(made, kind):
            raise InspectionError(
                f"This inspection is not complete: run it at least to the end of the stage "
                f"{stage.value!r}."
            )
        return made

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
        missing = [stage for stage in stages() if self.part(stage) is None]
        start = min([*missing, *([first] if first else [])], default=None)
        return frozenset(stage for stage in Stage if start is not None and stage >= start)

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
        stage = _stage_of(type(part))
        later = {s for s in stages() if s > stage}
        return self._changed(later, **{_fields()[stage].name: part})

    def under(self, settings: Settings) -> Inspection:
        """Return what of this is still true under other settings.

        Parameters
        ----------
        settings : Settings

        Returns
        -------
        Inspection
        """
        stale = self.stale(settings)
        return (
            self._changed(stale, settings=settings) if stale else replace(self, settings=settings)
        )

    def _changed(self, dropped: Collection[Stage], **changes: Any) -> Inspection:
        """Return a copy without the parts of some stages, and the seconds that they took."""
        emptied = {_fields()[stage].name: None for stage in dropped if stage in _fields()}
        seconds = {k: v for k, v in self.seconds.items() if Stage(k) not in dropped}
        # What was said about the whole result is not true of this one, nor is it what was read.
        stored = self.stored if self.sequence is None else None
        said: dict[str, Any] = {"warnings": (), "doubts": (), "stored": stored}
        return replace(self, **{"seconds": seconds, **said, **emptied, **changes})

    def __repr__(self) -> str:
        done = [stage.value for stage in stages() if self.part(stage) is not None]
        cells = f"{self.layout.rows} x {self.layout.cols} cells"
        where = str(self.source)
        return f"<Inspection of {where!r}: {cells}; done: {', '.join(done) or 'nothing'}>"

    def _repr_html_(self) -> str:
        from pv_inspect.notebook.display import inspection_html

        return inspection_html(self)


@cache
def _fields() -> dict[Stage, Field[Any]]:
    """Return the field that each stage fills, in the order of the stages."""
    made = {f.metadata["stage"]: f for f in fields(Inspection) if "stage" in f.metadata}
    return {stage: made[stage] for stage in sorted(made)}


def stages() -> tuple[Stage, ...]:
    """Return the stages that make a part of an inspection, in their order."""
    return tuple(_fields())


def _stage_of(part: type) -> Stage:
    hints = get_type_hints(Inspection)
    for stage, made in _fields().items():
        if part in get_args(hints[made.name]):
            return stage
    raise TypeError(f"{part.__name__} is no part of an inspection")
