"""Networks of others that enlarge a picture four times, run on the CPU by the package ncnn."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from pv_inspect.errors import InspectionError

__all__ = ["NcnnNetwork"]

Image = NDArray[np.float32]


class NcnnNetwork:
    """A network of three colours in and out, with the blobs ``data`` and ``output``.

    Parameters
    ----------
    param : Path
        Description of the network; the weights lie beside it under the same name with ``.bin``.
    scale : int
        By which it enlarges.

    Raises
    ------
    InspectionError
        If the package is not installed or can't read the files.
    """

    def __init__(self, param: Path, scale: int) -> None:
        try:
            import ncnn
        except ImportError:
            raise InspectionError(
                "The package ncnn, which runs the network, is not installed: "
                "pip install 'pv-inspect[peers]'."
            ) from None
        self._ncnn: Any = ncnn
        self._scale = scale
        net = ncnn.Net()
        net.opt.use_vulkan_compute = False
        net.opt.num_threads = cv2.getNumThreads()
        # Half precision is for speed on phones.
        net.opt.use_fp16_packed = net.opt.use_fp16_storage = net.opt.use_fp16_arithmetic = False
        net.opt.use_bf16_storage = False
        if net.load_param(str(param)) != 0 or net.load_model(str(param.with_suffix(".bin"))) != 0:
            raise InspectionError(f"{param} can't be read by ncnn: install its package again.")
        self._net = net

    def enlarged(self, image: Image) -> Image:
        """Enlarge a picture, given as three equal colours; the colours that come are averaged.

        Parameters
        ----------
        image : (h, w) float32
            In [0, 1].

        Returns
        -------
        (scale * h, scale * w) float32

        Raises
        ------
        InspectionError
            If the network fails.
        """
        height, width = image.shape
        given = np.stack([image] * 3)  # not copied by ncnn: it has to live until the end
        with self._net.create_extractor() as run:
            run.input("data", self._ncnn.Mat(given))
            failed, made = run.extract("output")
            colours = np.array(made, np.float32)
        wanted = (3, self._scale * height, self._scale * width)
        if failed or colours.shape != wanted:
            raise InspectionError(
                f"The network has returned an array {colours.shape} instead of {wanted}: install "
                "its package again."
            )
        return np.asarray(colours.mean(axis=0), np.float32)
