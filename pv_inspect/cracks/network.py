"""Cracks by a small network, trained by `pv_inspect.cracks.training.train`, run by OpenCV.

A model is two files: NAME.onnx and NAME.json, which says what the network expects and returns, how
its answer becomes a probability, and which bytes the first file must have. The network sees a cell
with its longer side at 256 px and returns the probability of each class for each pixel.
"""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from threading import Lock
from typing import Annotated, Any

import cv2
import numpy as np
from numpy.typing import NDArray
from pydantic import ConfigDict, Field

from pv_inspect.common.records import Number, Record, Text, checked, json_from, read_text
from pv_inspect.cracks.classes import BUSBAR, CLASSES, CRACK
from pv_inspect.cracks.features import OperatingPoint
from pv_inspect.cracks.foreign_network import NetworkApart
from pv_inspect.cracks.looks import KnownLooks
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
# SHA-256 of the models of the package. Any other runs in a process of its own.
_OURS = {
    "156110f815ad9fcb0a163ad9ffa60714b50900e019d32fa3e69573cb22da8e3b",
    "ca826ec4c065ba03a919ae48254a6829185cf53a8018b46bd1adadf5fb039c40",
    "5a77e39dea27ef3e0ea0839da7599712a5c9bdb76e03a23920ad78bab15a4cac",
}
# Ours has 1 MB.
_MOST_BYTES, _MOST_ABOUT_BYTES = 2**27, 2**16
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
    looks : KnownLooks, optional
        Of the cells that it was trained on.
    """

    path: Path
    name: str
    sha256: str
    slope: float
    offset: float
    operating_point: OperatingPoint
    looks: KnownLooks | None = None

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
            stored = checked(_About, json_from(read_text(about, _MOST_ABOUT_BYTES)))
            looks = None if stored.looks is None else stored.looks.known()
        except (OSError, ValueError) as error:
            raise InspectionError(
                f"{about} is no description of a crack model ({error}): train the model again or "
                "restore the file."
            ) from None
        point = stored.operating_point
        model = cls(
            path,
            stored.name,
            stored.sha256,
            stored.calibration.slope,
            stored.calibration.offset,
            OperatingPoint(**point.model_dump()),
            looks,
        )
        classes = stored.classes
        if classes != CLASSES:
            raise InspectionError(
                f"{about} names the classes {', '.join(map(str, classes))}, but a crack model has "
                f"{', '.join(CLASSES)} in this order: give a model of "
                "pv_inspect.cracks.training.train."
            )
        return model


class _Calibration(Record):
    slope: Number
    offset: Number


class _Point(Record):
    model_config = ConfigDict(frozen=True, extra="forbid")

    threshold: Annotated[float, Field(strict=True, ge=0, le=1)]
    least_extent_cells: Annotated[float, Field(strict=True, ge=0, le=10)]
    least_length_cells: Annotated[float, Field(strict=True, ge=0, le=10)] = 0.0
    least_score: Annotated[float, Field(strict=True, ge=0, le=1)] = 0.0


class _Looks(Record):
    mean: tuple[Number, ...]
    whitening: tuple[tuple[Number, ...], ...]
    limit: Annotated[float, Field(strict=True, gt=0)]

    def known(self) -> KnownLooks:
        """As the program uses it.

        Raises
        ------
        ValueError
            If the numbers are not as many as a look has.
        """
        return KnownLooks(np.array(self.mean), np.array(self.whitening), self.limit)


class _About(Record):
    name: Text
    sha256: Text
    classes: tuple[Text, ...]
    calibration: _Calibration
    operating_point: _Point
    looks: _Looks | None = None


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

    def novelty(self, tile: Image) -> float:
        """How far the look of a cell is from the cells that the network was trained on.

        Parameters
        ----------
        tile : (h, w) float32
            One cell, any size and brightness scale.

        Returns
        -------
        float
            From 1 on the answer can't be relied on; NaN if the description does not say.
        """
        looks = self._model.looks
        return float("nan") if looks is None or not np.ptp(tile) > 0 else looks.novelty(tile)

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
        classes = _run(self._net, padded)
        _check(self._model.path, classes, padded.shape)
        return classes[:, :, :h, :w]

    def _calibrated(self, p: Image) -> Image:
        q = np.clip(p, 1e-6, 1 - 1e-6)
        log_odds = self._model.slope * np.log(q / (1 - q)) + self._model.offset
        return np.asarray(1 / (1 + np.exp(-log_odds)), np.float32)


def _run(net: Any, inputs: Image) -> Image:
    # A network keeps its buffers between two calls; all detectors share it.
    with _RUNNING:
        if isinstance(net, NetworkApart):
            return net.forward(inputs[:, None])
        net.setInput(np.ascontiguousarray(inputs[:, None]))
        return np.array(net.forward(), np.float32)


def _check(path: Path, found: Image, seen: tuple[int, ...]) -> None:
    """Refuse answers that are no probabilities of our classes."""
    n, h, w = seen
    expected = (n, len(CLASSES), h, w)
    # Not a number is no probability either: it fails every comparison.
    if found.shape != expected or not bool((np.abs(found.sum(1) - 1) < 1e-3).all()):
        raise InspectionError(
            f"{path} is no crack model: for cells {(n, 1, h, w)} it returns {found.shape}, "
            f"expected are probabilities {expected} of {', '.join(CLASSES)}."
        )


@lru_cache(maxsize=4)
def _opened(path: Path, sha256: str) -> Any:
    size = path.stat().st_size
    if size > _MOST_BYTES:
        raise InspectionError(
            f"{path} has {size / 1e6:.0f} MB, no crack model has more than "
            f"{_MOST_BYTES / 1e6:.0f}: give a model of pv_inspect.cracks.training.train."
        )
    data = path.read_bytes()
    found = hashlib.sha256(data).hexdigest()
    if found != sha256:
        raise InspectionError(
            f"{path} was altered: its SHA-256 begins with {found[:12]}, its description says "
            f"{sha256[:12]}; install pv-inspect again or train the model again."
        )
    net: Any
    if found in _OURS:
        net = cv2.dnn.readNetFromONNX(np.frombuffer(data, np.uint8))
    else:
        net = NetworkApart(path, data)
    # A small cell whose sides differ: it shows wrong inputs, and outputs of another size.
    cells = np.zeros((2, 2 * _STRIDE, 3 * _STRIDE), np.float32)
    _check(path, _run(net, cells), cells.shape)
    return net
