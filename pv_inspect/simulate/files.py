"""Writing a simulated sequence: frames, sidecar and truth."""

from __future__ import annotations

import json
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np
import tifffile

from pv_inspect.errors import InspectionError
from pv_inspect.storage.output_paths import output_folder
from pv_inspect.storage.reservations import locked_output
from pv_inspect.storage.temporaries import PARTIAL, is_dead, leftovers, lock_of, own

if TYPE_CHECKING:
    from pv_inspect.simulate import SimulatedSequence

__all__ = ["check_target", "reserve_sequence", "truth_dict", "write_sequence"]

_MAX_RADIANCE = 1.5
"""Radiance of the brightest value of hr.png."""
_HR_STEP = 32
"""hr.png keeps the upper 11 of 16 bits: 0.1 % of an average cell, and it compresses."""


def truth_dict(sequence: SimulatedSequence, name: str) -> dict[str, Any]:
    """Contents of ``truth.json``: geometry, optics, noise, state of every frame."""
    settings, scene = sequence.settings, sequence.scene
    layout = scene.layout
    ppu = scene.pixels_per_unit
    noise_names = ["exposure", "read_noise_e", "ambient", "prnu", "column_offset_e", "column_gain"]
    noise_names += ["hot_share", "dead_share", "vignetting", "flicker"]
    return {
        "name": name,
        "rows": layout.rows,
        "cols": layout.cols,
        "cell_aspect": layout.cell_aspect,
        "col_lines": layout.col_lines.tolist(),
        "row_lines": layout.row_lines.tolist(),
        "cell_gap": list(layout.cell_gap),
        "widths": layout.widths.tolist(),
        "heights": layout.heights.tolist(),
        "image_size": [settings.width, settings.height],
        "plane": "unit = cell-width pitch, x right, y down; crossing (row i, col j) at "
        "(col_lines[j], row_lines[i]), without wide gaps (j, i/cell_aspect)",
        "model": "x_px = K * d(H * [x, y, 1]);  d: r_d = r_u + kappa r_u^3 in normalised "
        "coordinates",
        "K": sequence.camera_matrix.tolist(),
        "kappa": settings.kappa,
        "psf": {
            "kind": settings.psf_shape,
            "sigma": settings.psf_sigma_px,
            "unit": "LR px, standard deviation per axis, before the square pixel aperture",
        },
        "noise": {
            "full_well": settings.full_well_e,
            **{key: getattr(settings, key) for key in noise_names},
            "black_dn": settings.black_level_dn,
            "shot_noise": settings.shot_noise,
        },
        "view": {
            key: getattr(settings, key) for key in ("tilt_deg", "tilt_axis_deg", "roll_deg", "fill")
        },
        "hr": {
            "file": "hr.png",
            "px_per_unit": ppu,
            "pixels_per_cell": [ppu, ppu / layout.cell_aspect],
            "origin_px": list(scene.origin_px),
            "value_scale": _MAX_RADIANCE / 65535,
            "cracks": "cracks.png",
        },
        "seed": settings.seed,
        "cells": [
            {
                "row": cell.row,
                "col": cell.col,
                "gain": cell.gain,
                "cracked": cell.cracked,
                "dark": cell.dark,
            }
            for cell in scene.cells
        ],
        "frames": [
            {
                "file": file,
                "valid": True,
                "reason": None,
                "H": pose.H.tolist(),
                "crossings_px": np.round(sequence.crossings_px(i), 5).tolist(),
                "gain": round(pose.gain, 5),
                "motion": {
                    "length_px": round(pose.motion_px, 3),
                    "angle_deg": round(pose.motion_deg, 2),
                },
            }
            for i, (file, pose) in enumerate(zip(sequence.frame_names, sequence.poses, strict=True))
        ],
    }


def check_target(folder: Path) -> None:
    """Refuse a folder that `write_sequence` would refuse; worth a call before a long simulation.

    Raises
    ------
    InspectionError
        If the folder holds something already, or can't be looked into.
    """
    try:
        free = not folder.exists() or (folder.is_dir() and not any(folder.iterdir()))
    except OSError as error:
        raise _unwritable(folder, error) from None
    if not free:
        raise InspectionError(
            f"{folder} exists and is not an empty folder: remove it or give another name."
        )


@contextmanager
def reserve_sequence(folder: Path) -> Iterator[None]:
    """Check as `check_target` does, and keep other processes from writing there in the block.

    Raises
    ------
    InspectionError
        As `check_target`, or if another process is writing there, or nothing can be.
    """
    folder = output_folder(folder)
    check_target(folder)
    with locked_output(folder, lock_of(folder), 0.0):
        for left in leftovers(folder, PARTIAL):
            if is_dead(left):
                shutil.rmtree(left, ignore_errors=True)
        yield


def _unwritable(folder: Path, error: OSError) -> InspectionError:
    return InspectionError(
        f"{folder} can't be written ({error.strerror or error}): "
        "choose a writable place with enough room."
    )


def write_sequence(sequence: SimulatedSequence, folder: Path) -> None:
    """Write a sequence; the folder appears when it is whole.

    Parameters
    ----------
    sequence : SimulatedSequence
    folder : Path
        Becomes ``frames/``, ``module.json`` and ``truth/``; its name is the sequence's name.

    Raises
    ------
    InspectionError
        If the folder holds something already, or can't be written.
    """
    folder = output_folder(folder)
    check_target(folder)
    beside = own(folder, PARTIAL)
    try:
        beside.mkdir(parents=True)
        _write_into(sequence, beside, folder.name)
        if folder.exists():
            folder.rmdir()
        beside.replace(folder)
    except OSError as error:
        raise _unwritable(folder, error) from None
    finally:
        shutil.rmtree(beside, ignore_errors=True)


def _write_into(sequence: SimulatedSequence, folder: Path, name: str) -> None:
    layout, scene = sequence.scene.layout, sequence.scene
    (folder / "frames").mkdir()
    (folder / "truth").mkdir()
    for file, frame in zip(sequence.frame_names, sequence.frames, strict=True):
        tifffile.imwrite(
            folder / "frames" / file,
            frame,
            photometric="minisblack",
            compression="zlib",
            compressionargs={"level": 9},
            predictor=True,
        )
    module: dict[str, Any] = {
        "rows": layout.rows,
        "cols": layout.cols,
        "cell_aspect": layout.cell_aspect,
    }
    module |= {
        key: dict(sizes) for key in ("row_heights", "col_widths") if (sizes := getattr(layout, key))
    }
    _write_text(folder / "module.json", json.dumps(module) + "\n")
    _write_text(folder / "truth" / "truth.json", json.dumps(truth_dict(sequence, name)) + "\n")
    values = scene.radiance * (65535 / _MAX_RADIANCE)
    hr = np.clip(np.rint(values / _HR_STEP) * _HR_STEP, 0, 65535).astype(np.uint16)
    _write_png(folder / "truth" / "hr.png", hr)
    _write_png(folder / "truth" / "cracks.png", scene.cracks.astype(np.uint8) * 255)


def _write_text(path: Path, text: str) -> None:
    path.write_text(text, encoding="utf-8")


def _write_png(path: Path, image: np.ndarray[Any, Any]) -> None:
    options = [cv2.IMWRITE_PNG_COMPRESSION, 6, cv2.IMWRITE_PNG_FILTER, cv2.IMWRITE_PNG_ALL_FILTERS]
    options += [cv2.IMWRITE_PNG_STRATEGY, cv2.IMWRITE_PNG_STRATEGY_FILTERED]
    _, data = cv2.imencode(".png", image, options)
    path.write_bytes(data.tobytes())
