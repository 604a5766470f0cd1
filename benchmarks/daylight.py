"""Sequences by daylight with the current switched on and off, simulated.

    python benchmarks/daylight.py --detector [--seeds 0 60]
    python benchmarks/daylight.py [--seeds 0 6]

The first asks the small pictures of the frames alone whether the current was switched: sequences by
daylight with regular and irregular patterns, and others in which nothing was switched (by daylight;
at night with frames at different exposures, automatic gain, flicker, two modules by turns), where
every detection is false. The second runs sequences by daylight up to the module image (2x), beside
what the same camera takes of the glow alone at night: crossing points (RMS from the truth), PSNR
against the scene, residual in units of the noise.
"""

from __future__ import annotations

import argparse
import tempfile
from collections import Counter
from dataclasses import replace
from pathlib import Path

import cv2
import numba
import numpy as np
import tifffile
from numpy.typing import NDArray

from pv_inspect.errors import InspectionError
from pv_inspect.pipeline import inspect_steps
from pv_inspect.reconstruction.reconstruction import Reconstruction
from pv_inspect.registration.registration import Registration
from pv_inspect.sequence.modulation import LevelPictures, Modulation, find_modulation
from pv_inspect.sequence.sequence import FrameSequence
from pv_inspect.settings import Settings
from pv_inspect.simulate import SimulationSettings, modules_of_one_make, simulate_mixture
from pv_inspect.simulate.daylight import Daylight, SimulatedDaylight, simulate_daylight

SWITCHED = ("on off", "two by two", "irregular", "a frame lost", "neither", "own gain", "clouds")
STEADY = ("day off", "day on", "night", "bracketed", "night own gain", "flicker", "two modules")


def drawn(seed: int, kind: str) -> tuple[SimulationSettings, Daylight]:
    """Draw a module, a camera, a day and a pattern of the current."""
    rng = np.random.default_rng([15, seed, (SWITCHED + STEADY).index(kind)])
    rows, cols, aspect = ((4, 6, 1.0), (6, 10, 1.0), (3, 4, 1.0), (6, 12, 0.5))[rng.integers(4)]
    settings = SimulationSettings(
        seed=seed,
        rows=rows,
        cols=cols,
        cell_aspect=aspect,
        wafer=str(rng.choice(["multi", "mono"])),
        busbars=int(rng.integers(2, 6)),
        crack_share=float(rng.uniform(0, 0.5)),
        dark_cell_share=float(rng.choice([0.0, 0.02, 0.1])),
        kappa=float(rng.uniform(-0.25, 0.1)),
        tilt_deg=float(rng.uniform(0, 20)),
        tilt_axis_deg=float(rng.uniform(0, 360)),
        roll_deg=float(rng.uniform(-10, 10)),
        fill=float(rng.uniform(0.6, 0.92)),
        jitter_px=float(rng.choice([0.5, 1.5, 3.0])),
        motion_blur_px=float(rng.choice([0.2, 1.0])),
        psf_sigma_px=float(rng.uniform(0.35, 0.7)),
        full_well_e=float(np.exp(rng.uniform(np.log(10000), np.log(60000)))),
        read_noise_e=float(rng.uniform(10, 60)),
        flicker=float(rng.choice([0.0, 0.01])),
        column_offset_e=float(rng.uniform(0, 40)),
        exposure=float(rng.uniform(0.5, 0.9)),
        width=320,
        height=256,
        pixels_per_unit=100,
        supersampling=2,
    )
    count = int(rng.integers(8, 17))
    day = Daylight(
        _pattern(kind, count, rng),
        el_share=float(np.exp(rng.uniform(np.log(0.04), np.log(0.4)))),
        level=float(rng.uniform(0.3, 0.6)),
        contrast=float(rng.uniform(0.15, 0.5)),
        glare=float(rng.uniform(0, 0.2)),
        drift=float(rng.uniform(-0.15, 0.15)),
        clouds=float(rng.uniform(0.01, 0.04)) if kind in ("clouds", "day off", "day on") else 0.0,
        auto_gain=1.0 if "own gain" in kind else 0.0,
    )
    return settings, day


def _pattern(kind: str, count: int, rng: np.random.Generator) -> tuple[float, ...]:
    if kind == "day off":
        return (0.0,) * count
    if kind in STEADY:
        return (1.0,) * count
    on = [float((k + int(rng.integers(1)) + 1) % 2) for k in range(count)]
    if kind == "two by two":
        on = [float(k // 2 % 2 == 0) for k in range(count)]
    elif kind == "irregular":
        while not 0.3 <= np.mean(on := [float(v) for v in rng.integers(0, 2, count)]) <= 0.7:
            pass
    elif kind == "a frame lost":
        del on[int(rng.integers(1, count - 1))]
    elif kind == "neither":
        on[int(rng.integers(1, count - 1))] = 0.5
    return tuple(on)


def frames_of(seed: int, kind: str) -> tuple[NDArray[np.uint16], tuple[float, ...]]:
    """Simulate the frames of a kind, and say which current they were taken with."""
    settings, day = drawn(seed, kind)
    if kind in SWITCHED or kind.startswith("day"):
        return simulate_daylight(settings, day).frames, day.current
    rng = np.random.default_rng([16, seed])
    count = len(day.current)
    settings = replace(settings, n_frames=count)
    if kind == "flicker":
        settings = replace(settings, flicker=0.2)
    modules = modules_of_one_make(settings, 2 if kind == "two modules" else 1)
    if kind == "two modules":
        dimmer = replace(modules[1], radiance=np.float32(rng.uniform(0.3, 1)) * modules[1].radiance)
        made = simulate_mixture(settings, (modules[0], dimmer), [k % 2 for k in range(count)])
        return made.frames, day.current
    frames = simulate_mixture(settings, modules, [0] * count).frames.astype(np.float64)
    black, top = settings.black_level_dn, settings.max_dn
    light = frames - black
    if kind == "bracketed":
        light *= np.array([(1.0, 0.1)[k % 2] for k in range(count)])[:, None, None]
    elif kind == "night own gain":
        light *= (light.mean() / light.mean(axis=(1, 2)))[:, None, None]
    return np.clip(np.rint(light + black), 0, top).astype(np.uint16), day.current


def asked(frames: NDArray[np.uint16]) -> Modulation | None:
    """Ask the detector."""
    pictures = LevelPictures()
    for frame in frames:
        pictures.add(frame)
    return find_modulation(pictures.of(range(len(frames))), wanted=True)


def _answer(found: Modulation | None, current: tuple[float, ...], kind: str) -> str:
    if kind in STEADY:
        return "none" if found is None else "found" if found.certain else "if asked"
    if found is None:
        return "missed"
    wrong = sum(
        state is not None and float(state) != on
        for state, on in zip(found.current, current, strict=True)
    )
    lost = sum(
        state is None and on in (0.0, 1.0) for state, on in zip(found.current, current, strict=True)
    )
    how = "found" if found.certain else "if asked"
    return f"{how}, {'wrong' if wrong else 'some lost' if lost else 'right'}"


def detector(seeds: range) -> int:
    """Print how often the switching is found where it is, and where it is not."""
    false = 0
    for kind in SWITCHED + STEADY:
        count: Counter[str] = Counter()
        for seed in seeds:
            frames, current = frames_of(seed, kind)
            found = asked(frames)
            answer = _answer(found, current, kind)
            count[answer] += 1
            if answer == "found" or "wrong" in answer:
                assert found is not None
                states = "".join("?" if s is None else str(int(s)) for s in found.current)
                print(
                    f"  {kind} {seed}: {answer}: {states} of {current}, share {found.share:.3f}, "
                    f"clearness {found.clearness:.1f}, area {found.region.mean():.2f}",
                    flush=True,
                )
        false += count["found"] if kind in STEADY else 0
        print(f"{kind:15}", ", ".join(f"{k} {v}" for k, v in count.most_common()), flush=True)
    return false


def end_to_end(seeds: range) -> None:
    """Run sequences by daylight up to the module image, and the same frames at night."""
    cv2.setNumThreads(1)
    numba.set_num_threads(1)
    for seed in seeds:
        kind = ("on off", "irregular", "own gain")[seed % 3]
        settings, day = drawn(seed, kind)
        settings = replace(settings, rows=4, cols=6, cell_aspect=1.0)
        made = simulate_daylight(settings, day)
        night = np.array([f for f, on in zip(made.night, day.current, strict=True) if on == 1.0])
        numbers = [
            _figures(made, made.frames, True),
            _figures(with_current(made), night, False),
        ]
        print(
            f"{seed:4d} {kind:10} glow {day.el_share:.3f} jitter {settings.jitter_px:.1f} px  "
            + "   ".join(numbers),
            flush=True,
        )


def with_current(made: SimulatedDaylight) -> SimulatedDaylight:
    """Return what is known of the frames with current alone."""
    poses = tuple(
        pose for pose, on in zip(made.poses, made.daylight.current, strict=True) if on == 1.0
    )
    return replace(made, poses=poses)


def _figures(made: SimulatedDaylight, frames: NDArray[np.uint16], lock_in: bool) -> str:
    """Run frames; return crossing RMS, PSNR of the module image and residual in words."""
    name = "lock-in" if lock_in else "night"
    with tempfile.TemporaryDirectory() as scratch:
        for k, frame in enumerate(frames):
            tifffile.imwrite(Path(scratch) / f"f_{k:03d}.tif", frame)
        layout = made.scene.layout
        given = Settings(
            rows=layout.rows, cols=layout.cols, magnification=2, max_iterations=60, lock_in=lock_in
        )
        made_of: dict[str, object] = {}
        try:
            opened = FrameSequence.open(Path(scratch), lock_in=lock_in)
            steps = inspect_steps(opened, given)
            for step in steps:
                made_of[type(step.partial).__name__] = step.partial
                if isinstance(step.partial, Reconstruction):
                    break
            steps.close()
        except InspectionError as error:
            return f"{name}: {error}"
    registration, result = made_of["Registration"], made_of["Reconstruction"]
    assert isinstance(registration, Registration)
    assert isinstance(result, Reconstruction)
    used = np.flatnonzero(registration.used)
    errors = [
        min(
            float(np.square(points - made.crossings_px(int(i))).sum(1).mean())
            for points in (found, found[::-1])
        )
        for i in used
        for found in [registration.crossings_px(int(i))]
    ]
    return (
        f"{name}: {len(used)} of {len(frames)} used, {np.sqrt(np.mean(errors)):.3f} px, "
        f"{_psnr(made, result):.1f} dB, residual {np.nanmedian(result.residual_rms):.2f}"
    )


def _psnr(made: SimulatedDaylight, result: Reconstruction) -> float:
    """PSNR against the scene at the pixels of the module image, after the best gain and offset."""
    grid, scene = result.grid, made.scene
    width, height = scene.layout.size
    y, x = np.mgrid[: grid.shape[0], : grid.shape[1]].astype(np.float64)
    points = grid.to_module(np.stack([x, y], axis=-1))
    inside = (points > 0).all(-1) & (points[..., 0] < width) & (points[..., 1] < height)
    pixel = scene.pixels_per_unit / grid.pixels_per_cell[0]
    soft = cv2.GaussianBlur(scene.radiance, (0, 0), 0.5 * pixel)
    at = (points * scene.pixels_per_unit + np.array(scene.origin_px)).astype(np.float32)
    best = -np.inf
    for true in (soft, np.ascontiguousarray(soft[::-1, ::-1])):
        truth = cv2.remap(true, at[..., 0], at[..., 1], cv2.INTER_LINEAR)[inside]
        image = result.image[inside].astype(np.float64)
        gain, offset = np.polyfit(image, truth, 1)
        mse = float(np.mean(np.square(gain * image + offset - truth)))
        best = max(best, 10 * np.log10(float(np.percentile(truth, 99.9)) ** 2 / mse))
    return best


def main() -> int:
    """Print the table; the exit code is 1 if something was found that is not there."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--detector", action="store_true")
    parser.add_argument("--seeds", nargs=2, type=int, default=None, metavar=("FIRST", "END"))
    args = parser.parse_args()
    if args.detector:
        return int(detector(range(*(args.seeds or (0, 60)))) > 0)
    end_to_end(range(*(args.seeds or (0, 6))))
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
