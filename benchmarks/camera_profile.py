"""A camera profile pooled from simulated sequences of one camera, against the truth.

    python benchmarks/camera_profile.py [--cameras 1] [--sequences 10] [--first 0] [--images]
        [--keep FOLDER]

Each camera is drawn by `psf_draws.py` (its blur, lens, sensor and vignetting) and photographs as
many modules: layout, scene, flight and motion differ. Every sequence is run to its result folder
at 2x, the results are pooled as ``pv-inspect calibrate`` does. Printed are the errors of the blur,
one by one and pooled, of kappa / f^2 (as displacement in the corner of the frame), of the
vignetting, the columns and the defective pixels; with ``--images`` also what each image loses
against the true blur, without the profile and with one of the other sequences.
"""

from __future__ import annotations

import argparse
import json
import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np
from psf_draws import drawn
from psf_truth import psnr

from pv_inspect.calibration.camera_profile import write_profile
from pv_inspect.inspection.inspection import Inspection
from pv_inspect.photometry.fixed_pattern import without_slow_columns
from pv_inspect.pipeline import inspect, inspect_steps
from pv_inspect.reconstruction.reconstruction import Reconstruction
from pv_inspect.results.camera_evidence import pooled_profile
from pv_inspect.results.folder import RESULT_JSON
from pv_inspect.results.read import read_result
from pv_inspect.results.resume import resume
from pv_inspect.results.write import write_result
from pv_inspect.sequence.sequence import FrameSequence
from pv_inspect.settings import Settings
from pv_inspect.simulate import SimulationSettings, reserve_sequence, simulated, write_sequence
from pv_inspect.simulate.exposure import Sensor

OF_THE_CAMERA = (
    "focal_length_px", "kappa", "psf_sigma_px", "psf_shape", "vignetting", "full_well_e",
    "read_noise_e", "column_gain", "column_offset_e",
)  # fmt: skip


PLAIN = Settings(magnification=2.0)


def sequence_of(camera: SimulationSettings, seed: int) -> SimulationSettings:
    """Draw a module and a flight for a camera; about one camera of three moves by pixels."""
    of_camera = {name: getattr(camera, name) for name in OF_THE_CAMERA}
    return replace(drawn(seed), sensor_seed=camera.seed, **of_camera)


def image_with(settings: Settings, start: Inspection) -> Reconstruction:
    """Return the module image that other settings make, as far as they change it."""
    for step in inspect_steps(start.frames, settings, start):
        if isinstance(step.partial, Reconstruction):
            return step.partial
    raise SystemExit("no image")


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--cameras", type=int, default=1)
    parser.add_argument("--sequences", type=int, default=10)
    parser.add_argument("--first", type=int, default=0, help="number of the first camera")
    parser.add_argument("--images", action="store_true")
    parser.add_argument("--keep", type=Path, help="folder that sequences and results stay in")
    args = parser.parse_args()
    for number in range(args.first, args.first + args.cameras):
        with tempfile.TemporaryDirectory() as scratch:
            place = Path(scratch) if args.keep is None else args.keep / f"camera_{number}"
            camera(number, args.sequences, args.images, place)


def camera(number: int, count: int, images: bool, scratch: Path) -> None:
    """Print what comes of one camera."""
    true = drawn(1000 + number)
    sigma = true.psf_sigma_px
    print(f"camera {number}: sigma {sigma:.3f} {true.psf_shape}, kappa {true.kappa:+.4f}")
    results, runs = [], []
    for k in range(count):
        sequence, result = scratch / f"sequence_{k}", scratch / f"result_{k}"
        settings = sequence_of(true, 10_000 + 100 * number + k)
        if (result / RESULT_JSON).is_file():
            made = resume(read_result(result), FrameSequence.open(sequence))
        else:
            with reserve_sequence(sequence):
                write_sequence(simulated(settings), sequence)
            made = inspect(FrameSequence.open(sequence), PLAIN, progress=False)
            write_result(made, result)
        results.append(result)
        runs.append(made)
        found = made.reconstruction
        assert found is not None
        assert found.psf is not None
        print(
            f"  {k}: {found.psf.sigma:.3f} ({100 * (found.psf.sigma / sigma - 1):+.1f} %) "
            f"+- {found.psf.error:.3f} {found.psf.evidence}",
            flush=True,
        )
    profile = pooled_profile(results)
    assert profile.psf is not None
    off = 100 * (profile.psf.sigma_lr_px / sigma - 1)
    print(
        f"  pooled: {profile.psf.sigma_lr_px:.3f} ({off:+.1f} %) "
        f"+- {profile.psf.error_lr_px:.3f} {profile.psf.shape}"
    )
    if profile.lens is not None:
        # Displacement in the corner, where r is half the diagonal over the focal length.
        r = 0.5 * np.hypot(true.width, true.height)
        bends = [
            kappa * (r / focal) ** 2 * r
            for kappa, focal in (
                (true.kappa, true.focal_px),
                (profile.lens.kappa, profile.lens.focal_length_px),
                (profile.lens.kappa_error, profile.lens.focal_length_px),
            )
        ]
        print(f"  corner: {bends[1]:.2f} +- {bends[2]:.2f} px, true {bends[0]:.2f} px")
    if profile.vignetting is not None:
        fall = 1 - np.exp(sum(profile.vignetting.coefficients))
        print(f"  vignetting: {fall:.3f}, true {true.vignetting:.3f}")
    sensor(true, results)
    for note in profile.notes:
        print(f"  {note}")
    if images:
        losses(true, scratch, results, runs)


def sensor(true: SimulationSettings, results: list[Path]) -> None:
    """Print how well one result and all of them know the sensor, apart from its slow part."""
    own = Sensor(replace(true, sensor_seed=true.seed), np.random.default_rng())
    for told in (results[:1], results):
        profile = pooled_profile(told)
        found = set(profile.defective_pixels)
        hot = set(map(tuple, np.argwhere(own.defects).tolist()))
        says = f"defective: {len(found & hot)} of {len(hot)}, wrong {len(found - hot)}"
        if profile.columns is not None:
            light, level = np.array(profile.columns.light), np.array(profile.columns.level)
            truth = without_slow_columns(own.column_offset + own.column_gain * light)
            error = without_slow_columns(level) - truth
            claimed = np.sqrt(np.mean(np.square(profile.columns.level_error)))
            says += (
                f", columns {1e4 * truth.std():.1f}e-4, error {1e4 * error.std():.1f}e-4 "
                f"(claimed {1e4 * claimed:.1f}e-4)"
            )
        print(f"  sensor of {len(told)}: {says}")


def losses(
    true: SimulationSettings, scratch: Path, results: list[Path], runs: list[Inspection]
) -> None:
    """Print what every image loses against the true blur, without and with a profile."""
    lost = []
    for k, (result, plain) in enumerate(zip(results, runs, strict=True)):
        sequence = scratch / f"sequence_{k}"
        path = scratch / "camera.toml"
        write_profile(path, pooled_profile([other for other in results if other != result]))
        images = (
            image_with(PLAIN.changed(psf_sigma_lr_px=true.psf_sigma_px), plain),
            plain.need(Reconstruction),
            image_with(PLAIN.changed(camera_profile=path), plain),
        )
        truth = json.loads((sequence / "truth" / "truth.json").read_text())
        values = [psnr(sequence, truth, image) for image in images]
        lost.append([values[0] - values[1], values[0] - values[2]])
        print(
            f"  {k}: loses {lost[-1][0]:+.2f} dB, with the profile {lost[-1][1]:+.2f}", flush=True
        )
    worst = np.max(lost, axis=0)
    print(f"  worst: {worst[0]:.2f} dB, with the profile {worst[1]:.2f}")


if __name__ == "__main__":
    main()
