"""BasicVSR: features run through the frames in both directions, carried along by optical flow.

References
----------
.. [1] K. C. K. Chan, X. Wang, K. Yu, C. Dong, C. C. Loy, "BasicVSR: The Search for Essential
       Components in Video Super-Resolution and Beyond", CVPR 2021. arXiv:2012.02181
.. [2] A. Ranjan, M. J. Black, "Optical Flow Estimation using a Spatial Pyramid Network", CVPR
       2017. arXiv:1611.00850
"""

from __future__ import annotations

from collections.abc import Generator, Iterable, Mapping

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import map_coordinates

from pv_inspect.common.work import Progress
from pv_inspect.errors import InspectionError
from pv_inspect.evaluation.peers.convolution import convolved

__all__ = ["SCALE", "BasicVsr"]

Maps = NDArray[np.float32]

SCALE = 4
_LEVELS = 6
_FLOW_LAYERS = 5
# The flow is sought in pictures whose sides halve five times without a rest.
_SIDE = 2 ** (_LEVELS - 1)


class BasicVsr:
    """The network with its weights.

    Parameters
    ----------
    weights : mapping of str to float32 array
        With the names of the authors' files; the number of residual blocks and of features is
        that of the arrays.

    Raises
    ------
    InspectionError
        If arrays are missing.
    """

    def __init__(self, weights: Mapping[str, Maps]) -> None:
        self._weights = weights
        names = [f"spynet.{name}" for name in ("mean", "std")]
        for level in range(_LEVELS):
            names += self._layer_names(
                f"spynet.basic_module.{level}.basic_module.{2 * k}" for k in range(_FLOW_LAYERS)
            )
        names += self._layer_names(f"{way}_trunk.main.0" for way in ("forward", "backward"))
        names += self._layer_names(("fusion", "upconv1", "upconv2", "conv_hr", "conv_last"))
        missing = sorted(set(names) - set(weights))
        if missing:
            raise InspectionError(
                f"The weights of BasicVSR lack {missing[0]}: they are of another network or of "
                "another version of it."
            )

    @staticmethod
    def _layer_names(layers: Iterable[str]) -> list[str]:
        return [f"{layer}.{part}" for layer in layers for part in ("weight", "bias")]

    def enlarged(self, frames: Maps, index: int) -> Generator[Progress, None, Maps]:
        """Enlarge one frame with the help of the others.

        Parameters
        ----------
        frames : (n, 3, h, w) float32
            In their order, in [0, 1].
        index : int
            The frame that is enlarged.

        Yields
        ------
        Progress

        Returns
        -------
        (3, 4 h, 4 w) float32
        """
        last = len(frames) - 1
        total = len(frames) + 1
        done = 0
        carried = []
        # Only what reaches the frame: the later ones backward, the earlier ones forward.
        ways = (("backward", range(last, index - 1, -1)), ("forward", range(index + 1)))
        for way, order in ways:
            state: Maps | None = None
            before = -1
            for i in order:
                if state is None:
                    count = self._weights[f"{way}_trunk.main.0.weight"].shape[0]
                    state = np.zeros((count, *frames.shape[2:]), np.float32)
                else:
                    state = warped(state, self.flow(frames[i], frames[before]), "grid-constant")
                state = self._residual(way, np.concatenate([frames[i], state]))
                before = i
                done += 1
                yield Progress(done / total, f"frame {done} of {total}")
            assert state is not None
            carried.append(state)
        maps = _leaky(self._layer("fusion", np.concatenate(carried)))
        maps = _leaky(_shuffled(self._layer("upconv1", maps)))
        maps = _leaky(_shuffled(self._layer("upconv2", maps)))
        detail = self._layer("conv_last", _leaky(self._layer("conv_hr", maps)))
        return detail + _resized(frames[index], (detail.shape[2], detail.shape[1]))

    def flow(self, frame: Maps, other: Maps) -> Maps:
        """Find by SPyNet where each pixel of a frame lies in another one.

        Parameters
        ----------
        frame, other : (3, h, w) float32
            In [0, 1].

        Returns
        -------
        (2, h, w) float32
            x, y to add, px.
        """
        height, width = frame.shape[1:]
        size = (-(-width // _SIDE) * _SIDE, -(-height // _SIDE) * _SIDE)
        mean, std = (self._weights[f"spynet.{name}"][0] for name in ("mean", "std"))
        pairs = [tuple((_resized(m, size) - mean) / std for m in (frame, other))]
        for _ in range(_LEVELS - 1):
            pairs.append(tuple(_halved(m) for m in pairs[-1]))
        flow = np.zeros((2, *pairs[-1][0].shape[1:]), np.float32)
        for level, (here, there) in enumerate(reversed(pairs)):
            if level:
                flow = 2 * _doubled(flow)
            maps = np.concatenate([here, warped(there, flow, "nearest"), flow])
            for k in range(_FLOW_LAYERS):
                maps = self._layer(f"spynet.basic_module.{level}.basic_module.{2 * k}", maps)
                if k < _FLOW_LAYERS - 1:
                    maps = np.maximum(maps, 0)
            flow = flow + maps
        scale = np.array([width / size[0], height / size[1]], np.float32)
        return _resized(flow, (width, height)) * scale[:, None, None]

    def _layer(self, name: str, maps: Maps) -> Maps:
        return convolved(maps, self._weights[f"{name}.weight"], self._weights[f"{name}.bias"])

    def _residual(self, way: str, maps: Maps) -> Maps:
        state = _leaky(self._layer(f"{way}_trunk.main.0", maps))
        block = 0
        while f"{way}_trunk.main.2.{block}.conv1.weight" in self._weights:
            name = f"{way}_trunk.main.2.{block}"
            inner = np.maximum(self._layer(f"{name}.conv1", state), 0)
            state = state + self._layer(f"{name}.conv2", inner)
            block += 1
        return state


def warped(maps: Maps, flow: Maps, beyond: str) -> Maps:
    """Fetch (n, h, w) maps from where a (2, h, w) flow points, by linear interpolation."""
    y, x = np.mgrid[: maps.shape[1], : maps.shape[2]]
    at = np.stack([y + flow[1], x + flow[0]])
    return np.stack([map_coordinates(one, at, order=1, mode=beyond) for one in maps])


def _leaky(maps: Maps) -> Maps:
    return np.where(maps > 0, maps, np.float32(0.1) * maps)


def _shuffled(maps: Maps) -> Maps:
    """Put groups of four maps into one of twice the size (pixel shuffle)."""
    count, height, width = maps.shape
    parts = maps.reshape(count // 4, 2, 2, height, width)
    return parts.transpose(0, 3, 1, 4, 2).reshape(count // 4, 2 * height, 2 * width)


def _resized(maps: Maps, size: tuple[int, int]) -> Maps:
    return np.stack([cv2.resize(one, size, interpolation=cv2.INTER_LINEAR) for one in maps])


def _halved(maps: Maps) -> Maps:
    count, height, width = maps.shape
    parts = maps.reshape(count, height // 2, 2, width // 2, 2)
    return np.asarray(parts.mean(axis=(2, 4)), np.float32)


def _doubled(maps: Maps) -> Maps:
    """Twice the size, with the first and last pixels where they were: so SPyNet was trained."""
    _, height, width = maps.shape
    y = np.linspace(0, height - 1, 2 * height)
    x = np.linspace(0, width - 1, 2 * width)
    at = np.stack(np.meshgrid(y, x, indexing="ij"))
    return np.stack([map_coordinates(one, at, order=1) for one in maps])
