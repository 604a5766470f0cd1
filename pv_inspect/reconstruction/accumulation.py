"""The data of a reconstruction, frame by frame: what has entered is never read again.

Memory holds one stencil whatever the number of frames; only frames with motion blur, which fit
into no common stencil, keep their positions.
"""

from __future__ import annotations

from collections.abc import Generator
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from pv_inspect.geometry.grid import HrGrid
from pv_inspect.geometry.rays import SensorRays
from pv_inspect.observation.model import ObservationModel
from pv_inspect.observation.normal_equations import NormalEquations
from pv_inspect.photometry.photometry import Photometry, huber_weights, observed
from pv_inspect.reconstruction.consistency import Consistency
from pv_inspect.registration.registration import Registration
from pv_inspect.sequence.sequence import FrameSequence

__all__ = ["Accumulation", "Extremes"]

Array = NDArray[np.float64]
Image = NDArray[np.float32]

# Light is not negative. What is darker than black is noise, or a black level that is too high: a
# module image is allowed as much of it as the frames show, down to this (full scale = 1).
_DARKEST = -0.05
# An HR pixel may be brighter than the mean over the LR pixel that it lies in.
_BRIGHTER = 1.1


@dataclass(eq=False)
class Extremes:
    """The darkest and the brightest pixel of the frames that have entered.

    Parameters
    ----------
    darkest, brightest : float
        On the module's intensity scale.
    """

    darkest: float = 0.0
    brightest: float = 0.0

    def add(self, g: Image, weights: Image) -> None:
        """Look at one frame; pixels of weight 0 don't count."""
        valid = g[weights > 0]
        if valid.size:
            self.darkest = min(self.darkest, float(valid.min()))
            self.brightest = max(self.brightest, float(valid.max()))

    def limit(self, image: Image) -> Image:
        """Return a module image without values that no module can have.

        Parameters
        ----------
        image : (height, width) float32

        Returns
        -------
        (height, width) float32
            Nothing is darker than the darkest pixel of the frames (below 0, and down to -0.05), or
            more than 1.1 times as bright as the brightest: a defect of the sensor that was not
            found, or too sharp a PSF, leaves such values.
        """
        if not self.brightest > 0.0:
            return image
        low = np.float32(max(self.darkest, _DARKEST))
        return np.clip(image, low, np.float32(_BRIGHTER * self.brightest))


@dataclass(frozen=True, eq=False)
class Accumulation:
    """Frames of a sequence in the normal equations of Eq. 7.

    Parameters
    ----------
    sequence : FrameSequence
    registration : Registration
    motion : (n_frames, 2) float64
        Path of every frame during its exposure, LR px.
    equations : NormalEquations
    photometry : Photometry, optional
        The sensor's part in the intensities; an ideal sensor if not given.
    blurred : (height, width) float32, optional
        B f of an earlier image f of the module: pixels that contradict it get Huber weights.
    extremes : Extremes
        Of the frames that have entered.
    """

    sequence: FrameSequence
    registration: Registration
    motion: Array
    equations: NormalEquations
    photometry: Photometry | None = None
    blurred: Image | None = None
    extremes: Extremes = field(default_factory=Extremes)

    @classmethod
    def begin(
        cls,
        sequence: FrameSequence,
        registration: Registration,
        grid: HrGrid,
        rays: SensorRays,
        psf_sigma_lr_px: float,
        motion: Array,
        photometry: Photometry | None = None,
        look: Image | None = None,
    ) -> Accumulation:
        """Begin without any frame; ``look`` is an earlier image of the module on the grid."""
        homographies = registration.homographies[registration.used]
        camera = registration.camera
        model = ObservationModel.build(rays, camera, homographies, grid, psf_sigma_lr_px)
        blurred = None if look is None else np.asarray(model.blur.apply(look), np.float32)
        equations = NormalEquations.empty(model)
        return cls(sequence, registration, motion, equations, photometry, blurred)

    def add(self, frame: int) -> tuple[Image, Image]:
        """Let one frame of the sequence enter.

        Returns
        -------
        g, weights : (height, width) float32
            What has entered: intensities on the module's scale and 1 / variance.
        """
        H, motion = self.registration.homographies[frame], self.motion[frame]
        g, weights = observed(self.sequence, self.registration, frame, self.photometry)
        if self.blurred is not None:
            predicted = self.equations.model.frame(H, motion).sample(self.blurred)
            weights = huber_weights(g, np.asarray(predicted, np.float32), weights)
        self.equations.add(H, g, weights, motion)
        self.extremes.add(g, weights)
        return g, weights

    def compare(self, image: Image) -> Generator[float, None, tuple[Image, Array]]:
        """Compare all frames in use with an image of the module.

        Parameters
        ----------
        image : (height, width) float32

        Yields
        ------
        float
            Share of the frames that are compared.

        Returns
        -------
        (height, width) float32
            Residual around every HR pixel in units of the noise, about 1 where the frames agree
            with the image.
        (n_frames,) float64
            Robust rms residual per frame in units of the noise, NaN for frames not in use.
        """
        model, registration = self.equations.model, self.registration
        blurred = model.blur.apply(image)
        gathered = Consistency(model.grid)
        rms = np.full(len(registration.used), np.nan)
        used = np.flatnonzero(registration.used)
        for k, i in enumerate(used):
            frame = model.frame(registration.homographies[i], self.motion[i])
            g, weights = observed(self.sequence, registration, int(i), self.photometry)
            predicted = frame.sample(blurred)
            residual = (g - predicted) * np.sqrt(weights)
            rms[i] = gathered.add(
                frame.positions(),
                residual.astype(np.float32),
                (weights > 0) & (predicted != 0),
            )
            yield (k + 1) / used.size
        return gathered.map(), rms
