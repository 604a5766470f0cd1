"""A user's own camera calibration: OpenCV's YAML, JSON or XML, or the result of an earlier run."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from pv_inspect.camera import Camera
from pv_inspect.errors import InspectionError

__all__ = ["KnownCamera", "read_camera", "write_camera"]

# Spelled in lower case without underscores.
_MATRIX_KEYS = ("cameramatrix", "k")
_DISTORTION_KEYS = ("distortioncoefficients", "distcoeffs", "kappa")
_COEFFICIENTS = ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6", "s1", "s2", "s3", "s4")
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
    """Write a camera as OpenCV does, for `read_camera` and for other programs.

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
    beside = path.with_name(f".{path.name}.part")
    try:
        beside.write_text(text, encoding="utf-8")
        beside.replace(path)
    except OSError as error:
        beside.unlink(missing_ok=True)
        raise InspectionError(
            f"The camera can't be written to {path} ({error.strerror}): choose another folder."
        ) from None


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
    made_for = [_size(entries.get(key)) for key in ("imagewidth", "imageheight")]
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


def _size(value: Any) -> int | None:
    return int(value) if isinstance(value, (int, float)) else None


def _numbers(
    path: Path, entries: dict[str, Any], names: tuple[str, ...]
) -> NDArray[np.float64] | None:
    """Return the first of the entries that is there, as finite numbers."""
    for name in names:
        value = entries.get(name)
        if isinstance(value, dict):  # a matrix as OpenCV writes it into JSON, and ROS into YAML
            value = value.get("data")
        if value is None:
            continue
        try:
            numbers = np.asarray(value, dtype=np.float64)
        except (TypeError, ValueError):
            numbers = np.array(np.nan)
        if not np.isfinite(numbers).all():
            raise InspectionError(f"{path} has an entry {name!r} that is no matrix: {_WANTED}.")
        return numbers
    return None


def _entries(path: Path) -> dict[str, Any]:
    """Content of the file by name, spelled in lower case without underscores."""
    try:
        text = path.read_text(encoding="utf-8")
    except OSError as error:
        raise InspectionError(
            f"{path} can't be read ({error.strerror}): give an existing calibration file."
        ) from None
    except UnicodeDecodeError:
        raise InspectionError(f"{path} is no text file: {_WANTED}.") from None
    try:
        found = json.loads(text) if text.lstrip().startswith("{") else _opencv(text)
    except (ValueError, RecursionError, cv2.error, SystemError):
        found = None
    if not isinstance(found, dict) or not found:
        raise InspectionError(f"{path} can't be understood: {_WANTED}.")
    inner = found.get("camera")
    entries = {**found, **inner} if isinstance(inner, dict) else found
    return {str(name).lower().replace("_", ""): value for name, value in entries.items()}


def _opencv(text: str) -> dict[str, Any]:
    """Parse YAML or XML as OpenCV does; its YAML must say that it is one."""
    if not text.lstrip().startswith(("%YAML", "<")):
        text = f"%YAML:1.0\n---\n{text}"
    storage = cv2.FileStorage(text.lstrip(), cv2.FILE_STORAGE_READ | cv2.FILE_STORAGE_MEMORY)
    try:
        root = storage.root()
        return {name: _plain(root.getNode(name)) for name in root.keys()}  # noqa: SIM118
    finally:
        storage.release()


def _plain(node: Any) -> Any:
    """Turn a node of OpenCV's storage into plain Python; None for what is of no interest."""
    if node.isInt() or node.isReal():
        return node.real()
    if node.isSeq():
        return [_plain(node.at(i)) for i in range(node.size())]
    if not node.isMap():
        return None
    if "data" in node.keys():  # noqa: SIM118
        return _plain(node.getNode("data"))
    return {name: _plain(node.getNode(name)) for name in node.keys()}  # noqa: SIM118
