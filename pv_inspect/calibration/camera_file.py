"""A user's own camera calibration: OpenCV's YAML, JSON or XML, or the result of an earlier run."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from pv_inspect.calibration.opencv_text import xml_entries, yaml_entries
from pv_inspect.common.records import json_from, read_text
from pv_inspect.errors import InspectionError
from pv_inspect.geometry.camera import Camera
from pv_inspect.storage.folders import replace_file

__all__ = ["KnownCamera", "read_camera", "write_camera"]

# Spelled in lower case without underscores.
_MATRIX_KEYS = ("cameramatrix", "k")
_DISTORTION_KEYS = ("distortioncoefficients", "distcoeffs", "kappa")
_COEFFICIENTS = ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6", "s1", "s2", "s3", "s4")
_ALL_KEYS = (*_MATRIX_KEYS, *_DISTORTION_KEYS, "camera", "imagewidth", "imageheight")
_MOST_BYTES, _MOST_TEXT = 2**26, 2**20
_LARGEST_SIDE_PX = 10**6
_BEYOND_ANY = 1e15
# Focal length in widths of the frame: 0.1 is a fisheye, 1000 a telescope.
_FOCAL_WIDTHS = (0.05, 5000.0)
# A fisheye reaches 0.5 before the image folds.
_MOST_MOVED = 2.0
_WANTED = "give an OpenCV calibration (YAML, JSON or XML) or a result.json of pv-inspect"


@dataclass(frozen=True, eq=False)
class KnownCamera:
    """What a calibration file fixes.

    Parameters
    ----------
    K : (3, 3) float64
        Intrinsic matrix, LR px.
    kappa : float or None
        Radial distortion; None if the file says nothing about distortion.
    """

    K: NDArray[np.float64]
    kappa: float | None


def read_camera(path: Path, image_shape: tuple[int, int]) -> KnownCamera:
    """Read a camera calibration.

    Parameters
    ----------
    path : Path
        Holds the camera matrix under ``camera_matrix``, ``cameraMatrix`` or ``K`` and the
        distortion under ``distortion_coefficients``, ``dist_coeffs`` (k1 of OpenCV's model is
        kappa) or ``kappa``; at the top or under ``camera``.
    image_shape : tuple of int
        (height, width) of the frames that it is meant for.

    Returns
    -------
    KnownCamera

    Raises
    ------
    InspectionError
        If the file can't be read, has no camera matrix, was made for frames of another size, or
        has distortion that a single radial coefficient can't express.
    """
    entries = _entries(path)
    matrix = _numbers(path, entries, _MATRIX_KEYS)
    if matrix is None:
        raise InspectionError(f"{path} holds no camera matrix: {_WANTED}.")
    if matrix.size != 9:
        raise InspectionError(
            f"The camera matrix in {path} has {matrix.size} numbers, but 3 x 3 are expected: "
            f"{_WANTED}."
        )
    distortion = _numbers(path, entries, _DISTORTION_KEYS)
    kappa = _radial(path, distortion)
    try:
        camera = Camera(matrix.reshape(3, 3), kappa or 0.0)
    except InspectionError as error:
        raise InspectionError(f"{path}: {error}") from None
    _check_size(path, entries, camera, image_shape)
    return KnownCamera(camera.K, kappa)


def write_camera(path: Path, camera: Camera, image_shape: tuple[int, int]) -> None:
    """Write a camera as OpenCV does, for `read_camera` and for other programs; whole or not at all.

    Parameters
    ----------
    path : Path
        The suffix .json or .xml makes JSON or XML, any other one YAML.
    camera : Camera
    image_shape : tuple of int
        (height, width) of the frames that it belongs to.

    Raises
    ------
    InspectionError
        If the file can't be written.
    """
    kind = path.suffix.lower() if path.suffix.lower() in (".json", ".xml") else ".yaml"
    mode = cv2.FILE_STORAGE_WRITE | cv2.FILE_STORAGE_MEMORY
    storage = cv2.FileStorage(kind, mode)
    storage.write("image_width", image_shape[1])
    storage.write("image_height", image_shape[0])
    storage.write("camera_matrix", np.asarray(camera.K, np.float64))
    storage.write("distortion_coefficients", np.array([[camera.kappa, 0.0, 0.0, 0.0, 0.0]]))
    text = storage.releaseAndGetString()
    replace_file(path, text.encode())


def _radial(path: Path, distortion: NDArray[np.float64] | None) -> float | None:
    """Return k1; everything else must be zero."""
    if distortion is None or distortion.size == 0:
        return None
    values = distortion.ravel()
    others = {
        (_COEFFICIENTS[i] if i < len(_COEFFICIENTS) else f"coefficient {i + 1}"): value
        for i, value in enumerate(values)
        if i > 0 and value != 0
    }
    if others:
        text = ", ".join(f"{name} = {value:g}" for name, value in others.items())
        raise InspectionError(
            f"{path} has {text}, but the camera model has one radial coefficient, k1: calibrate "
            "again with all others fixed to zero."
        )
    return float(values[0])


def _check_size(
    path: Path, entries: dict[str, Any], camera: Camera, image_shape: tuple[int, int]
) -> None:
    height, width = image_shape
    made_for = [_size(path, entries, key) for key in ("imagewidth", "imageheight")]
    if None not in made_for and made_for != [width, height]:
        raise InspectionError(
            f"{path} was made for images of {made_for[0]} x {made_for[1]} px, but the frames have "
            f"{width} x {height} px: give the calibration of this camera at this size."
        )
    x, y = camera.K[:2, 2]
    if not (0 <= x <= width - 1 and 0 <= y <= height - 1):
        raise InspectionError(
            f"The principal point in {path} is ({x:g}, {y:g}) and lies outside of the frames of "
            f"{width} x {height} px: give the calibration of this camera at this size."
        )
    least, most = _FOCAL_WIDTHS
    if not all(least * width <= focal <= most * width for focal in np.diag(camera.K)[:2]):
        raise InspectionError(
            f"The focal lengths in {path} are {camera.K[0, 0]:g} and {camera.K[1, 1]:g} px, which "
            f"no lens has over frames of {width} px: give the calibration of this camera."
        )
    # Share by which the lens moves a point at the edge of the frame.
    moved = abs(camera.kappa) * (0.5 * width / camera.K[0, 0]) ** 2
    if moved > _MOST_MOVED:
        raise InspectionError(
            f"k1 in {path} is {camera.kappa:g} and moves the edge of the frame by {moved:.3g} of "
            "its distance from the middle: give the calibration of this camera."
        )


def _size(path: Path, entries: dict[str, Any], name: str) -> int | None:
    value = entries.get(name)
    if value is None:
        return None
    is_number = isinstance(value, (int, float)) and not isinstance(value, bool)
    if not (is_number and 1 <= value <= _LARGEST_SIDE_PX):
        raise InspectionError(
            f"{path}: {name} is {str(value)[:40]!r}, but a number of pixels is expected: correct "
            "it, or take that entry out."
        )
    return int(value)


def _numbers(
    path: Path, entries: dict[str, Any], names: tuple[str, ...]
) -> NDArray[np.float64] | None:
    """Return the first of the entries that is there, as finite numbers."""
    for name in names:
        value = entries.get(name)
        size = None
        if isinstance(value, dict):  # a matrix as OpenCV writes it, and ROS
            size = value.get("rows"), value.get("cols")
            value = value.get("data")
        if value is None:
            continue
        leaves = list(_leaves(value))
        wrong = next((v for v in leaves if not _is_number(v)), None)
        try:
            numbers = np.asarray(value if wrong is None else np.nan, dtype=np.float64)
        except (TypeError, ValueError):  # rows of different lengths
            numbers = np.array(np.nan)
        if not np.isfinite(numbers).all():
            shown = "" if wrong is None else f", but holds {str(wrong)[:40]!r}"
            raise InspectionError(
                f"{path} has an entry {name!r} that is no matrix of numbers{shown}: {_WANTED}."
            )
        if size is not None and None not in size and size != _shape_of(numbers, size):
            raise InspectionError(
                f"{path} has an entry {name!r} with {numbers.size} numbers, which are not "
                f"{str(size[0])[:20]} x {str(size[1])[:20]}: {_WANTED}."
            )
        return numbers
    return None


def _shape_of(numbers: NDArray[np.float64], size: tuple[Any, Any]) -> tuple[Any, Any] | None:
    """Return ``size`` if so many numbers are there."""
    if not all(isinstance(n, int) and 0 < n < 100 for n in size):
        return None
    return size if size[0] * size[1] == numbers.size else None


def _leaves(value: Any) -> Iterator[Any]:
    """All that lies in nested lists; the readers limit how deep they are."""
    if isinstance(value, list):
        for item in value:
            yield from _leaves(item)
    else:
        yield value


def _is_number(value: Any) -> bool:
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        return False
    return abs(value) < _BEYOND_ANY  # also false for what is no number


def _entries(path: Path) -> dict[str, Any]:
    """Content of the file by name, spelled in lower case without underscores."""
    try:
        text = read_text(path, _MOST_BYTES).lstrip()
        if text.startswith("{"):
            found = json_from(text)
        elif len(text) > _MOST_TEXT:
            raise ValueError(f"it has {len(text)} characters")
        else:
            found = xml_entries(text) if text.startswith("<") else yaml_entries(text)
        if not isinstance(found, dict) or not found:
            raise ValueError("it holds no names with values")
        entries = _by_name(found)
        inner = entries.get("camera")
        return {**entries, **_by_name(inner)} if isinstance(inner, dict) else entries
    except OSError as error:
        raise InspectionError(
            f"{path} can't be read ({error.strerror}): give an existing calibration file."
        ) from None
    except (ValueError, RecursionError) as error:
        raise InspectionError(f"{path} can't be understood ({error}): {_WANTED}.") from None


def _by_name(found: dict[str, Any]) -> dict[str, Any]:
    names = [str(name).lower().replace("_", "") for name in found]
    twice = next((name for name in names if names.count(name) > 1), None)
    if twice is not None and twice in _ALL_KEYS:
        raise ValueError(f"it holds {twice!r} twice, in two spellings")
    return dict(zip(names, found.values(), strict=True))
