"""Which cells can be judged: what is found of cracks over what could be seen of the cells.

    python benchmarks/judged_cells.py CELLS [--part train] [--seeds 200 219]

CELLS holds train/ and val/, labelled cells. Small modules of them, half of the cells cracked, are
photographed 1 to 20 times by a simulated camera: 26 to 150 px per cell, in focus or not, moved or
not, from dim to overexposed, and reconstructed with their true geometry. Printed are, of the cells
that the rule (`pv_inspect.cracks.seen`) and other bounds let be judged: cells with at least 0.1
cell widths of labelled cracks that are suspected or called clean, the latter also of those whose
cracks the detector finds in the sharp picture of the cell; clean cells that are suspected; and how
many of those called clean have cracks. ``support map`` is the rule before: support over 0.1.

The bounds were chosen with ``--part train`` (seeds 0 to 78, when detail was a mean over the cell,
and 200 to 218); ``--part val --seeds 2000 2070`` was kept and looked at once.
"""

from __future__ import annotations

import argparse
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import cv2
import numpy as np
from few_frames import opened
from numpy.typing import NDArray

from pv_inspect.cells import cut_cells
from pv_inspect.common.work import result_of
from pv_inspect.cracks import NetworkDetector, measure_cell, read_cracks
from pv_inspect.cracks.centreline import branches, length_of
from pv_inspect.cracks.features import CellFeatures
from pv_inspect.cracks.seen import LEAST_DETAIL, MOST_BLUR
from pv_inspect.cracks.training.labelled import LabelledCell, read_labelled
from pv_inspect.reconstruction.reconstruct import reconstruct
from pv_inspect.settings import Settings
from pv_inspect.simulate import Scene, SimulationSettings, simulated
from pv_inspect.simulate.scene import scene_grid

Image = NDArray[np.float32]

_PPU = 256
# A pixel of the smaller label belongs to a crack from this share on, as in training.
_CRACK_SHARE = 0.35
_LEAST_CRACK = 0.1


@dataclass(frozen=True)
class Judged:
    """One cell: what is true, what was seen and what was found."""

    seed: int
    frames: int
    crack_cells: float
    found_when_sharp: bool
    support: float
    cell: CellFeatures

    @property
    def answer(self) -> str:
        """What would be said if every cell could be judged."""
        if self.cell.dark:
            return "dark"
        if self.cell.weak_marks or self.cell.unfamiliar:
            return "open"
        return "suspected" if self.cell.has_marks else "clean"


def drawn(seed: int) -> tuple[SimulationSettings, np.random.Generator]:
    """Draw a small module, a camera and a number of frames."""
    rng = np.random.default_rng([171, seed])
    frames = int(rng.choice([1, 1, 1, 2, 4, 8, 20]))
    cell_px = float(np.exp(rng.uniform(np.log(26), np.log(150))))
    rows, cols = (3, 4) if cell_px < 85 else (2, 4)
    bits = int(rng.choice([8, 12, 12, 14]))
    in_focus = rng.random() < 0.6
    sigma = float(np.exp(rng.uniform(*np.log([0.3, 0.7] if in_focus else [0.6, 3.0]))))
    motion = float(rng.uniform(0, 0.7)) if rng.random() < 0.8 else float(rng.uniform(1, 5))
    plan = SimulationSettings(
        seed=seed,
        rows=rows,
        cols=cols,
        n_frames=frames,
        width=int(cell_px * (cols + 0.6)),
        height=int(cell_px * (rows + 0.6)),
        kappa=float(rng.uniform(-0.25, 0.05)),
        tilt_deg=float(rng.uniform(0, 15)),
        tilt_axis_deg=float(rng.uniform(0, 360)),
        roll_deg=float(rng.uniform(-4, 4)),
        fill=0.92,
        jitter_px=float(rng.uniform(0.5, 3)),
        psf_sigma_px=sigma,
        motion_blur_px=motion,
        exposure=(
            float(np.exp(rng.uniform(np.log(0.02), np.log(0.9))))
            if rng.random() < 0.85
            else float(rng.uniform(0.9, 2))
        ),
        full_well_e=float(np.exp(rng.uniform(np.log(8e3), np.log(4e4)))),
        read_noise_e=float(rng.uniform(10, 80)),
        column_offset_e=float(rng.uniform(0, 60)),
        pixels_per_unit=_PPU,
        supersampling=4 if cell_px < 60 else 3,
        bit_depth=bits,
        black_level_dn=8 if bits == 8 else 64,
    )
    return plan, rng


def mosaic(
    plan: SimulationSettings, cells: list[LabelledCell], rng: np.random.Generator
) -> tuple[Scene, list[tuple[LabelledCell, float]]]:
    """Put labelled cells together, half of them cracked: the scene, and each with its cracks."""
    layout = plan.layout
    shape, origin = scene_grid(layout, _PPU)
    radiance, mask = np.full(shape, 0.04, np.float32), np.zeros(shape, bool)
    cracked = [cell for cell in cells if cell.crack.any()]
    clean = [cell for cell in cells if not cell.crack.any()]
    rng.integers(2, size=2)
    chosen = []
    for row, col in np.ndindex(layout.rows, layout.cols):
        pool = cracked if rng.random() < 0.5 else clean
        cell = pool[int(rng.integers(len(pool)))]
        image = _sharp(cell)
        share = cv2.resize(
            cell.crack.astype(np.float32), (_PPU, _PPU), interpolation=cv2.INTER_AREA
        )
        a, b = 1 - 2 * rng.integers(2, size=2)
        image, crack = image[::a, ::b], (share >= _CRACK_SHARE)[::a, ::b]
        gain = 0.85 / np.percentile(image, 95) * float(np.exp(rng.normal(0, 0.08)))
        y, x = (round(origin + 0.5) + k * _PPU for k in (row, col))
        radiance[y : y + _PPU, x : x + _PPU] = image * np.float32(gain)
        mask[y : y + _PPU, x : x + _PPU] = crack
        chosen.append((cell, sum(map(length_of, branches(crack))) / _PPU if crack.any() else 0.0))
    return Scene(layout, _PPU, (origin, origin), radiance, mask), chosen


def _sharp(cell: LabelledCell) -> Image:
    small = cv2.resize(cell.image, (_PPU, _PPU), interpolation=cv2.INTER_AREA)
    return np.asarray(small, np.float32) / np.float32(255)


def found_when_sharp(detector: NetworkDetector, cell: LabelledCell) -> bool:
    """Whether the detector finds cracks in the picture of a labelled cell as it is."""
    image, point = _sharp(cell), detector.operating_point
    features = measure_cell(
        image,
        detector.probability(image),
        point.threshold,
        row=0,
        col=0,
        cell_width_px=_PPU,
        usual_intensity=float(np.median(image)),
        least_extent_cells=point.least_extent_cells,
        least_length_cells=point.least_length_cells,
        least_score=point.least_score,
    )
    return features.has_marks and not features.weak_marks


def judged(cells: list[LabelledCell], seed: int, detector: NetworkDetector) -> Iterator[Judged]:
    """Simulate, reconstruct and read one module."""
    plan, rng = drawn(seed)
    scene, chosen = mosaic(plan, cells, rng)
    cell_px = plan.width / (plan.cols + 0.6)
    magnification = 3.0 if cell_px < 60 else 2.0 if cell_px < 100 else 1.5
    with tempfile.TemporaryDirectory() as scratch:
        sequence, registration = opened(simulated(plan, scene), Path(scratch) / "sequence")
        settings = Settings(magnification=magnification)
        made = result_of(reconstruct(sequence, registration, settings))
    read = result_of(read_cracks(cut_cells(made), Settings(), detector))
    for (labelled, length), cell in zip(chosen, read.cells, strict=True):
        sharp = length > 0 and found_when_sharp(detector, labelled)
        support = float(np.median(made.support[made.grid.cell_slices(cell.row, cell.col)]))
        yield Judged(seed, plan.n_frames, length, sharp, support, cell)
    blur = np.median([cell.edge_blur for cell in read.cells])
    detail = np.median([cell.crack_detail for cell in read.cells])
    print(
        f"seed {seed}: {plan.n_frames} frames, {cell_px:.0f} px per cell, sigma "
        f"{plan.psf_sigma_px:.2f}, motion {plan.motion_blur_px:.1f}, exposure {plan.exposure:.2f}; "
        f"detail {detail:.2f}, blur {blur:.4f}",
        flush=True,
    )


def line(name: str, cells: list[Judged]) -> str:
    """One line of the table."""
    cracked = [c for c in cells if c.crack_cells >= _LEAST_CRACK]
    sharp = [c for c in cracked if c.found_when_sharp]
    clean = [c for c in cells if c.crack_cells == 0]

    def share(some: list[Judged], answer: str) -> str:
        return f"{np.mean([c.answer == answer for c in some]):.3f}" if some else "-"

    called_clean = [c for c in [*cracked, *clean] if c.answer == "clean"]
    missed = sum(c.crack_cells > 0 for c in called_clean)
    return (
        f"{name:<26}{len(cracked):>8}{share(cracked, 'suspected'):>8}{share(cracked, 'clean'):>8}"
        f"{len(sharp):>8}{share(sharp, 'clean'):>8}{len(clean):>8}{share(clean, 'suspected'):>8}"
        f"{missed:>8} / {len(called_clean)}"
    )


def table(cells: list[Judged]) -> Iterator[str]:
    """Yield the lines of the table."""
    yield (
        f"{'':<26}{'cracked':>8}{'found':>8}{'clean':>8}{'sharp':>8}{'clean':>8}{'clean':>8}"
        f"{'alarm':>8}   cracked of called clean"
    )
    yield line("all", cells)
    rule = [c for c in cells if c.cell.supported]
    yield line("rule", rule)
    for frames in ((1,), (2, 4), (8, 20)):
        some = [c for c in cells if c.frames in frames]
        name = " or ".join(map(str, frames)) + " frames, "
        yield line(name + "all", some)
        yield line(name + "rule", [c for c in some if c.cell.supported])
        yield line(name + "support map", [c for c in some if c.support >= 0.1])
    for low, high in pairwise((0.0, 0.2, 0.4, LEAST_DETAIL, 0.8, 1.01)):
        some = [c for c in cells if c.cell.edge_blur <= MOST_BLUR]
        some = [c for c in some if low <= c.cell.crack_detail < high]
        yield line(f"sharp, detail {low:g} to {high:g}", some)
    for low, high in pairwise((0.0, 0.008, 0.01, 0.013, MOST_BLUR, 0.02, 0.03, 1.0)):
        some = [c for c in cells if c.cell.crack_detail >= LEAST_DETAIL]
        some = [c for c in some if low <= c.cell.edge_blur < high]
        yield line(f"detail, blur {low:g} to {high:g}", some)


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=str(__doc__).splitlines()[0])
    parser.add_argument("cells", type=Path, metavar="CELLS")
    parser.add_argument("--part", choices=["train", "val"], default="train")
    parser.add_argument("--seeds", nargs=2, type=int, default=[200, 219], metavar="SEED")
    options = parser.parse_args()
    cells, detector = read_labelled(options.cells / options.part), NetworkDetector()
    found = [one for seed in range(*options.seeds) for one in judged(cells, seed, detector)]
    print("\n".join(table(found)))


if __name__ == "__main__":
    main()
