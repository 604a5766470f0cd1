"""One photograph, few frames, and frames that stand still: what is made of them.

    python benchmarks/few_frames.py images [--seeds 0 8] [--frames 1 2 4 8] [--prior-weight 0.5]
        [--sigma 0.45]
    python benchmarks/few_frames.py defects [--seeds 0 16]

Simulated modules with their true geometry, at 3x. ``images``: PSNR of the module image beside the
first frame, rectified by bicubic interpolation (both with the slow brightness of the truth); the
darkest value, and the brightest over the brightest valid pixel of the first frame; F1 of coarse
crack masks; cells without a crack that have a class, cells with cracks of 0.1 cell widths or more
that are called clean, and those of all cells that can't be judged.
A case is a number of frames with their motion, or a number that all stand in the same place
("still").
``--prior-weight`` and ``--sigma`` are given to the reconstruction instead of what it finds.
``defects``: hot and dead pixels that deviate by a tenth of full scale and are missed in single
frames, and good pixels that are taken for defects.

Constants were chosen on seeds 0 to 199; seeds from 1000 on are kept for a last look.
"""

from __future__ import annotations

import argparse
import tempfile
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray
from reconstruction import first_frames, true_registration

from pv_inspect.cells import CellTiles
from pv_inspect.common.work import result_of
from pv_inspect.cracks import read_cracks
from pv_inspect.cracks.centreline import branches, length_of
from pv_inspect.cracks.training.scores import coarse_score
from pv_inspect.geometry.grid import HrGrid
from pv_inspect.reconstruction.cell_sight import CellSight
from pv_inspect.reconstruction.reconstruct import reconstruct
from pv_inspect.reconstruction.single_frame import bicubic
from pv_inspect.registration.registration import Registration
from pv_inspect.sequence.sensor import defective_pixels
from pv_inspect.sequence.sequence import FrameSequence
from pv_inspect.settings import Settings
from pv_inspect.simulate import (
    Scene,
    SimulatedSequence,
    SimulationSettings,
    simulated,
    write_sequence,
)
from pv_inspect.simulate.exposure import Sensor

Image = NDArray[np.float32]
Mask = NDArray[np.bool_]

MAGNIFICATION = 3.0
# Side of the blocks of coarse masks, HR px: 4 LR px, as the paper has them at 4x.
BLOCK_PX = 12
# Cells with shorter cracks, cell widths, count as neither cracked nor clean.
_LEAST_CRACK = 0.1


@dataclass(frozen=True)
class Look:
    """What is said of one image of a module."""

    psnr_db: float
    darkest: float
    brightest: float
    probability: Image
    mask: Mask
    threshold: float
    clean: int
    classed: int
    cracked: int
    missed: int
    unsure: int
    cells: int


def drawn(seed: int, n_frames: int, **changes: object) -> SimulationSettings:
    """Draw a small module, a view of it and a camera."""
    rng = np.random.default_rng([1415, seed])
    rows, cols = ((3, 4), (4, 4), (3, 5), (4, 6))[int(rng.integers(4))]
    cell_px = float(rng.uniform(36, 60))
    bits = int(rng.choice([8, 12, 12, 14]))
    values = {
        "seed": seed,
        "rows": rows,
        "cols": cols,
        "n_frames": n_frames,
        "width": int(cell_px * (cols + 0.6)),
        "height": int(cell_px * (rows + 0.6)),
        "wafer": str(rng.choice(["multi", "mono"])),
        "busbars": int(rng.integers(2, 7)),
        "busbar_style": str(rng.choice(["solid", "dashed"])),
        "kappa": float(rng.uniform(-0.25, 0.05)),
        "tilt_deg": float(rng.uniform(0, 15)),
        "tilt_axis_deg": float(rng.uniform(0, 360)),
        "roll_deg": float(rng.uniform(-4, 4)),
        "fill": 0.9,
        "jitter_px": float(rng.uniform(0.5, 3)),
        "psf_sigma_px": float(rng.uniform(0.3, 0.75)),
        "motion_blur_px": float(rng.uniform(0, 0.6)),
        "exposure": float(np.exp(rng.uniform(np.log(0.1), np.log(0.8)))),
        "full_well_e": float(np.exp(rng.uniform(np.log(8e3), np.log(4e4)))),
        "read_noise_e": float(rng.uniform(10, 60)),
        "column_offset_e": float(rng.uniform(0, 60)),
        "pixels_per_unit": 160,
        "supersampling": 4,
        "bit_depth": bits,
        "black_level_dn": 8 if bits == 8 else 64,
    }
    return SimulationSettings(**(values | changes))


def opened(made: SimulatedSequence, folder: Path) -> tuple[FrameSequence, Registration]:
    """Write a sequence and open it, with its true geometry."""
    write_sequence(made, folder)
    return FrameSequence.open(folder), true_registration(made)


def on_grid(values: NDArray[np.floating], scene: Scene, grid: HrGrid) -> NDArray[np.float64]:
    """Means of an image of the scene over the pixels of a grid."""
    step = scene.pixels_per_unit / grid.pixels_per_unit
    found = values.astype(np.float64)
    for axis in (1, 0):  # x, then y after the turn
        at = scene.origin_px[1 - axis] + step * (
            np.arange(grid.shape[axis]) - grid.origin_px[1 - axis]
        )
        total = np.insert(np.cumsum(found, axis=1), 0, 0.0, axis=1)
        ends = np.clip(at + 0.5 + step * np.array([[-0.5], [0.5]]), 0, found.shape[1])
        low = np.minimum(ends.astype(int), found.shape[1] - 1)
        upto = total[:, low] + (total[:, low + 1] - total[:, low]) * (ends - low)
        found = ((upto[:, 1] - upto[:, 0]) / step).T
    return found


def flat_psnr(image: Image, truth: NDArray[np.float64], grid: HrGrid) -> float:
    """PSNR over the module, dB, with the slow brightness of the truth."""
    (x0, y0), (x1, y1) = (
        np.round(grid.to_pixels(np.asarray(at, np.float64)) + 0.5).astype(int)
        for at in ((0, 0), grid.layout.size)
    )
    ours, true = image[y0:y1, x0:x1].astype(np.float64), truth[y0:y1, x0:x1]
    slow = [cv2.GaussianBlur(a, (0, 0), grid.pixels_per_unit / 4) for a in (true, ours)]
    error = ours * slow[0] / np.maximum(slow[1], 1e-3) - true
    return float(10 * np.log10(np.percentile(true, 99.9) ** 2 / np.mean(error**2)))


def length_of_cracks(mask: Mask) -> float:
    """Length of the labelled cracks of a cell along their centre lines, px."""
    return sum(map(length_of, branches(mask))) if mask.any() else 0.0


def looked_at(
    image: Image,
    grid: HrGrid,
    scene: Scene,
    brightest: float,
    support: Image | None = None,
    sight: CellSight | None = None,
) -> Look:
    """Score an image on a grid."""
    truth = on_grid(scene.radiance, scene, grid)
    mask = on_grid(scene.cracks, scene, grid) >= 0.5
    found = result_of(read_cracks(CellTiles(image, grid, support, sight), Settings()))
    true = [length_of_cracks(mask[grid.cell_slices(c.row, c.col)]) for c in found.cells]
    clean = [c for c, length in zip(found.cells, true, strict=True) if not length]
    least = _LEAST_CRACK * grid.pixels_per_unit
    cracked = [c for c, length in zip(found.cells, true, strict=True) if length >= least]
    return Look(
        flat_psnr(image, truth, grid),
        float(image.min()),
        float(image.max()) / brightest,
        found.probability,
        mask,
        found.threshold,
        len(clean),
        sum(c.crack_class in ("A", "B", "C", "unknown") for c in clean),
        len(cracked),
        sum(c.crack_class == "none" for c in cracked),
        sum(c.crack_class == "unsure" for c in found.cells),
        len(found.cells),
    )


def looks(seed: int, counts: list[int], settings: Settings) -> Iterator[tuple[str, str, Look]]:
    """Yield the case, the method and what is said of its image."""
    for still in (False, True):
        of_kind = counts if not still else [max(counts)]
        plan = drawn(seed, max(counts))
        made = simulated(plan.without_motion() if still else plan)
        with tempfile.TemporaryDirectory() as scratch:
            sequence, registration = opened(made, Path(scratch) / "sequence")
            frame = sequence.frame(0)
            top = float((frame.image[frame.valid] / registration.gain[0]).max())
            for count in of_kind:
                some = first_frames(registration, count)
                result = result_of(reconstruct(sequence, some, settings))
                single = bicubic(sequence, some, result.grid, 0)
                case = f"{count}, still" if still else f"{count}"
                yield case, "bicubic", looked_at(single, result.grid, made.scene, top)
                known = result.support, result.sight
                ours = looked_at(result.image, result.grid, made.scene, top, *known)
                yield case, "ours", ours
                print(
                    f"seed {seed}, {case}: sigma {plan.psf_sigma_px:.2f}, found "
                    f"{result.psf_sigma_lr_px:.2f}, lambda {result.prior_weight:.3f}, residual "
                    f"{np.nanmedian(result.residual_rms):.2f}, support "
                    f"{np.median(result.support):.2f}, {ours.psnr_db:.2f} dB",
                    flush=True,
                )


def images(options: argparse.Namespace) -> None:
    """Print what the images of all seeds are worth."""
    settings = Settings(
        magnification=MAGNIFICATION,
        prior_weight=options.prior_weight,
        psf_sigma_lr_px=options.sigma,
    )
    found: dict[tuple[str, str], list[Look]] = {}
    for seed in range(*options.seeds):
        for case, method, look in looks(seed, options.frames, settings):
            found.setdefault((case, method), []).append(look)
    print(
        f"{'frames':<10}{'':<9}{'PSNR':>7}{'worst gain':>12}{'darkest':>9}{'brightest':>11}"
        f"{'crack F1':>10}{'AP':>7}{'clean, classed':>16}{'cracked, clean':>17}{'unsure':>10}"
    )
    for (case, method), some in found.items():
        gains = [
            one.psnr_db - other.psnr_db
            for one, other in zip(some, found[case, "bicubic"], strict=True)
        ]
        pairs = [(look.probability, look.mask) for look in some]
        score = coarse_score(pairs, some[0].threshold, BLOCK_PX)
        psnr = np.mean([look.psnr_db for look in some])
        print(
            f"{case:<10}{method:<9}{psnr:7.2f}{min(gains):12.2f}"
            f"{min(look.darkest for look in some):9.3f}"
            f"{max(look.brightest for look in some):11.2f}{score.f1:10.3f}{score.ap:7.3f}"
            f"{sum(look.classed for look in some):9d} / {sum(look.clean for look in some):<4d}"
            f"{sum(look.missed for look in some):10d} / {sum(look.cracked for look in some):<4d}"
            f"{sum(look.unsure for look in some):6d} / {sum(look.cells for look in some)}"
        )


def defects(options: argparse.Namespace) -> None:
    """Print how many defects of single frames are missed, over the sharpness of the optics."""
    for sigma in (0.3, 0.45, 0.7):
        missed, large, false = 0, 0, 0
        for seed in range(*options.seeds):
            many = {"hot_share": 2e-3, "dead_share": 1e-3, "psf_sigma_px": sigma}
            plan = SimulationSettings(**(asdict(drawn(seed, 1)) | many))
            frame = simulated(plan).frames[:1]
            sensor = Sensor(plan, np.random.default_rng(plan.seed).spawn(4)[2])
            there = sensor.defects
            found = defective_pixels(frame, float(plan.max_dn))
            deviation = frame[0].astype(np.float64) - cv2.medianBlur(frame[0], 3)
            seen = there & (np.abs(deviation) > 0.1 * plan.max_dn)
            missed, large = missed + int((seen & ~found).sum()), large + int(seen.sum())
            false += int((found & ~there).sum())
        print(f"optical sigma {sigma:.2f}: {missed} of {large} missed, {false} false")


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=str(__doc__).splitlines()[0])
    commands = parser.add_subparsers(required=True)
    for name, call in (("images", images), ("defects", defects)):
        command = commands.add_parser(name, help=call.__doc__)
        command.add_argument("--seeds", nargs=2, type=int, default=[0, 8], metavar="SEED")
        command.set_defaults(call=call)
        if name == "images":
            command.add_argument("--frames", nargs="+", type=int, default=[1, 2, 4, 8])
            command.add_argument("--prior-weight", type=float)
            command.add_argument("--sigma", type=float)
    options = parser.parse_args()
    options.call(options)


if __name__ == "__main__":
    main()
