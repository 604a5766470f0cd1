"""Making the images of a comparison: every finished cell is on the disk, and a rerun goes on."""

from __future__ import annotations

import hashlib
import json
import os
import shutil
from collections.abc import Generator
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path

import numpy as np
import tifffile
from numpy.typing import NDArray

from pv_inspect.common.records import Number, Record, Text, checked, json_from, read_text
from pv_inspect.common.versions import versions
from pv_inspect.common.work import Progress, forwarded
from pv_inspect.errors import InspectionError
from pv_inspect.evaluation.case import Case, Cell, prepared, sampled_cells
from pv_inspect.evaluation.grid_record import GridRecord
from pv_inspect.evaluation.methods import Method
from pv_inspect.sequence.sequence import FrameSequence
from pv_inspect.settings import Settings
from pv_inspect.storage.folders import replace_file

__all__ = ["CASE_FILE", "ComparedSequence", "MethodRecord", "Plan", "compared"]

Image = NDArray[np.float32]

CASE_FILE = "case.json"
_METHOD_FILE = "method.json"
# All frames, and each half of them.
_HALVES = (None, 0, 1)


@dataclass(frozen=True)
class Plan:
    """What is compared.

    Parameters
    ----------
    sequence : Path
        Folder or file of frames.
    settings : Settings
        Of the geometry and of our own method; ``magnification`` is that of the grid.
    methods : tuple of Method
    n_cells : int
        Cells that are drawn; the same for all methods.
    seed : int
        Of the draw.
    halves : bool
        Make the images a second and third time, of every second frame.
    """

    sequence: Path
    settings: Settings
    methods: tuple[Method, ...]
    n_cells: int
    seed: int
    halves: bool = False

    @property
    def name(self) -> str:
        """Name of the sequence."""
        return self.sequence.resolve().stem

    @property
    def folder(self) -> str:
        """Name of the folder of its images, relative to that of the comparison."""
        return f"{self.name}/{self.settings.magnification:g}x"


class MethodRecord(Record):
    """How a method has done on one sequence, as it is stored beside its images.

    Attributes
    ----------
    key : str
        Hash of all that its images depend on.
    note : str
        What it is.
    cpu_s : float
        CPU time of the cells that are there.
    failed : str
        Why it has none; empty if it has.
    """

    key: Text
    note: Text
    cpu_s: Number
    failed: Text = ""


class _CaseRecord(Record):
    key: Text
    grid: GridRecord


@dataclass(frozen=True, eq=False)
class ComparedSequence:
    """The images of one sequence at one magnification.

    Parameters
    ----------
    plan : Plan
    grid : GridRecord
    images : dict of str to dict of (row, col) to (h, w) float32
        By name of the method; empty if it failed.
    records : dict of str to MethodRecord
    halves : dict of str to two dicts as in ``images``
        Images of every second frame and of the others; empty if they were not wanted.
    """

    plan: Plan
    grid: GridRecord
    images: dict[str, dict[Cell, Image]]
    records: dict[str, MethodRecord]
    halves: dict[str, tuple[dict[Cell, Image], dict[Cell, Image]]]


def compared(plan: Plan, out: Path) -> Generator[Progress, None, ComparedSequence]:
    """Make the images that are not there yet, and read all of them.

    Parameters
    ----------
    plan : Plan
    out : Path
        Folder of the comparison; what other frames, settings or versions have left in the place of
        these images is replaced.

    Yields
    ------
    Progress
        Closing the generator cancels; finished cells stay.

    Returns
    -------
    ComparedSequence

    Raises
    ------
    InspectionError
        If the frames can't be used or the folder can't be written. A method that can't be used is
        no error: its record says why.
    """
    settings = plan.settings
    yield Progress(0.0, f"{plan.name}: opening the frames")
    sequence = FrameSequence.open(plan.sequence, limits=settings.read_limits)
    key = _key(_digest(sequence), settings.model_dump_json(), f"{plan.n_cells}, {plan.seed}")
    folder = out / plan.folder
    case: Case | None = None
    grid = _stored_grid(folder, key)
    work = [(method, half) for method in plan.methods for half in _HALVES[: 1 + 2 * plan.halves]]
    share = 1.0 / (len(work) + 1)
    if grid is None:
        case = yield from _with_geometry(plan, sequence, share)
        grid = GridRecord.of(case, sampled_cells(case.grid.layout, plan.n_cells, plan.seed))
        folder.mkdir(parents=True, exist_ok=True)
        record = _CaseRecord(key=key, grid=grid)
        replace_file(folder / CASE_FILE, record.model_dump_json(indent=1).encode())
    found: dict[tuple[str, int | None], tuple[MethodRecord, dict[Cell, Image]]] = {}
    for k, (method, half) in enumerate(work, start=1):
        place = folder / (method.name if half is None else f"{method.name}_half_{half + 1}")
        own = _key(key, method.name, method.note, f"{half}")
        done = _finished(place, own, grid)
        if done is None or done[0].failed:
            if case is None:
                case = yield from _with_geometry(plan, sequence, 0.0)
            told = f"{plan.name} {settings.magnification:g}x, {place.name}"
            making = _make(method, case, half, grid, place, own)

            def part(step: Progress, k: int = k, told: str = told) -> Progress:
                return Progress(share * (k + step.fraction), f"{told}: {step.message}")

            yield from forwarded(making, part)
            done = _finished(place, own, grid)
        if done is None:
            raise InspectionError(
                f"The images of {place.name} in {place} were changed while they were made: start "
                "the comparison again."
            )
        found[method.name, half] = done
    return ComparedSequence(
        plan,
        grid,
        {name: images for (name, half), (_, images) in found.items() if half is None},
        {name: record for (name, half), (record, _) in found.items() if half is None},
        {name: (found[name, 0][1], found[name, 1][1]) for name, half in found if half == 1},
    )


def _with_geometry(
    plan: Plan, sequence: FrameSequence, share: float
) -> Generator[Progress, None, Case]:
    def part(step: Progress) -> Progress:
        return Progress(share * step.fraction, f"{plan.name}, geometry: {step.message}")

    return (yield from forwarded(prepared(sequence, plan.settings), part))


def _make(
    method: Method, case: Case, half: int | None, grid: GridRecord, place: Path, key: str
) -> Generator[Progress, None, None]:
    """Make the cells of a method that are not on the disk yet."""
    begun = _record_of(place, key) if method.cell_by_cell else None
    if begun is None or begun.failed:
        shutil.rmtree(place, ignore_errors=True)
        place.mkdir(parents=True, exist_ok=True)
        begun = MethodRecord(key=key, note=method.note, cpu_s=0.0)
    record = begun
    todo = [cell for cell in grid.cells if not _image_file(place, cell).is_file()]
    since = _cpu_s()
    try:
        frames = case if half is None else case.half(half)
        for step in method.images(frames, todo):
            if isinstance(step, Progress):
                yield step
                continue
            cell, image = step
            replace_file(_image_file(place, cell), _tiff(image))
            record = record.model_copy(update={"cpu_s": record.cpu_s + max(_cpu_s() - since, 0.0)})
            since = _cpu_s()
            replace_file(place / _METHOD_FILE, record.model_dump_json(indent=1).encode())
            left = sum(not _image_file(place, other).is_file() for other in grid.cells)
            share = 1.0 - left / len(grid.cells)
            yield Progress(share, f"row {cell[0] + 1}, column {cell[1] + 1}")
    except InspectionError as error:
        record = record.model_copy(update={"failed": str(error)})
        replace_file(place / _METHOD_FILE, record.model_dump_json(indent=1).encode())


def _cpu_s() -> float:
    """CPU time of this process and of those that it has started and that have ended."""
    return sum(os.times()[:4])


def _record_of(place: Path, key: str) -> MethodRecord | None:
    """Read the record of images that were made from the same frames and settings."""
    try:
        record = checked(MethodRecord, json_from(read_text(place / _METHOD_FILE)))
    except (OSError, ValueError):
        return None
    return record if record.key == key else None


def _finished(
    place: Path, key: str, grid: GridRecord
) -> tuple[MethodRecord, dict[Cell, Image]] | None:
    """Read the images of a method; None if one is missing or they are of something else."""
    record = _record_of(place, key)
    if record is None:
        return None
    if record.failed:
        return record, {}
    try:
        return record, {cell: _read_image(place, cell, grid) for cell in grid.cells}
    except (OSError, ValueError):
        return None


def _read_image(place: Path, cell: Cell, grid: GridRecord) -> Image:
    image = np.asarray(tifffile.imread(_image_file(place, cell)), np.float32)
    rows, cols = grid.window(cell)
    if image.shape != (rows.stop - rows.start, cols.stop - cols.start):
        raise ValueError("it is of another size than the cell")
    return image


def _stored_grid(folder: Path, key: str) -> GridRecord | None:
    try:
        record = checked(_CaseRecord, json_from(read_text(folder / CASE_FILE)))
    except (OSError, ValueError):
        return None
    return record.grid if record.key == key else None


def _image_file(place: Path, cell: Cell) -> Path:
    return place / f"r{cell[0] + 1:02d}_c{cell[1] + 1:02d}.tif"


def _tiff(image: Image) -> bytes:
    file = BytesIO()
    tifffile.imwrite(file, np.ascontiguousarray(image, np.float32), compression="zlib")
    return file.getvalue()


def _digest(sequence: FrameSequence) -> str:
    """Hash of all frames as they were read."""
    found = hashlib.sha256(json.dumps(sequence.names).encode())
    for frame in range(len(sequence)):
        found.update(np.ascontiguousarray(sequence.frame(frame).image).tobytes())
    return found.hexdigest()


def _key(*parts: str) -> str:
    text = json.dumps([*parts, versions().get("pv-inspect", "")])
    return hashlib.sha256(text.encode()).hexdigest()
