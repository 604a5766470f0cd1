"""Crossing points, camera and registration against the truth of simulated sequences.

    python benchmarks/geometry.py ../shared/data/sequences [--model homography]
    python benchmarks/geometry.py --random 100 --seed 0

The stages see frames and module.json only; this script reads the truth. Lengths are LR px.

calibrated, registered
    RMSE of the crossing points inside the frame, after either stage; median and maximum over the
    used frames.
between
    The true crossings of every frame are carried into the estimated module plane. Where they lie
    on average over the frames is taken out; what is left, as seen in each frame, is the error
    between frames.
bound
    Cramer-Rao bound of "between": inverse Fisher information of the 8 parameters of a homography
    with gain and offset, times 1 - 1/N since N frames also make the module image. The gradients
    come from the means of the odd and of the even frames, whose noise is independent: products of
    the two are unbiased. The means are a little blurred, which makes the bound a little too high.
bend
    The average over the frames against the ideal crossings, after one homography: what is left is
    bent in all frames alike.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import multiprocessing
import sys
import tempfile
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from time import perf_counter, process_time

import cv2
import numba
import numpy as np
import tifffile
from numpy.typing import NDArray

from pv_inspect.calibration.calibrate import Calibration, calibrate
from pv_inspect.common.work import result_of
from pv_inspect.detection.detect import detect
from pv_inspect.errors import InspectionError
from pv_inspect.geometry.camera import Camera
from pv_inspect.geometry.grid import HrGrid
from pv_inspect.geometry.layout import ModuleLayout
from pv_inspect.registration.homography import register_by_homography
from pv_inspect.registration.module_mean import module_mean
from pv_inspect.registration.register import register
from pv_inspect.registration.registration import Registration
from pv_inspect.sequence.sequence import FrameSequence
from pv_inspect.settings import Settings
from pv_inspect.simulate import SimulationSettings, simulated
from pv_inspect.simulate.exposure import camera_matrix, choose_poses

Array = NDArray[np.float64]
STAGES = ("open", "detect", "calibrate", "register")
SILENT_PX = 0.5
"""A frame whose crossings are further off than this although it is used has failed silently."""


@dataclass(frozen=True, eq=False)
class Truth:
    """Geometry of one sequence; ``homographies[i]`` is None for a frame that must not be used."""

    layout: ModuleLayout
    shape: tuple[int, int]
    camera: Camera
    homographies: list[Array | None]

    @classmethod
    def read(cls, folder: Path) -> Truth:
        """Read truth.json; exact crossings come from H, K and kappa, not the rounded ones."""
        data = json.loads((folder / "truth" / "truth.json").read_text(encoding="utf-8"))
        width, height = data["image_size"]
        return cls(
            ModuleLayout(data["rows"], data["cols"], data["cell_aspect"]),
            (height, width),
            Camera(np.array(data["K"]), data["kappa"]),
            [np.array(f["H"]) if f["valid"] else None for f in data["frames"]],
        )

    def crossings_px(self, i: int) -> Array:
        """All crossings of a valid frame, NaN outside of the frame."""
        H = self.homographies[i]
        assert H is not None
        px = self.camera.project(H, self.layout.crossings())
        height, width = self.shape
        inside = (px > -0.5) & (px < [width - 0.5, height - 0.5])
        return np.where(inside.all(axis=1, keepdims=True), px, np.nan)

    @property
    def turns(self) -> list[int]:
        """Quarter turns under which the module looks the same."""
        square = self.layout.rows == self.layout.cols and self.layout.cell_aspect == 1
        return [0, 1, 2, 3] if square else [0, 2]


@dataclass(frozen=True)
class Score:
    """All that is measured of one sequence; NaN where it can't be."""

    name: str
    used: int
    frames: int
    wrongly_used: int
    wrongly_rejected: int
    calibrated: tuple[float, float]
    registered: tuple[float, float]
    between: tuple[float, float]
    bound: float
    bend: float
    kappa_error: float
    wall_s: tuple[float, ...]
    cpu_s: tuple[float, ...]

    @property
    def ratio(self) -> float:
        """Error between frames over its bound."""
        return self.between[0] / self.bound


def measured(source: Path, truth: Truth, settings: Settings, name: str) -> Score:
    """Run the stages on one sequence and compare with the truth."""
    wall, cpu = [perf_counter()], [process_time()]

    def tick() -> None:
        wall.append(perf_counter())
        cpu.append(process_time())

    sequence = FrameSequence.open(source)
    layout = sequence.layout(settings)
    tick()
    crossings = result_of(detect(sequence, layout))
    tick()
    calibration = calibrate(crossings, sequence.shape, settings)
    tick()
    if settings.registration_model == "homography":
        registration = result_of(register_by_homography(sequence, crossings, settings))
    else:
        registration = result_of(register(sequence, calibration, settings))
    tick()
    valid = np.array([H is not None for H in truth.homographies])
    f, kappa = registration.camera.K[0, 0], registration.camera.kappa
    expected = truth.camera.kappa / truth.camera.K[0, 0] ** 2
    good = [int(i) for i in np.flatnonzero(registration.used & valid)]
    between, bend = errors_on_the_module(registration, truth, good)
    return Score(
        name,
        int(registration.used.sum()),
        len(valid),
        int((registration.used & ~valid).sum()),
        int((~registration.used & valid).sum()),
        crossing_errors(calibration, truth),
        crossing_errors(registration, truth),
        between,
        bound(sequence, registration, truth, good),
        bend,
        float(kappa / f**2 / expected - 1) if expected else np.nan,
        tuple(np.diff(wall)),
        tuple(np.diff(cpu)),
    )


def crossing_errors(poses: Calibration | Registration, truth: Truth) -> tuple[float, float]:
    """Median and maximum over the used, valid frames of the RMSE of the crossings inside."""
    layout = truth.layout
    best = (np.nan, np.nan)
    for turn in truth.turns:
        found = []
        for i, H in enumerate(truth.homographies):
            if H is None or not poses.used[i]:
                continue
            px = poses.crossings_px(i).reshape(layout.rows + 1, layout.cols + 1, 2)
            wanted = truth.crossings_px(i)
            squared = np.sum((np.rot90(px, turn).reshape(-1, 2) - wanted) ** 2, axis=1)
            inside = np.isfinite(wanted[:, 0])
            found.append(np.sqrt(np.nan_to_num(squared[inside], nan=np.inf).mean()))
        if found and not np.median(found) >= best[0]:
            best = (float(np.median(found)), float(np.max(found)))
    return best


def errors_on_the_module(
    poses: Registration, truth: Truth, frames: list[int]
) -> tuple[tuple[float, float], float]:
    """Median and maximum over the frames of the error between frames; and the common bend."""
    if not frames:
        return (np.nan, np.nan), np.nan
    ideal = truth.layout.crossings()
    found = np.array(
        [poses.camera.unproject(poses.homographies[i], truth.crossings_px(i)) for i in frames]
    )
    seen = np.isfinite(found[:, :, 0])
    count = np.maximum(seen.sum(axis=0), 1)[:, None]
    mean = np.nan_to_num(found).sum(axis=0) / count
    anywhere = seen.any(axis=0)
    mean[~anywhere] = np.nan
    between = []
    for i, points in zip(frames, found, strict=True):
        jacobian = poses.camera.jacobian(poses.homographies[i], mean)
        error = np.einsum("nij,nj->ni", jacobian, points - mean)
        between.append(np.sqrt(np.nanmean(np.sum(error**2, axis=1))))
    common, _ = cv2.findHomography(ideal[anywhere], mean[anywhere], 0)
    left = cv2.perspectiveTransform(ideal[anywhere][None], common)[0] - mean[anywhere]
    bend = poses.lr_px_per_unit * np.sqrt(np.mean(np.sum(left**2, axis=1)))
    return (float(np.median(between)), float(np.max(between))), float(bend)


def bound(sequence: FrameSequence, poses: Registration, truth: Truth, frames: list[int]) -> float:
    """Cramer-Rao bound of the error between frames, median over the frames."""
    if len(frames) < 4:
        return np.nan
    grid = HrGrid.covering(poses.layout, poses.lr_px_per_unit, 2.0, 0.1)
    halves = []
    for part in (frames[::2], frames[1::2]):
        used = np.zeros(len(poses.used), bool)
        used[part] = True
        halves.append(module_mean(sequence, replace(poses, used=used), grid))
    found = [_bound_of_frame(sequence, poses, truth, grid, halves, i) for i in frames]
    return float(np.median(found) * np.sqrt(1.0 - 1.0 / len(frames)))


def _bound_of_frame(
    sequence: FrameSequence,
    poses: Registration,
    truth: Truth,
    grid: HrGrid,
    halves: list[tuple[NDArray[np.float32], NDArray[np.bool_]]],
    i: int,
) -> float:
    step, shift = 2, 0.25
    frame = sequence.frame(i)
    rows, cols = np.mgrid[0 : frame.image.shape[0] : step, 0 : frame.image.shape[1] : step]
    px = np.stack([cols, rows], axis=-1).astype(np.float64)
    H, gain = poses.homographies[i], float(poses.gain[i])

    def warped(module: NDArray[np.float32], dx: float, dy: float) -> Array:
        at = grid.to_pixels(poses.camera.unproject(H, px + np.array([dx, dy])))
        x, y = np.nan_to_num(at, nan=-1e4).astype(np.float32).transpose(2, 0, 1)
        return cv2.remap(module, x, y, cv2.INTER_CUBIC).astype(np.float64)

    points = poses.camera.unproject(H, px)
    seen = np.isfinite(points[..., 0]) & frame.valid[::step, ::step]
    for _, covered in halves:
        # Half a pixel of margin: the derivative must not see the border of what is covered.
        inner = cv2.erode(covered.astype(np.uint8), np.ones((5, 5), np.uint8), borderValue=0)
        seen &= warped(inner.astype(np.float32), 0, 0) > 0.999
    d_homography = poses.camera.derivatives(H, points[seen]).d_homography
    jacobians = []
    for module, _ in halves:
        value = warped(module, 0, 0)[seen]
        gx = (warped(module, shift, 0) - warped(module, -shift, 0))[seen] / (2 * shift)
        gy = (warped(module, 0, shift) - warped(module, 0, -shift))[seen] / (2 * shift)
        motion = gain * (gx[:, None] * d_homography[:, 0] + gy[:, None] * d_homography[:, 1])
        jacobians.append(np.column_stack([-motion, value, np.ones(len(value))]))
    smooth = cv2.GaussianBlur(frame.image, (0, 0), 2.0)[::step, ::step][seen]
    weight = step**2 / np.square(sequence.noise.sigma(smooth).astype(np.float64))
    first, second = jacobians
    information = first.T @ (weight[:, None] * second)
    information = 0.5 * (information + information.T)
    size = np.sqrt(np.abs(np.diag(information)))
    covariance = np.linalg.inv(information / np.outer(size, size)) / np.outer(size, size)
    inside = np.isfinite(truth.crossings_px(i)[:, 0])
    J = poses.camera.derivatives(H, truth.layout.crossings()[inside]).d_homography
    return float(np.sqrt(np.mean(np.einsum("nip,pq,niq->n", J, covariance[:8, :8], J))))


# ------------------------------------------------------------------------ random sequences

LAYOUTS = (
    *((2, 3, 1.0), (3, 4, 1.0), (4, 4, 1.0), (4, 6, 1.0), (6, 4, 1.0), (5, 8, 1.0), (6, 10, 1.0)),
    *((10, 3, 2.0), (12, 4, 2.0), (6, 3, 2.0), (3, 10, 0.5), (4, 12, 0.5)),
)
"""Rows, columns and cell aspect; 6 x 3 half-cut cells make a square."""


def random_simulation(seed: int, n_frames: int) -> SimulationSettings:
    """Draw a module, a view and a camera; the whole module is in view."""
    rng = np.random.default_rng(seed)
    while True:
        with contextlib.suppress(InspectionError):  # the lens folds this view over: draw again
            return _drawn(rng, seed, n_frames)


def _drawn(rng: np.random.Generator, seed: int, n_frames: int) -> SimulationSettings:
    rows, cols, aspect = LAYOUTS[rng.integers(len(LAYOUTS))]
    wanted = float(np.exp(rng.uniform(np.log(12), np.log(60)))) * max(aspect, 1.0)
    settings = SimulationSettings(
        seed=seed,
        rows=rows,
        cols=cols,
        cell_aspect=aspect,
        wafer=str(rng.choice(["multi", "mono"])),
        busbars=int(rng.integers(2, 7)),
        busbar_style=str(rng.choice(["solid", "dashed"])),
        crack_share=float(rng.uniform(0, 0.6)),
        dark_cell_share=float(rng.uniform(0, 0.05)),
        n_frames=n_frames,
        width=320,
        height=256,
        kappa=float(rng.uniform(-0.35, 0.35)),
        tilt_deg=float(rng.uniform(0, 35)),
        tilt_axis_deg=float(rng.uniform(0, 360)),
        roll_deg=float(rng.uniform(-45, 45)),
        fill=float(rng.uniform(0.78, 0.9)),
        jitter_px=float(rng.uniform(0.5, 3)),
        motion_blur_px=float(rng.choice([0.3, 0.3, 1.0, 2.0]) * rng.random()),
        psf_sigma_px=float(rng.uniform(0.3, 0.7)),
        supersampling=4,
        exposure=float(rng.uniform(0.3, 0.75)),
        full_well_e=float(np.exp(rng.uniform(np.log(3000), np.log(30000)))),
        read_noise_e=float(rng.uniform(10, 80)),
        ambient=float(rng.uniform(0, 0.03)),
        vignetting=float(rng.uniform(0, 0.25)),
        column_offset_e=float(rng.uniform(0, 60)),
    )
    # The focal length goes with the width, so the frame size sets how large the cells come out.
    poses = choose_poses(settings, np.random.default_rng(0))
    camera = Camera(camera_matrix(settings), settings.kappa)
    areas = np.abs(np.linalg.det(camera.jacobian(poses[0].H, settings.layout.crossings())))
    width = float(np.clip(320 * wanted / np.sqrt(areas.mean()), 160, 560))
    ppu = int(np.clip(4 * np.sqrt(areas.mean()) * width / 320, 60, 240))
    settings = replace(settings, width=round(width), height=round(0.8 * width), pixels_per_unit=ppu)
    choose_poses(settings, np.random.default_rng(0))
    return settings


@dataclass(frozen=True)
class Trial:
    """One random sequence: its score, or why there is none."""

    seed: int
    what: str
    score: Score | None
    error: str = ""
    crashed: bool = False

    @property
    def verdict(self) -> str:
        """One of "fine", "announced" and "silent"."""
        if self.score is None:
            return "silent" if self.crashed else "announced"
        if self.score.registered[1] > SILENT_PX:
            return "silent"
        return "fine" if 2 * self.score.used > self.score.frames else "announced"


def trial(seed: int, n_frames: int, settings: Settings) -> Trial:
    """Simulate one random sequence, run the stages on it and judge them."""
    cv2.setNumThreads(1)
    numba.set_num_threads(1)
    made = random_simulation(seed, n_frames)
    simulation = simulated(made)
    truth = Truth(
        made.layout,
        (made.height, made.width),
        Camera(simulation.camera_matrix, made.kappa),
        [pose.H for pose in simulation.poses],
    )
    areas = truth.camera.jacobian(simulation.poses[0].H, made.layout.crossings())
    cell = np.sqrt(np.abs(np.linalg.det(areas)).mean())
    what = (
        f"{made.rows} x {made.cols} aspect {made.cell_aspect:g} {made.wafer} "
        f"{made.busbars} busbars, cells {cell:.0f} x {cell / made.cell_aspect:.0f} px, "
        f"tilt {made.tilt_deg:.0f}, roll {made.roll_deg:.0f}, kappa {made.kappa:+.2f}, "
        f"{made.width} x {made.height}, noise {made.full_well_e:.0f} e / {made.read_noise_e:.0f} e"
    )
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch)
        for name, frame in zip(simulation.frame_names, simulation.frames, strict=True):
            tifffile.imwrite(folder / name, frame)
        layout = {k: asdict(made.layout)[k] for k in ("rows", "cols", "cell_aspect")}
        (folder / "module.json").write_text(json.dumps(layout))
        try:
            return Trial(seed, what, measured(folder, truth, settings, str(seed)))
        except InspectionError as error:
            return Trial(seed, what, None, str(error))
        except Exception as error:  # a crash is a finding of this benchmark, not its end
            return Trial(seed, what, None, f"{type(error).__name__}: {error}", crashed=True)


# ---------------------------------------------------------------------------------- output


def table(scores: list[Score]) -> str:
    """All sequences as text columns."""
    head = ["sequence", "used", "wrongly", "calibrated", "max", "registered", "max", "between"]
    head += ["max", "bound", "ratio", "bend", "kappa/f2 %"]
    head += [f"{stage} s" for stage in STAGES] + ["wall s", "CPU s"]
    lines = [head]
    for s in scores:
        lengths = [*s.calibrated, *s.registered, *s.between, s.bound]
        lines.append(
            [
                s.name,
                f"{s.used}/{s.frames}",
                f"+{s.wrongly_used} -{s.wrongly_rejected}",
                *(f"{v:.4f}" for v in lengths),
                f"{s.ratio:.2f}",
                f"{s.bend:.4f}",
                f"{100 * s.kappa_error:+.2f}",
                *(f"{v:.2f}" for v in s.wall_s),
                f"{sum(s.wall_s):.2f}",
                f"{sum(s.cpu_s):.2f}",
            ]
        )
    widths = [max(len(line[k]) for line in lines) for k in range(len(head))]
    return "\n".join(
        "  ".join(t.rjust(w) for t, w in zip(line, widths, strict=True)) for line in lines
    )


def summary(trials: list[Trial]) -> str:
    """Failure rates, a line per failure, and quantiles of the errors."""
    lines = []
    for t in trials:
        if t.verdict != "fine":
            why = t.error or (
                f"registered {t.score.registered[1]:.2f} px off, {t.score.used} of "
                f"{t.score.frames} frames used"
                if t.score
                else ""
            )
            lines.append(f"{t.verdict:9} --random 1 --seed {t.seed}: {t.what}: {why}")
    n = len(trials)
    for verdict in ("announced", "silent"):
        count = sum(t.verdict == verdict for t in trials)
        lines.append(f"failed, {verdict:9} {count:4} of {n} ({100 * count / n:.1f} %)")
    scores = [t.score for t in trials if t.score is not None and t.verdict == "fine"]
    rejected = sum(s.wrongly_rejected for s in scores)
    total = sum(s.frames for s in scores)
    lines.append(f"frames wrongly rejected in the others: {rejected} of {total}")
    lines.append(
        "Errors of those that did not fail; seeds of the worst three at the end of a line:"
    )
    quantiles = (0.1, 0.5, 0.9, 0.98, 1.0)
    lines.append(f"{'':22}" + "".join(f"{100 * q:>9.0f} %" for q in quantiles))
    rows: dict[str, list[float]] = {
        "calibrated, median": [s.calibrated[0] for s in scores],
        "calibrated, maximum": [s.calibrated[1] for s in scores],
        "registered, median": [s.registered[0] for s in scores],
        "registered, maximum": [s.registered[1] for s in scores],
        "between, median": [s.between[0] for s in scores],
        "between / bound": [s.ratio for s in scores],
        "bend": [s.bend for s in scores],
        "wall s": [sum(s.wall_s) for s in scores],
    }
    for name, values in rows.items():
        finite = [(v, s.name) for v, s in zip(values, scores, strict=True) if np.isfinite(v)]
        if finite:
            found = np.quantile([v for v, _ in finite], quantiles)
            worst = ", ".join(seed for _, seed in sorted(finite, reverse=True)[:3])
            lines.append(f"{name:22}" + "".join(f"{v:11.4f}" for v in found) + f"   {worst}")
    return "\n".join(lines)


def main() -> int:
    """Print the tables; the exit code is 1 if a random sequence failed silently."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("folders", nargs="*", type=Path, metavar="FOLDER")
    parser.add_argument("--model", choices=("camera", "homography"), default="camera")
    parser.add_argument("--random", type=int, default=0, metavar="N", help="random sequences")
    parser.add_argument("--seed", type=int, default=0, help="of the first; then one more each")
    parser.add_argument("--frames", type=int, default=5, help="frames of a random sequence")
    parser.add_argument("--jobs", type=int, default=2, help="processes for random sequences")
    options = parser.parse_args()
    settings = Settings(registration_model=options.model)
    status = 0
    found = [
        sequence
        for folder in options.folders
        for sequence in (
            [folder]
            if (folder / "truth").is_dir()
            else sorted(p.parent for p in folder.glob("*/truth"))
        )
    ]
    if found:
        scores = []
        for k, folder in enumerate(found):
            if k == 0:  # so that loading compiled code is not counted
                measured(folder, Truth.read(folder), settings, folder.name)
            scores.append(measured(folder, Truth.read(folder), settings, folder.name))
            print(f"\r{folder.name}", end="", file=sys.stderr, flush=True)
        print("\r", end="", file=sys.stderr)
        print(table(scores))
    if options.random:
        begun = perf_counter()
        # Spawned, not forked: compiled code that has started its threads does not survive a fork.
        context = multiprocessing.get_context("spawn")
        with ProcessPoolExecutor(options.jobs, mp_context=context) as pool:
            waiting = [
                pool.submit(trial, options.seed + k, options.frames, settings)
                for k in range(options.random)
            ]
            trials = []
            for job in waiting:
                trials.append(job.result())
                if trials[-1].verdict != "fine":
                    print(f"{trials[-1].verdict}: {trials[-1].seed}", file=sys.stderr, flush=True)
        if options.random <= 5:
            print(table([t.score for t in trials if t.score is not None]))
            print("\n".join(f"seed {t.seed}: {t.what}" for t in trials))
        print(summary(trials))
        print(f"{perf_counter() - begun:.0f} s for {options.random} random sequences")
        status = int(any(t.verdict == "silent" for t in trials))
    return status


if __name__ == "__main__":
    sys.exit(main())
