"""Are frames of different modules ever fused? Simulated mixtures and pure sequences.

    python benchmarks/mixed_modules.py [--mixtures 20] [--pure 20] [--first-seed 1000]

Every mixture shows 2 to 5 modules of one make through one camera, in 8 to 24 frames: in blocks, in
turn or at random, with a group of more than half or without one; 4 + 4 frames, single frames of
seven modules, and half of the frames mirrored. The pure sequences vary in layout, wafer, noise,
motion, flicker, dark cells and tilt; some are partly out of view or upside down, one is a single
frame. Constants were chosen on seeds under 1000.

Columns: frames per module; frames used, or that the run was refused; frames of other modules that
are used (must be 0); frames of the module that are left out as another module's (must be 0); that
were lost otherwise (the module was not found in them); processor time of the choice and of all
until the frames are registered.
"""

from __future__ import annotations

import argparse
import tempfile
from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from time import process_time

import numpy as np
import tifffile

from pv_inspect.calibration.calibrate import calibrate
from pv_inspect.common.work import result_of
from pv_inspect.detection.detect import detect
from pv_inspect.errors import InspectionError
from pv_inspect.module_choice.choice import choose_module
from pv_inspect.registration.register import register
from pv_inspect.sequence.sequence import FrameSequence
from pv_inspect.settings import Settings
from pv_inspect.simulate import (
    SimulationSettings,
    mirrored,
    modules_of_one_make,
    simulate_mixture,
    upside_down,
)

LAYOUTS = (
    (6, 10, 1.0),
    (4, 6, 1.0),
    (10, 6, 1.0),
    (20, 6, 2.0),
    (8, 16, 1.0),
    (6, 12, 1.0),
    (5, 5, 1.0),
    (9, 4, 1.0),
)
NOISE = ((20.0, 25000.0), (60.0, 20000.0), (250.0, 12000.0))
"""Read noise and full well, electrons: clean, usual, strong."""


MIRRORED, UPSIDE_DOWN = -1, -2
"""Instead of a module's number: the first module as another one, and as itself."""


@dataclass(frozen=True)
class Case:
    """What a sequence shows, frame by frame: the number of a module or one of the above."""

    name: str
    settings: SimulationSettings
    shown: tuple[int, ...]


def main() -> None:
    """Print one line per sequence and the sums."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--mixtures", type=int, default=20)
    parser.add_argument("--pure", type=int, default=20)
    parser.add_argument("--first-seed", type=int, default=1000)
    parser.add_argument("--no-register", action="store_true", help="stop after the choice")
    arguments = parser.parse_args()
    print(
        f"{'sequence':34s} {'frames':16s} {'used':>8s} {'foreign':>7s} {'left out':>8s} "
        f"{'lost':>4s} {'choice s':>8s} {'all s':>6s}"
    )
    sums: Counter[str] = Counter()
    for number in range(arguments.mixtures):
        sums.update(_report(_mixture(arguments.first_seed + number, number), arguments.no_register))
    for number in range(arguments.pure):
        seed = arguments.first_seed + 500 + number
        sums.update(_report(_pure(seed, number), arguments.no_register))
    print(", ".join(f"{name}: {count}" for name, count in sums.items()))


def _drawn(rng: np.random.Generator, seed: int, *, pure: bool) -> SimulationSettings:
    rows, cols, aspect = LAYOUTS[rng.integers(len(LAYOUTS))]
    read_noise, full_well = NOISE[rng.integers(3)]
    return SimulationSettings(
        seed=seed,
        rows=rows,
        cols=cols,
        cell_aspect=aspect,
        wafer=str(rng.choice(["multi", "mono"])),
        busbars=int(rng.integers(2, 6)),
        busbar_style=str(rng.choice(["solid", "dashed"])),
        crack_share=float(rng.choice([0.0, 0.1, 0.35])),
        dark_cell_share=float(rng.choice([0.0, 0.015, 0.08])) if pure else 0.015,
        pixels_per_unit=100,
        supersampling=3,
        kappa=float(rng.uniform(-0.25, 0.1)),
        tilt_deg=float(rng.uniform(0, 20)),
        tilt_axis_deg=float(rng.uniform(0, 360)),
        roll_deg=float(rng.uniform(-8, 8)),
        fill=float(rng.uniform(0.8, 0.95)),
        jitter_px=float(rng.uniform(1, 5)),
        motion_blur_px=float(rng.choice([0.3, 1.0, 2.0, 4.0])),
        psf_sigma_px=float(rng.uniform(0.4, 0.9)),
        read_noise_e=read_noise,
        full_well_e=full_well,
        flicker=float(rng.choice([0.015, 0.15])),
        vignetting=float(rng.uniform(0, 0.35)),
        exposure=float(rng.uniform(0.25, 0.8)),
        column_offset_e=float(rng.choice([30, 200])),
    )


def _mixture(seed: int, number: int) -> Case:
    rng = np.random.default_rng(seed)
    settings = _drawn(rng, seed, pure=False)
    special = number % 10
    if special == 0:
        return Case("4 + 4 in turn", settings, (0, 1) * 4)
    if special == 1:
        return Case("half mirrored", settings, (0, MIRRORED) * 5)
    if special == 2:
        return Case("3 of 12 mirrored", settings, (0, 0, 0, MIRRORED) * 3)
    if special == 3:
        return Case("one frame each", settings, tuple(range(5)))
    modules, n = int(rng.integers(2, 6)), int(rng.integers(8, 25))
    if special % 2:
        # One module in more than half of the frames.
        most = int(rng.integers(n // 2 + 1, n - modules + 2))
        shown = [0] * most + [1 + k % (modules - 1) for k in range(n - most)]
    else:
        shown = [k % modules for k in range(n)]
    order = ("blocks", "random", "in turn")[int(rng.integers(3))]
    if order == "blocks":
        shown.sort()
    elif order == "random":
        shown = [shown[k] for k in rng.permutation(n)]
    name = f"{modules} modules {order}, {'most' if special % 2 else 'even'}"
    return Case(name, settings, tuple(shown))


def _pure(seed: int, number: int) -> Case:
    rng = np.random.default_rng(seed)
    settings = _drawn(rng, seed, pure=True)
    n = int(rng.integers(2, 21))
    special = number % 5
    if special == 0:
        return Case("some upside down", settings, (0, 0, UPSIDE_DOWN) * 4)
    if special == 1:
        # Some of the frames run over the border.
        values = {**vars(settings), "fill": 0.97, "jitter_px": 8.0, "tilt_deg": 5.0}
        return Case("partly out of view", SimulationSettings(**values), (0,) * 12)
    if number == 2:
        return Case("a single frame", settings, (0,))
    return Case("pure", settings, (0,) * n)


def _report(case: Case, no_register: bool) -> Counter[str]:
    settings = case.settings
    plain = modules_of_one_make(settings, max(k for k in case.shown if k >= 0) + 1)
    scenes = [*plain]
    shown = list(case.shown)
    for variant, make in ((MIRRORED, mirrored), (UPSIDE_DOWN, upside_down)):
        if variant in shown:
            shown = [len(scenes) if k == variant else k for k in shown]
            scenes.append(make(plain[0]))
    simulation = simulate_mixture(settings, scenes, shown)
    truth = np.array([0 if k == UPSIDE_DOWN else k for k in case.shown])
    with tempfile.TemporaryDirectory() as folder:
        for i, frame in enumerate(simulation.frames):
            tifffile.imwrite(Path(folder) / f"frame_{i:03d}.tif", frame)
        outcome = _outcome(Path(folder), settings, no_register)
    counts = Counter(truth.tolist())
    used, foreign, wrongly, lost = "refused", 0, 0, 0
    if outcome.used is not None:
        used = f"{int(outcome.used.sum())}"
        if outcome.used.any():
            chosen = Counter(truth[outcome.used].tolist()).most_common(1)[0][0]
            foreign = int((outcome.used & (truth != chosen)).sum())
            mine = ~outcome.used & (truth == chosen)
            wrongly = int((mine & outcome.as_foreign).sum())
            lost = int((mine & ~outcome.as_foreign).sum())
    layout = f"{settings.rows}x{settings.cols} {settings.wafer}"
    frames = "+".join(str(n) for _, n in sorted(counts.items()))
    print(
        f"{f'{settings.seed} {case.name}, {layout}':34s} {frames:16s} {used:>8s} {foreign:7d} "
        f"{wrongly:8d} {lost:4d} {outcome.choice_seconds:8.2f} {outcome.seconds:6.1f}"
        f"{'  ' + outcome.said if outcome.said else ''}",
        flush=True,
    )
    kind = "mixtures" if len(counts) > 1 else "pure sequences"
    return Counter(
        {
            kind: 1,
            f"{kind} refused": int(used == "refused"),
            "foreign frames used": foreign,
            f"left out wrongly of {kind}": wrongly,
            f"lost of {kind}": lost,
        }
    )


@dataclass(frozen=True, eq=False)
class Outcome:
    """What became of a sequence; ``used`` is None if it was refused."""

    used: np.ndarray | None
    as_foreign: np.ndarray
    choice_seconds: float
    seconds: float
    said: str = ""


def _outcome(folder: Path, made: SimulationSettings, no_register: bool) -> Outcome:
    begun, spent = process_time(), 0.0
    nothing = np.zeros(0, bool)
    try:
        sequence = FrameSequence.open(folder)
        settings = Settings()
        crossings = result_of(detect(sequence, made.layout))
        calibration = calibrate(crossings, sequence.shape, settings)
        before = process_time()
        try:
            choice = choose_module(sequence, calibration, settings)
        finally:
            spent = process_time() - before
        used, why = choice.of_calibration(calibration).used, choice.why
        if not no_register:
            registration = result_of(register(sequence, calibration, settings))
            used, why = registration.used, registration.why
    except InspectionError as error:
        return Outcome(None, nothing, spent, process_time() - begun, str(error)[:60])
    foreign = np.array(["another module" in reason or "same module" in reason for reason in why])
    said = "" if choice.comparable else "can't be compared"
    return Outcome(used, foreign, spent, process_time() - begun, said)


if __name__ == "__main__":
    main()
