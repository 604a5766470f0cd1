"""Absolute crossing error of the calibration on simulated sequences, from noisy true crossings.

Crossing points come from the truth (this script may read it), get Gaussian noise and gross
outliers, and go through `calibrate`. Printed per sequence: RMSE over all crossings inside the
frames, LR px, for free homographies with and without an estimated principal point, and for the
pose parameterisation (6 parameters per frame and one focal length), which is kept here only to be
compared with.

    python benchmarks/calibration_truth.py ../shared/data/sequences --noise 0.1 --outliers 0.02
"""

from __future__ import annotations

import argparse
import json
import time
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from pv_inspect.calibration.calibrate import Calibration, calibrate
from pv_inspect.detection.crossings import Crossings, FrameCrossings
from pv_inspect.geometry.camera import Camera
from pv_inspect.geometry.layout import ModuleLayout
from pv_inspect.settings import Settings

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Truth:
    """Geometry of one sequence."""

    name: str
    layout: ModuleLayout
    shape: tuple[int, int]
    camera: Camera
    px: Array  # (n_frames, n_crossings, 2)
    inside: NDArray[np.bool_]  # (n_frames, n_crossings)

    @classmethod
    def read(cls, folder: Path, aspect_error: float = 0.0) -> Truth:
        """Read truth.json; the exact crossings come from H, K and kappa, not the rounded ones.

        ``aspect_error`` is by how much, relatively, the layout that calibration sees is wrong.
        """
        data = json.loads((folder / "truth" / "truth.json").read_text(encoding="utf-8"))
        layout = ModuleLayout(data["rows"], data["cols"], data["cell_aspect"])
        width, height = data["image_size"]
        camera = Camera(np.array(data["K"]), data["kappa"])
        homographies = [np.array(f["H"]) for f in data["frames"] if f["valid"]]
        px = np.array([camera.project(H, layout.crossings()) for H in homographies])
        inside = ((px >= 0) & (px <= [width - 1, height - 1])).all(axis=2)
        layout = ModuleLayout(layout.rows, layout.cols, layout.cell_aspect * (1 + aspect_error))
        return cls(data["name"], layout, (height, width), camera, px, inside)

    def measured(self, noise_px: float, outliers: float, seed: int) -> Crossings:
        """Crossings as a detector could give them; an outlier is 3 to 30 px off."""
        rng = np.random.default_rng(seed)
        frames = []
        for px, inside in zip(self.px, self.inside, strict=True):
            points = px + noise_px * rng.standard_normal(px.shape)
            wrong = rng.random(len(px)) < outliers
            angle, distance = rng.uniform(0, 2 * np.pi, len(px)), rng.uniform(3, 30, len(px))
            shift = (distance * [np.cos(angle), np.sin(angle)]).T
            points = np.where(wrong[:, None], px + shift, points)
            points[~inside] = np.nan
            frames.append(FrameCrossings(points, np.full(len(px), max(noise_px, 0.05)), inside, ""))
        return Crossings(self.layout, tuple(frames))

    def rmse(self, px: Array) -> tuple[float, float]:
        """Median and maximum over the frames of the crossing RMSE inside the frame, px."""
        errors = np.sum((px - self.px) ** 2, axis=2)
        per_frame = [
            np.sqrt(np.mean(e[inside])) for e, inside in zip(errors, self.inside, strict=True)
        ]
        return float(np.median(per_frame)), float(np.max(per_frame))


def fit_poses(truth: Truth, crossings: Crossings, start: Calibration, centre: bool) -> Array:
    """Crossings (n_frames, n_crossings, 2) px after fitting poses, one focal length and kappa."""
    plane = truth.layout.crossings()
    n = len(truth.px)
    side = max(truth.shape)
    prior = np.array([(truth.shape[1] - 1) / 2, (truth.shape[0] - 1) / 2])
    used = [f.measured for f in crossings.frames]
    f0 = start.camera.K[0, 0]
    centre0 = start.camera.K[:2, 2] if centre else prior

    def unpack(p: Array) -> tuple[Camera, list[Array]]:
        f, kappa, cx, cy = np.exp(p[0]) * f0, p[1], *(p[2:4] if centre else prior)
        return Camera(np.array([[f, 0, cx], [0, f, cy], [0, 0, 1]]), kappa), list(
            p[4:].reshape(n, 6)
        )

    def homography(pose: Array) -> tuple[Array, Array]:
        R, dR = cv2.Rodrigues(pose[:3])
        H = np.column_stack([R[:, 0], R[:, 1], pose[3:]])
        dH = np.zeros((9, 6))
        dR = dR.reshape(3, 3, 3) if dR.shape == (3, 9) else dR.T.reshape(3, 3, 3)
        for k in range(3):
            dH[:, k] = np.column_stack([dR[k][:, 0], dR[k][:, 1], np.zeros(3)]).ravel()
            dH[3 * k + 2, 3 + k] = 1.0
        return H, dH

    def residuals(p: Array) -> Array:
        camera, poses = unpack(p)
        out = []
        for frame, m, pose in zip(crossings.frames, used, poses, strict=True):
            r = (camera.project(homography(pose)[0], plane[m]) - frame.points_px[m]).ravel()
            out.append(r / np.repeat(frame.sigma_px[m], 2))
        return np.concatenate([*out, (p[2:4] - prior) / (side / 128)])

    def jacobian(p: Array) -> Array:
        camera, poses = unpack(p)
        rows = []
        for k, (frame, m, pose) in enumerate(zip(crossings.frames, used, poses, strict=True)):
            H, dH = homography(pose)
            d = camera.derivatives(H, plane[m])
            h = H.ravel()
            last = -(d.d_homography @ h[:8]) / h[8]  # scaling H moves nothing
            full = np.concatenate([d.d_homography, last[:, :, None]], axis=2)
            J = np.zeros((*d.px.shape, len(p)))
            J[:, :, 0] = d.d_intrinsics[:, :, :2].sum(axis=2) * np.exp(p[0]) * f0
            J[:, :, 1] = d.d_kappa
            if centre:
                J[:, :, 2:4] = d.d_intrinsics[:, :, 2:]
            J[:, :, 4 + 6 * k : 10 + 6 * k] = full @ dH
            rows.append((J / frame.sigma_px[m][:, None, None]).reshape(-1, len(p)))
        tail = np.zeros((2, len(p)))
        tail[0, 2] = tail[1, 3] = 128 / side
        return np.concatenate([*rows, tail])

    poses = []
    for H in start.homographies:
        H = H / np.sqrt(np.linalg.norm(H[:, 0]) * np.linalg.norm(H[:, 1]))
        U, _, Vt = np.linalg.svd(np.column_stack([H[:, :2], np.cross(H[:, 0], H[:, 1])]))
        poses.append(np.concatenate([cv2.Rodrigues(U @ Vt)[0].ravel(), H[:, 2]]))
    p0 = np.concatenate([[0.0, start.camera.kappa], centre0, *poses])
    solution = least_squares(
        residuals, p0, jacobian, loss="cauchy", f_scale=2.385, x_scale="jac", max_nfev=60
    )
    camera, fitted = unpack(solution.x)
    return np.array([camera.project(homography(pose)[0], plane) for pose in fitted])


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path)
    parser.add_argument("--noise", type=float, nargs="+", default=[0.0, 0.1, 0.3], help="px")
    parser.add_argument("--outliers", type=float, default=0.02, help="share of wrong crossings")
    parser.add_argument("--poses", action="store_true", help="fit poses as well")
    parser.add_argument("--aspect-error", type=float, default=0.0, help="relative, of the layout")
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args()
    header = ["free+centre", "max", "free", "max", *["pose+centre", "pose"] * arguments.poses]
    print("RMSE against the truth, LR px: median over frames (and max where said)")
    print(f"{'':4}{'noise':>6}" + "".join(f"{h:>12}" for h in header), end="")
    print(f"{'f (truth)':>16}{'kappa (truth)':>18}{'+-':>8}{'c off':>7}{'seconds':>9}")
    for noise in arguments.noise:
        for folder in sorted(p.parent for p in arguments.folder.glob("*/truth")):
            truth = Truth.read(folder, arguments.aspect_error)
            crossings = truth.measured(noise, arguments.outliers if noise else 0.0, arguments.seed)
            start = time.perf_counter()
            best = calibrate(crossings, truth.shape, Settings())
            seconds = time.perf_counter() - start
            fixed = calibrate(crossings, truth.shape, Settings(), principal_point_std_px=0)
            line = []
            for fit in (best, fixed):
                line += truth.rmse(np.array([fit.crossings_px(i) for i in range(len(truth.px))]))
            if arguments.poses:
                for fit, centre in ((best, True), (fixed, False)):
                    line.append(truth.rmse(fit_poses(truth, crossings, fit, centre))[0])
            f, f_true = best.camera.K[0, 0], truth.camera.K[0, 0]
            off = np.hypot(*(best.camera.K[:2, 2] - truth.camera.K[:2, 2]))
            name = f"{f:.0f}{'*' if best.focal_convention else ''} ({f_true:.0f})"
            kappa = f"{best.camera.kappa:.4f} ({truth.camera.kappa:.2f})"
            print(f"{truth.name:4}{noise:6.2f}" + "".join(f"{v:12.5f}" for v in line), end="")
            print(f"{name:>16}{kappa:>18}{best.kappa_std:8.4f}{off:7.2f}{seconds:9.2f}")
    print("* focal length by convention")


if __name__ == "__main__":
    main()
