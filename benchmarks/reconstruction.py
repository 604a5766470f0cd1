"""Speed, memory and quality of the reconstruction, the registration being given.

    python benchmarks/reconstruction.py speed SEQUENCE... [--magnification 4]
    python benchmarks/reconstruction.py growth
    python benchmarks/reconstruction.py preview SEQUENCE...
    python benchmarks/reconstruction.py frames SEQUENCE... --score SCORER
    python benchmarks/reconstruction.py lambda SEQUENCE... --score SCORER
    python benchmarks/reconstruction.py magnification SEQUENCE... --score SCORER

``speed``: wall and CPU seconds, peak memory of a process that does nothing else. ``growth``: the
same over the number of frames, the magnification and the size of the module, on simulated
sequences with their true geometry. ``preview``: one cell, first and after changes. ``frames``: PSNR
over the number of frames. ``lambda``: PSNR over lambda beside the automatic choice.
``magnification``: gain over one bicubic frame at
3x and 4x. The last three need the truth and score_sequence.py. Compiled code is cached before
anything is timed.
"""

from __future__ import annotations

import argparse
import importlib.util
import json
import multiprocessing
import resource
import sys
import tempfile
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from time import perf_counter, process_time
from typing import Any, TypeVar

import numpy as np
import tifffile

from pv_inspect.calibration.calibrate import calibrate
from pv_inspect.common.work import result_of
from pv_inspect.detection.detect import detect
from pv_inspect.geometry.camera import Camera
from pv_inspect.reconstruction.preview import Preview, Region
from pv_inspect.reconstruction.reconstruct import reconstruct
from pv_inspect.reconstruction.reconstruction import Reconstruction
from pv_inspect.reconstruction.single_frame import bicubic
from pv_inspect.registration.register import register
from pv_inspect.registration.registration import Registration
from pv_inspect.sequence.sequence import FrameSequence
from pv_inspect.settings import Settings
from pv_inspect.simulate import SimulationSettings, simulated, write_sequence

T = TypeVar("T")
MIB_PER_MAXRSS = 2.0**-20 if sys.platform == "darwin" else 2.0**-10


@dataclass(frozen=True)
class Cost:
    """What one reconstruction took."""

    wall_s: float
    cpu_s: float
    peak_mib: float
    mpx: float
    iterations: int
    converged: bool


def registered(folder: Path) -> tuple[FrameSequence, Registration]:
    """Open a sequence and register it with the default settings."""
    sequence, settings = FrameSequence.open(folder), Settings()
    crossings = result_of(detect(sequence, sequence.layout(settings)))
    calibration = calibrate(crossings, sequence.shape, settings)
    return sequence, result_of(register(sequence, calibration, settings))


def cost_of(folder: Path, registration: Registration, settings: Settings) -> Cost:
    """Reconstruct in this process and say what it took."""
    sequence = FrameSequence.open(folder)
    wall, cpu = perf_counter(), process_time()
    made = result_of(reconstruct(sequence, registration, settings))
    wall, cpu = perf_counter() - wall, process_time() - cpu
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * MIB_PER_MAXRSS
    return Cost(wall, cpu, peak, made.image.size / 1e6, made.iterations, made.converged)


def alone(function: Callable[[], T]) -> T:
    """Call a function in a fresh process, so that its peak memory is its own."""
    with multiprocessing.get_context("spawn").Pool(1) as pool:
        return pool.apply(function)


def print_cost(name: str, cost: Cost) -> None:
    """One line of the tables of costs."""
    print(
        f"{name:24} {cost.mpx:5.2f} {cost.wall_s:7.2f} {cost.cpu_s:7.2f} {cost.peak_mib:8.0f} "
        f"{cost.iterations:6d} {cost.converged!s}",
        flush=True,
    )


COST_HEAD = f"{'':24} {'Mpx':>5} {'wall s':>7} {'CPU s':>7} {'peak MiB':>8} {'steps':>6} converged"


def speed(options: argparse.Namespace) -> None:
    """Print what every sequence costs."""
    print(COST_HEAD)
    settings = Settings(magnification=options.magnification)
    for folder in options.sequences:
        _, registration = registered(folder)
        print_cost(folder.name, alone(partial(cost_of, folder, registration, settings)))


def growth(_: argparse.Namespace) -> None:
    """Print how the cost grows with frames, magnification and size."""
    print(COST_HEAD)
    with tempfile.TemporaryDirectory() as scratch:
        for rows, cols in ((3, 4), (6, 10), (10, 12)):
            folder = Path(scratch) / f"{rows}x{cols}"
            n = 40 if (rows, cols) == (6, 10) else 20
            # Cells of one size: the module, not the cells, becomes larger.
            simulation = SimulationSettings(
                rows=rows, cols=cols, n_frames=n, supersampling=3, width=56 * cols, height=64 * rows
            )
            made = simulated(simulation)
            write_sequence(made, folder)
            registration = true_registration(made)
            measure = partial(_limited_cost, folder, registration)
            if n == 20:
                print_cost(f"{rows} x {cols} cells", alone(partial(measure, 20, 4.0)))
                continue
            for frames in (5, 10, 20, 40):
                print_cost(f"6 x 10, {frames} frames", alone(partial(measure, frames, 4.0)))
            for magnification in (2.0, 3.0, 5.0):
                name = f"6 x 10, {magnification:g}x"
                print_cost(name, alone(partial(measure, 20, magnification)))


def _limited_cost(
    folder: Path, registration: Registration, frames: int, magnification: float
) -> Cost:
    return cost_of(
        folder, first_frames(registration, frames), Settings(magnification=magnification)
    )


def first_frames(registration: Registration, count: int) -> Registration:
    """Use only the first frames of those in use."""
    used = registration.used & (np.cumsum(registration.used) <= count)
    why = tuple(w if u or w else "left out" for w, u in zip(registration.why, used, strict=True))
    return replace(registration, used=used, why=why)


def true_registration(made: Any) -> Registration:
    """Geometry of a simulated sequence."""
    n = len(made.poses)
    return Registration(
        made.scene.layout,
        Camera(made.camera_matrix, made.settings.kappa),
        np.array([pose.H for pose in made.poses]),
        np.ones(n, bool),
        ("",) * n,
        np.array([pose.gain for pose in made.poses]),
        np.zeros(n),
        np.ones(n),
    )


def preview(options: argparse.Namespace) -> None:
    """Print the latency of one cell: median and 95th percentile of 20, ms."""
    print(f"{'ms, median / 95 %':14} {'first':>14} {'lambda':>14} {'PSF':>14}")
    for folder in options.sequences:
        sequence, registration = registered(folder)
        whole = result_of(reconstruct(sequence, registration, Settings()))
        layout = registration.layout
        rng = np.random.default_rng(0)
        view = Preview(sequence, registration, whole)
        view.show(Region(0, 0), Settings())
        first, weight, psf = [], [], []
        for _ in range(20):
            region = Region(int(rng.integers(layout.rows)), int(rng.integers(layout.cols)))
            fresh = Preview(sequence, registration, whole)
            first.append(_timed(fresh, region, Settings()))
            other = whole.prior_weight * float(rng.uniform(0.7, 1.4))
            weight.append(_timed(fresh, region, Settings(prior_weight=other)))
            sigma = whole.psf_sigma_lr_px * float(rng.uniform(0.9, 1.1))
            psf.append(_timed(fresh, region, Settings(prior_weight=other, psf_sigma_lr_px=sigma)))
        columns = [
            f"{np.median(v):6.0f} /{np.percentile(v, 95):6.0f}" for v in (first, weight, psf)
        ]
        print(f"{folder.name:14}     {'  '.join(columns)}", flush=True)


def _timed(view: Preview, region: Region, settings: Settings) -> float:
    begun = perf_counter()
    view.show(region, settings)
    return 1e3 * (perf_counter() - begun)


def frames(options: argparse.Namespace) -> None:
    """Print PSNR over the number of frames."""
    score = scorer(options.score)
    print(f"{'flat PSNR, dB':14}" + "".join(f" {n:>3} frames" for n in (5, 10, 20)))
    for folder in options.sequences:
        sequence, registration = registered(folder)
        found = [
            score(folder, registration, result_of(reconstruct(sequence, some, Settings())))
            for some in (first_frames(registration, n) for n in (5, 10, 20))
        ]
        print(f"{folder.name:14}" + "".join(f" {f:10.2f}" for f in found), flush=True)


def prior_weights(options: argparse.Namespace) -> None:
    """Print PSNR over lambda, as multiples of the automatic one."""
    score = scorer(options.score)
    factors = (0.25, 0.5, 1.0, 2.0, 4.0)
    head = "".join(f" {f:>6g}x" for f in factors)
    print(f"{'flat PSNR, dB':14} {'lambda':>7} {'auto':>7}{head}  best - auto")
    for folder in options.sequences:
        sequence, registration = registered(folder)
        made = result_of(reconstruct(sequence, registration, Settings()))
        auto = score(folder, registration, made)
        fixed = Settings(psf_sigma_lr_px=made.psf_sigma_lr_px)
        found = [
            score(
                folder,
                registration,
                result_of(
                    reconstruct(
                        sequence, registration, fixed.changed(prior_weight=f * made.prior_weight)
                    )
                ),
            )
            for f in factors
        ]
        columns = "".join(f" {f:7.2f}" for f in found)
        print(
            f"{folder.name:14} {made.prior_weight:7.3f} {auto:7.2f}{columns} "
            f"{max(found) - auto:8.2f}",
            flush=True,
        )


def magnifications(options: argparse.Namespace) -> None:
    """Print PSNR at 3x and 4x beside one frame, rectified with our geometry."""
    score = scorer(options.score)
    print(f"{'flat PSNR, dB':14} {'':>4} {'bicubic':>8} {'ours':>8} {'gain':>8}")
    for folder in options.sequences:
        sequence, registration = registered(folder)
        first = int(np.flatnonzero(registration.used)[0])
        for magnification in (3.0, 4.0):
            settings = Settings(magnification=magnification)
            made = result_of(reconstruct(sequence, registration, settings))
            single = replace(made, image=bicubic(sequence, registration, made.grid, first))
            before, after = (score(folder, registration, one) for one in (single, made))
            print(
                f"{folder.name:14} {magnification:3g}x {before:8.2f} {after:8.2f} "
                f"{after - before:8.2f}",
                flush=True,
            )


def scorer(path: Path) -> Callable[[Path, Registration, Reconstruction], float]:
    """Flat PSNR of a reconstruction, by score_sequence.py."""
    spec = importlib.util.spec_from_file_location("score_sequence", path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)

    def score(folder: Path, registration: Registration, made: Reconstruction) -> float:
        files = FrameSequence.open(folder).names
        listed = [
            {"file": name, "used": True, "crossings_px": registration.crossings_px(i).tolist()}
            for i, name in enumerate(files)
            if registration.used[i]
        ]
        with tempfile.TemporaryDirectory() as out:
            tifffile.imwrite(Path(out) / "module_hr.tif", made.image)
            record = {**made.grid.to_dict(), "frames": listed}
            (Path(out) / "result.json").write_text(json.dumps(record), encoding="utf-8")
            return float(module.score(str(folder), out)["hr"]["aligned_flat"]["psnr_db"])

    return score


def main() -> None:
    """Choose what to measure."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    commands = parser.add_subparsers(required=True)
    tasks = {
        "speed": speed,
        "growth": growth,
        "preview": preview,
        "frames": frames,
        "lambda": prior_weights,
        "magnification": magnifications,
    }
    for name, task in tasks.items():
        command = commands.add_parser(name)
        command.set_defaults(task=task)
        if name != "growth":
            command.add_argument("sequences", nargs="+", type=Path, metavar="SEQUENCE")
        if name == "speed":
            command.add_argument("--magnification", type=float, default=4.0)
        if name in ("frames", "lambda", "magnification"):
            command.add_argument("--score", type=Path, required=True, metavar="SCORER")
    options = parser.parse_args()
    options.task(options)


if __name__ == "__main__":
    main()
