"""The result folder: written whole or not at all, and read back for the viewer."""

from __future__ import annotations

import io
import json
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import tifffile
from numpy.typing import NDArray

from pv_inspect._version import __version__
from pv_inspect.calibration.calibrate import focal_length_source
from pv_inspect.common.csv_tables import csv_lines, csv_text
from pv_inspect.common.records import checked, json_from, read_text
from pv_inspect.common.versions import versions
from pv_inspect.cracks import CLASS_RULE, CellFeatures, CrackMap
from pv_inspect.cracks.features import FEATURES, from_texts, texts
from pv_inspect.errors import InspectionError
from pv_inspect.geometry.camera import Camera
from pv_inspect.geometry.layout import HrGrid, ModuleLayout
from pv_inspect.image_files.stored import stored_floats, stored_shape
from pv_inspect.inspection.inspection import Inspection
from pv_inspect.reports.module_report import render_report
from pv_inspect.results.folder import (
    CELLS_FOLDER,
    RESULT_JSON,
    check_writable,
    reserve_result,
    tile_name,
)
from pv_inspect.results.geometry_record import GEOMETRY_JSON, geometry_record, source_record
from pv_inspect.results.records import FrameRecord, ResultRecord
from pv_inspect.settings import Settings
from pv_inspect.storage.folders import Reservation, read_steadily, recovered

__all__ = [
    "FrameResult",
    "Result",
    "check_unchanged",
    "check_writable",
    "read_result",
    "tile_name",
    "write_result",
]


@dataclass(frozen=True, eq=False)
class FrameResult:
    """What became of one frame.

    Parameters
    ----------
    file : str
    used : bool
    why : str
        Why it is not used; "" if it is.
    crossings_px : (n_crossings, 2) float64 or None
        LR pixel positions of all crossing points, NaN beyond the fold of the lens.
    H : (3, 3) float64 or None
        Module plane to normalised image coordinates.
    gain, offset : float
        The frame is ``gain * (W f) + offset``, full-scale units.
    rms : float
        Registration residual: against the mean of the frames, in units of the noise. Views show
        ``residual``.
    residual : float
        Residual: against the module image, in units of the noise; see `figures`.
    edits : dict
        (row, col) of the crossing points that a person has set, and where, (x, y) LR px; None for
        those that were removed.
    """

    file: str
    used: bool
    why: str
    crossings_px: NDArray[np.float64] | None
    H: NDArray[np.float64] | None
    gain: float
    offset: float
    rms: float
    residual: float = float("nan")
    edits: dict[tuple[int, int], tuple[float, float] | None] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class Result:
    """A result folder, read.

    Parameters
    ----------
    folder : Path
    image, support, consistency, cracks : (H, W) float32
        Module image (full scale = 1), support in [0, 1], residual of the frames in units of the
        noise, crack probability in [0, 1].
    grid : HrGrid
    camera : Camera
    frames : tuple of FrameResult
    cells : tuple of CellFeatures
        Row-major.
    settings : Settings
    crack_threshold : float
    detector : str
        Name of what found the cracks.
    least_extent_cells : float
        Marks that are shorter count as no crack in ``cells``.
    seconds : dict of str to float
    warnings : tuple of str
    doubts : tuple of str
        Why the result must not be relied on.
    versions : dict of str to str
    prior_weight, psf_sigma_lr_px : float
        lambda and optical blur that were used.
    record : dict
        All of ``result.json``.
    """

    folder: Path
    image: NDArray[np.float32]
    support: NDArray[np.float32]
    consistency: NDArray[np.float32]
    cracks: NDArray[np.float32]
    grid: HrGrid
    camera: Camera
    frames: tuple[FrameResult, ...]
    cells: tuple[CellFeatures, ...]
    settings: Settings
    crack_threshold: float
    detector: str
    least_extent_cells: float
    seconds: dict[str, float]
    warnings: tuple[str, ...]
    versions: dict[str, str]
    prior_weight: float = float("nan")
    psf_sigma_lr_px: float = float("nan")
    record: dict[str, Any] = field(default_factory=dict, repr=False)
    doubts: tuple[str, ...] = ()

    @property
    def crack_map(self) -> CrackMap:
        """The cracks as the stage that looked for them gave them."""
        return CrackMap(
            self.cracks,
            self.crack_threshold,
            self.detector,
            self.cells,
            self.least_extent_cells,
        )

    def __repr__(self) -> str:
        layout = self.grid.layout
        return f"<Result in {str(self.folder)!r}: {layout.rows} x {layout.cols} cells>"

    def _repr_html_(self) -> str:
        from pv_inspect.notebook.display import result_html

        return result_html(self)


def write_result(inspection: Inspection, out: Path, reservation: Reservation | None = None) -> None:
    """Write the result folder (contract in the design), all or nothing.

    Everything is written into a folder beside ``out`` and moved into place when it is whole. An
    earlier result is replaced; files in it that this program did not write are kept.

    Parameters
    ----------
    inspection : Inspection
        Complete.
    out : Path
    reservation : Reservation, optional
        Of ``out``, from `reserve_result`; without one it is reserved now.

    Raises
    ------
    InspectionError
        If the inspection is not complete, or the folder can't be written; then an earlier result
        is as it was.
    """
    if not inspection.complete:
        raise InspectionError(
            "This inspection is not complete, so that no result can be written: run it to its end."
        )
    with nullcontext(reservation) if reservation else reserve_result(out, patient=True) as place:
        place.fill(_files(inspection, place.out))


def read_result(folder: Path) -> Result:
    """Read a result folder.

    Parameters
    ----------
    folder : Path

    Returns
    -------
    Result

    Raises
    ------
    InspectionError
        If the folder is no result, or a file of it is missing or damaged.
    """
    folder = recovered(folder)
    return read_steadily(folder, lambda: _read_result(folder))


def _read_result(folder: Path) -> Result:
    path = folder / RESULT_JSON
    try:
        there = path.is_file()
    except OSError as error:  # no permission, or a name that is too long
        raise InspectionError(
            f"{folder} can't be read ({error.strerror}): give the folder that `pv-inspect run "
            "--out` wrote."
        ) from None
    if not there:
        raise InspectionError(
            f"{folder} is no result folder ({RESULT_JSON} is missing): give the folder that "
            "`pv-inspect run --out` wrote."
        )
    with _damaged(path):
        content, record = _record_in(path)
        layout = ModuleLayout(**record.layout.model_dump())
        camera = Camera(np.array(record.camera.K, np.float64), record.camera.kappa)
        settings = Settings.create(**record.settings)
    grid = HrGrid(
        layout,
        record.pixels_per_cell[0],
        record.origin_px,
        _shape_of(folder / "module_hr.tif"),
        record.magnification,
    )
    with _damaged(path):
        _check_place(grid)
    image = _read_image(folder / "module_hr.tif", grid.shape)
    support = _read_image(folder / "support.tif", grid.shape, gaps=True)
    consistency = _read_image(folder / "consistency.tif", grid.shape, gaps=True)
    probability = _read_image(folder / "cracks.tif", grid.shape)
    with _damaged(folder / "cells.csv"):
        cells = _cells_from(read_text(folder / "cells.csv"), layout)
    return Result(
        folder,
        image,
        support,
        consistency,
        probability,
        grid,
        camera,
        tuple(map(_frame_from, record.frames)),
        cells,
        settings,
        record.crack_threshold,
        record.crack_detector,
        record.crack_least_extent_cells,
        record.seconds,
        tuple(record.warnings),
        record.versions,
        _known(record.prior_weight),
        _known(record.psf_sigma_lr_px),
        # With what an earlier version did not say.
        content,
        tuple(record.doubts),
    )


def _record_in(path: Path) -> tuple[dict[str, Any], ResultRecord]:
    """All that ``result.json`` says, with what an earlier version did not; and what is checked."""
    content = json_from(read_text(path))
    record = checked(ResultRecord, content)
    return {**content, **record.model_dump(mode="json")}, record


def check_unchanged(result: Result) -> None:
    """Check that a result folder still holds the result that was read from it.

    Raises
    ------
    InspectionError
        If another run has replaced it.
    """
    path = result.folder / RESULT_JSON
    with _damaged(path):
        now, _ = _record_in(path)
    if now != result.record:
        raise InspectionError(
            f"{result.folder} holds another result than the one that was opened: open it again."
        )


def result_record(inspection: Inspection) -> dict[str, Any]:
    """Return the content of ``result.json``: plain types, None for what is not a number."""
    registration, reconstruction = inspection.registration, inspection.reconstruction
    cracks, layout = inspection.cracks, inspection.layout
    assert registration is not None
    assert reconstruction is not None
    assert cracks is not None
    frames = []
    for i, name in enumerate(inspection.sequence.names):
        used = bool(registration.used[i])
        frames.append(
            {
                "file": name,
                "used": used,
                "why": "" if used else registration.why[i],
                "crossings_px": registration.crossings_px(i) if used else None,
                "H": registration.homographies[i] if used else None,
                "gain": registration.gain[i] if used else None,
                "offset": registration.offset[i] if used else None,
                "rms": registration.rms[i] if used else None,
                "residual": reconstruction.residual_rms[i],
                "motion_px_deg": reconstruction.motion[i] if used else None,
                "edits": _edits(inspection, i),
            }
        )
    seconds = dict(inspection.seconds)
    record = {
        **reconstruction.grid.to_dict(),
        "rows": layout.rows,
        "cols": layout.cols,
        "layout": {"rows": layout.rows, "cols": layout.cols, "cell_aspect": layout.cell_aspect},
        "camera": {
            "K": registration.camera.K,
            "kappa": registration.camera.kappa,
            "focal_length": focal_length_source(
                registration.camera, inspection.sequence.shape, inspection.settings
            ),
        },
        "frames": frames,
        "settings": inspection.settings.model_dump(mode="json"),
        "prior_weight": reconstruction.prior_weight,
        "psf_sigma_lr_px": reconstruction.psf_sigma_lr_px,
        "solver": {
            "objective": reconstruction.objective,
            "iterations": reconstruction.iterations,
            "converged": reconstruction.converged,
        },
        "lambda_curve": reconstruction.lambda_curve,
        "crack_detector": cracks.detector,
        "crack_threshold": cracks.threshold,
        "crack_least_extent_cells": cracks.least_extent_cells,
        "cells": [
            {**asdict(cell), "crack_class": cell.crack_class, "marked_class": cell.marked_class}
            for cell in cracks.cells
        ],
        "class_rule": CLASS_RULE.splitlines(),
        "seconds": {**seconds, "total": sum(seconds.values())},
        "doubts": list(inspection.doubts),
        "warnings": list(inspection.warnings),
        "versions": versions(),
    }
    plain: dict[str, Any] = _plain(record)
    return plain


def _edits(inspection: Inspection, i: int) -> list[dict[str, Any]]:
    """Crossing points of frame i that a person has set, or removed: then ``px`` is None."""
    if inspection.crossings is None:
        return []
    frame, cols = inspection.crossings.frames[i], inspection.layout.cols + 1
    return [
        {
            "row": int(k) // cols,
            "col": int(k) % cols,
            "px": frame.points_px[k] if frame.measured[k] else None,
        }
        for k in np.flatnonzero(frame.by_hand)
    ]


def _files(inspection: Inspection, out: Path) -> Iterator[tuple[str, bytes]]:
    """Name and content of every file of the result in ``out``, ``result.json`` last."""
    reconstruction, cracks, tiles = inspection.reconstruction, inspection.cracks, inspection.tiles
    assert reconstruction is not None
    assert cracks is not None
    assert tiles is not None
    grid = reconstruction.grid
    yield "module_hr.tif", _tiff(reconstruction.image, grid, "rectified module, full scale = 1")
    yield "support.tif", _tiff(reconstruction.support, grid, "support by the frames, 0 to 1", True)
    what = "residual of the frames in units of the noise"
    yield "consistency.tif", _tiff(reconstruction.consistency, grid, what, True)
    yield "cracks.tif", _tiff(cracks.probability, grid, "crack probability, 0 to 1", True)
    for row, col in np.ndindex(*tiles.images.shape[:2]):
        what = f"cell in row {row + 1}, column {col + 1}, full scale = 1"
        yield f"{CELLS_FOLDER}/{tile_name(row, col)}", _tiff(tiles.images[row, col], grid, what)
    yield "cells.csv", _csv(cracks.cells).encode()
    yield "report.html", render_report(inspection).encode()
    yield GEOMETRY_JSON, _json(geometry_record(inspection))
    record = {"source": source_record(inspection.sequence, out), **result_record(inspection)}
    yield RESULT_JSON, _json(record)


def _json(record: dict[str, Any]) -> bytes:
    return json.dumps(_plain(record), indent=1, allow_nan=False).encode()


def _tiff(image: NDArray[np.float32], grid: HrGrid, what: str, pack: bool = False) -> bytes:
    px, py = grid.pixels_per_cell
    buffer = io.BytesIO()
    # No physical cell size is known: the resolution is stated in pixels per cell width.
    tifffile.imwrite(
        buffer,
        np.ascontiguousarray(image, np.float32),
        photometric="minisblack",
        compression="zlib" if pack else None,
        # Noise hardly shrinks: higher levels take longer for one percent.
        compressionargs={"level": 1} if pack else None,
        resolution=(grid.pixels_per_unit, grid.pixels_per_unit),
        resolutionunit="NONE",
        description=f"{what}; {px:g} x {py:g} pixels per cell; resolution: pixels per cell width",
        software=f"pv-inspect {__version__}",
        metadata=None,
    )
    return buffer.getvalue()


def _csv(cells: tuple[CellFeatures, ...]) -> str:
    rows: list[list[object]] = [["row", "col", "tile", *FEATURES, "crack_class", "marked_class"]]
    for cell in cells:
        tile = f"{CELLS_FOLDER}/{tile_name(cell.row, cell.col)}"
        classes = cell.crack_class, cell.marked_class
        rows.append([cell.row + 1, cell.col + 1, tile, *texts(cell), *classes])
    return csv_text(rows)


def _shape_of(path: Path) -> tuple[int, int]:
    """Size of a stored image, without reading its pixels."""
    with _damaged(path):
        return stored_shape(path)


def _read_image(path: Path, shape: tuple[int, int], gaps: bool = False) -> NDArray[np.float32]:
    """Read an image of a known size; ``gaps``: it may have pixels that are not known."""
    with _damaged(path):
        if stored_shape(path) != shape:
            raise ValueError("it is of another size than the module image or its grid")
        image = stored_floats(path)
        if np.isinf(image).any() or (not gaps and np.isnan(image).any()):
            raise ValueError("it has pixels that are no numbers")
    return image


def _check_place(grid: HrGrid) -> None:
    """Refuse a grid whose cells do not lie on its image."""
    rows, cols = grid.layout.rows, grid.layout.cols
    corners = [grid.cell_slices(0, 0), grid.cell_slices(rows - 1, cols - 1)]
    (first_y, first_x), (last_y, last_x) = corners
    height, width = grid.shape
    if min(first_y.start, first_x.start) < 0 or last_y.stop > height or last_x.stop > width:
        raise ValueError(
            f"origin_px and pixels_per_cell put {rows} x {cols} cells beyond the image of {width} "
            f"x {height} px"
        )


def _cells_from(text: str, layout: ModuleLayout) -> tuple[CellFeatures, ...]:
    cells = tuple(
        from_texts(int(line["row"]) - 1, int(line["col"]) - 1, line) for line in csv_lines(text)
    )
    if [(cell.row, cell.col) for cell in cells] != list(np.ndindex(layout.rows, layout.cols)):
        raise ValueError(
            f"it has not one line for each of {layout.rows} x {layout.cols} cells, row by row"
        )
    for cell in cells:
        for name in ("crack_length_cells", "crack_score", "dark_area_share", "mean_intensity"):
            if not abs(getattr(cell, name)) < 1e9:
                raise ValueError(f"row {cell.row + 1}, column {cell.col + 1}: {name} is no number")
    return cells


def _frame_from(frame: FrameRecord) -> FrameResult:
    points = frame.crossings_px
    return FrameResult(
        frame.file,
        frame.used,
        frame.why,
        None if points is None else np.array(points, np.float64).reshape(-1, 2),
        None if frame.H is None else np.array(frame.H, np.float64),
        _known(frame.gain),
        _known(frame.offset),
        _known(frame.rms),
        _known(frame.residual),
        {(edit.row, edit.col): edit.px for edit in frame.edits},
    )


def _known(value: float | None) -> float:
    return float("nan") if value is None else value


def _plain(value: Any) -> Any:
    """Nested value with plain Python types; NaN and infinity become None: JSON has neither."""
    if isinstance(value, dict):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, np.ndarray):
        return _plain(value.tolist())
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    if isinstance(value, np.generic):
        return _plain(value.item())
    if isinstance(value, float):
        return value if np.isfinite(value) else None
    return value


@contextmanager
def _damaged(path: Path) -> Iterator[None]:
    """Turn whatever a damaged file raises into one sentence."""
    try:
        yield
    except FileNotFoundError:
        raise InspectionError(
            f"{path} is missing, so that the result is not whole: run the inspection again."
        ) from None
    except Exception as error:  # what the decoders of damaged files raise is not documented
        detail = f"no entry {error}" if isinstance(error, KeyError) else str(error)
        raise InspectionError(
            f"{path} is damaged or of another version ({detail}): run the inspection again."
        ) from None
