"""A result: what is read back from its folder, and what ``result.json`` says of an inspection."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pv_inspect.calibration.focal_length import focal_length_source
from pv_inspect.common.versions import versions
from pv_inspect.cracks import CLASS_RULE, CellFeatures, CrackMap
from pv_inspect.geometry.camera import Camera
from pv_inspect.geometry.grid import HrGrid
from pv_inspect.inspection.inspection import Inspection
from pv_inspect.results.records import FrameRecord, ResultRecord
from pv_inspect.settings import Settings

__all__ = ["FrameResult", "Result", "frame_from", "result_record"]


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


def result_record(inspection: Inspection) -> dict[str, Any]:
    """Return the content of ``result.json``: plain types, None for what is not a number."""
    registration, reconstruction = inspection.registration, inspection.reconstruction
    cracks, layout = inspection.cracks, inspection.layout
    assert registration is not None
    assert reconstruction is not None
    assert cracks is not None
    photometry = reconstruction.photometry
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
        "format": ResultRecord.newest_format,
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
        "vignetting": None if photometry is None else vars(photometry.vignetting),
        "layout_guessed": inspection.layout_guessed,
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


def frame_from(frame: FrameRecord) -> FrameResult:
    """Return what a record says of one frame."""
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
