"""Cracks by a small network, trained by `pv_inspect.cracks.train`, run by OpenCV.

A model is two files: NAME.onnx and NAME.json, which says what the network expects and returns, how
its answer becomes a probability, and which bytes the first file must have. The network sees a cell
with its longer side at 256 px and returns the probability of each class for each pixel.
"""

from __future__ import annotations

import hashlib
import json
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from threading import Lock
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from pv_inspect.cracks.features import OperatingPoint
from pv_inspect.cracks.labelled import BUSBAR, CLASSES, CRACK
from pv_inspect.errors import InspectionError

__all__ = ["CELL_PX", "MODELS", "CrackModel", "NetworkDetector", "normalised"]

Image = NDArray[np.float32]

# Longer side of a cell that the network sees.
CELL_PX = 256
_FOLDER = Path(__file__).with_name("models")
# Models of the package: the default, and two for comparison, trained without degradation and from
# the labels of cells alone.
MODELS = ("default", "sharp", "weak")
# The network halves the image four times. OpenCV cuts silently what does not fit.
_STRIDE = 16
_BATCH = 8
_RUNNING = Lock()


def normalised(image: Image) -> Image:
    """Input of the network: clip(x / p95 of the cell, 0, 1.5) * 2 - 1."""
    bright = max(float(np.percentile(image, 95)), 1e-6)
    return np.asarray(np.clip(image / bright, 0, 1.5) * 2 - 1, np.float32)


@dataclass(frozen=True, eq=False)
class CrackModel:
    """What is known about a network.

    Parameters
    ----------
    path : Path
        The ONNX file.
    name : str
        For reports: the network, and what it was trained on.
    sha256 : str
        Of the ONNX file.
    slope, offset : float
        Calibration: log odds = ``slope`` * (log odds of the network) + ``offset``.
    operating_point : OperatingPoint
        With calibrated probability.
    """

    path: Path
    name: str
    sha256: str
    slope: float
    offset: float
    operating_point: OperatingPoint

    @classmethod
    def read(cls, path: Path) -> CrackModel:
        """Read the description beside an ONNX file.

        Parameters
        ----------
        path : Path
            The ONNX file; its description is the JSON file of the same name.

        Raises
        ------
        InspectionError
            If a file is missing or damaged, or the network has other classes.
        """
        about = path.with_suffix(".json")
        for needed in (path, about):
            if not needed.is_file():
                raise InspectionError(
                    f"The crack model {needed} is missing: install pv-inspect again, train the "
                    "model again, or use the detector 'ridge', which needs none."
                )
        try:
            stored: dict[str, Any] = json.loads(about.read_text(encoding="utf-8"))
            classes = tuple(stored["classes"])
            model = cls(
                path,
                str(stored["name"]),
                str(stored["sha256"]),
                float(stored["calibration"]["slope"]),
                float(stored["calibration"]["offset"]),
                OperatingPoint(**{k: float(v) for k, v in stored["operating_point"].items()}),
            )
        except (ValueError, KeyError, TypeError) as error:
            raise InspectionError(
                f"{about} is no description of a crack model ({type(error).__name__}: {error}): "
                "train the model again or restore the file."
            ) from None
        if classes != CLASSES:
            raise InspectionError(
                f"{about} names the classes {', '.join(map(str, classes))}, but a crack model has "
                f"{', '.join(CLASSES)} in this order: give a model of pv_inspect.cracks.train."
            )
        return model


class NetworkDetector:
    """Crack detector; see the top of this file.

    Parameters
    ----------
    model : str or Path
        One of `MODELS`, or the ONNX file of a model of one's own.

    Raises
    ------
    InspectionError
        If the model is missing, altered, or no crack model.
    """

    def __init__(self, model: str | Path = "default") -> None:
        path = _FOLDER / f"{model}.onnx" if str(model) in MODELS else Path(model)
        self._model = CrackModel.read(path)
        self._net = _opened(self._model.path, self._model.sha256)

    @property
    def name(self) -> str:
        """Name for reports, with what it was trained on."""
        return self._model.name

    @property
    def operating_point(self) -> OperatingPoint:
        """Where the model finds at least 95 % of the cells with cracks (see the model card)."""
        return self._model.operating_point

    def probability(self, tile: Image) -> Image:
        """Return the crack probability of every pixel of a cell.

        Parameters
        ----------
        tile : (h, w) float32
            One cell, any size and brightness scale.

        Returns
        -------
        (h, w) float32
            In [0, 1], calibrated; 0 in a tile of one value.
        """
        return self.read(tile)[0]

    def read(self, tile: Image) -> tuple[Image, Image]:
        """Return crack and busbar probability of every pixel of a cell, (h, w) float32 each."""
        cracks, busbars = self.read_many(np.asarray(tile, np.float32)[None])
        return cracks[0], busbars[0]

    def read_many(self, tiles: Image) -> tuple[Image, Image]:
        """Return crack and busbar probability of every pixel of many cells.

        Parameters
        ----------
        tiles : (n, h, w) float32

        Returns
        -------
        tuple of two (n, h, w) float32
            The first one calibrated.
        """
        n, h, w = tiles.shape
        cracks, busbars = np.zeros((2, n, h, w), np.float32)
        scale = CELL_PX / max(h, w)
        size = (max(round(w * scale), 1), max(round(h * scale), 1))
        way = cv2.INTER_AREA if scale < 1 else cv2.INTER_CUBIC
        back = cv2.INTER_LINEAR if scale < 1 else cv2.INTER_AREA
        busy = [k for k in range(n) if float(np.ptp(tiles[k])) > 0]
        for start in range(0, len(busy), _BATCH):
            part = busy[start : start + _BATCH]
            seen = [normalised(cv2.resize(tiles[k], size, interpolation=way)) for k in part]
            for k, classes in zip(part, self._forward(np.stack(seen)), strict=True):
                crack = self._calibrated(classes[CRACK])
                cracks[k] = cv2.resize(crack, (w, h), interpolation=back)
                busbars[k] = cv2.resize(classes[BUSBAR], (w, h), interpolation=back)
        return np.clip(cracks, 0, 1), np.clip(busbars, 0, 1)

    def _forward(self, inputs: Image) -> Image:
        """Classes (n, 5, h, w) of inputs (n, h, w), padded by mirroring to whole strides."""
        h, w = inputs.shape[1:]
        bottom, right = -h % _STRIDE, -w % _STRIDE
        mode: Any = "reflect" if min(h, w) >= _STRIDE else "edge"
        padded = np.pad(inputs, ((0, 0), (0, bottom), (0, right)), mode=mode)
        return _run(self._net, padded)[:, :, :h, :w]

    def _calibrated(self, p: Image) -> Image:
        q = np.clip(p, 1e-6, 1 - 1e-6)
        log_odds = self._model.slope * np.log(q / (1 - q)) + self._model.offset
        return np.asarray(1 / (1 + np.exp(-log_odds)), np.float32)


def _run(net: Any, inputs: Image) -> Image:
    # A network keeps its buffers between two calls; all detectors share it.
    with _RUNNING:
        net.setInput(np.ascontiguousarray(inputs[:, None]))
        return np.array(net.forward(), np.float32)


@lru_cache(maxsize=4)
def _opened(path: Path, sha256: str) -> Any:
    data = path.read_bytes()
    found = hashlib.sha256(data).hexdigest()
    if found != sha256:
        raise InspectionError(
            f"{path} was altered: its SHA-256 begins with {found[:12]}, its description says "
            f"{sha256[:12]}; install pv-inspect again or train the model again."
        )
    try:
        net = cv2.dnn.readNetFromONNX(np.frombuffer(data, np.uint8))
        # A small cell whose sides differ: it shows wrong inputs, and outputs of another size.
        tried = _run(net, np.zeros((2, 2 * _STRIDE, 3 * _STRIDE), np.float32))
    except cv2.error as error:
        said = str(error).rpartition("error:")[2]
        raise InspectionError(
            f"{path} can't be used as a crack model ({' '.join(said.split())}): its input must be "
            "cells (n, 1, h, w) float32; give a model of pv_inspect.cracks.train."
        ) from None
    expected = (2, len(CLASSES), 2 * _STRIDE, 3 * _STRIDE)
    if tried.shape != expected or not np.allclose(tried.sum(1), 1, atol=1e-3):
        raise InspectionError(
            f"{path} is no crack model: for cells (2, 1, 32, 48) it returns {tried.shape}, "
            f"expected are probabilities {expected} of {', '.join(CLASSES)}."
        )
    return net
