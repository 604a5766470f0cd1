"""Joint refinement: the frames registered again, against the reconstruction instead of the mean.

The registration compares a frame with the mean of all frames, which is blurred differently. Here
the frame is compared with what its own W_i makes of the reconstructed module (the paper's future
work): reconstruction and registration are then steps down the same objective.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pv_inspect.observation import ObservationModel

__all__ = ["refined_pose"]

Array = NDArray[np.float64]
Image = NDArray[np.float32]

_HUBER = 2.5
_STEPS = 2


def refined_pose(
    model: ObservationModel,
    blurred: Image,
    H: Array,
    motion: Array,
    g: Image,
    weights: Image,
) -> Array:
    """Refine one pose so that W_i f agrees with the frame.

    Parameters
    ----------
    model : ObservationModel
    blurred : (H, W) float32
        B f, the module image after the common blur.
    H : (3, 3) float64
        Module plane to normalised image coordinates.
    motion : (3,) float64
        See `pv_inspect.motion.motion_of`.
    g, weights : (height, width) float32
        Frame on the module's intensity scale and 1 / variance.

    Returns
    -------
    (3, 3) float64

    Notes
    -----
    Gauss-Newton on the 8 parameters of a homography of the HR plane and a gain and an offset, with
    Huber weights. The derivative by the position is W_i applied to the gradient of B f.
    """
    dy, dx = (np.asarray(d, np.float32) for d in np.gradient(blurred))
    height, width = model.grid.shape
    size = 0.5 * max(height, width)
    to_unit = np.array(
        [
            [1 / size, 0, -0.5 * (width - 1) / size],
            [0, 1 / size, -0.5 * (height - 1) / size],
            [0, 0, 1],
        ]
    )
    for _ in range(_STEPS):
        operator = model.frame(H, motion)
        positions = operator.positions()
        predicted = operator.sample(blurred)
        use = (weights > 0) & (predicted != 0) & np.isfinite(positions).all(axis=-1)
        if use.sum() < 200:
            return H
        x, y = ((positions[use] - [0.5 * (width - 1), 0.5 * (height - 1)]) / size).T
        gx, gy = (size * operator.sample(d)[use].astype(np.float64) for d in (dx, dy))
        p = predicted[use].astype(np.float64)
        radial = gx * x + gy * y
        design = np.stack(
            [gx * x, gx * y, gx, gy * x, gy * y, gy, -radial * x, -radial * y, p, np.ones_like(p)],
            axis=1,
        )
        residual = g[use] - p
        z = np.abs(residual) * np.sqrt(weights[use])
        w = weights[use] * np.minimum(1.0, _HUBER / np.maximum(z, 1e-9))
        normal = design.T @ (design * w[:, None])
        step = np.linalg.solve(normal + 1e-9 * np.diag(np.diag(normal)), design.T @ (w * residual))
        increment = np.append(step[:8], 0.0).reshape(3, 3)
        # A pixel shows p' = (1 + d) p of the HR plane, p what H says.
        moved = np.linalg.inv(to_unit) @ (np.eye(3) + increment) @ to_unit @ model.to_hr(H)
        new = np.linalg.inv(moved) @ np.linalg.inv(model.grid.matrix)
        H = np.asarray(new * (H[2, 2] / new[2, 2]), np.float64)
    return H
