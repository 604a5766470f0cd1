"""The command ``pv-inspect run``: one sequence from frames to a result folder."""

from __future__ import annotations

from pathlib import Path
from time import perf_counter
from typing import Annotated

import typer

from pv_inspect.cli.common import (
    Debug,
    Quiet,
    one_sentence_on_errors,
    option,
    use_threads,
)
from pv_inspect.settings import Settings
from pv_inspect.storage.output_paths import check_not_inside

__all__ = ["IN_DOUBT", "WORDS", "run"]


IN_DOUBT = 3
"""Exit code of a run whose result is written but must not be relied on."""


WORDS = (
    "Frames are looked at in LR px (pixels of a frame), the module image in HR px, the module in "
    "cell widths. What is not given is taken from module.json beside the frames or estimated."
)


def run(
    sequence: Annotated[
        Path,
        typer.Argument(
            help="Folder of 8- or 16-bit TIFF or PNG frames (or one that has them in frames/), or "
            "a multi-page TIFF.",
            metavar="SEQUENCE",
            show_default=False,
        ),
    ],
    out: Annotated[
        Path,
        typer.Option(
            "--out",
            "-o",
            help="Result folder; an earlier result in it is replaced, as a whole.",
            show_default=False,
        ),
    ],
    rows: Annotated[int | None, option("rows")] = None,
    cols: Annotated[int | None, option("cols")] = None,
    cell_aspect: Annotated[float | None, option("cell_aspect")] = None,
    module_at: Annotated[tuple[float, float] | None, option("module_at")] = None,
    magnification: Annotated[float | None, option("magnification", "-m")] = None,
    prior: Annotated[str | None, option("prior")] = None,
    prior_weight: Annotated[float | None, option("prior_weight", "--lambda")] = None,
    max_iterations: Annotated[int | None, option("max_iterations")] = None,
    kappa: Annotated[float | None, option("kappa")] = None,
    focal_length: Annotated[float | None, option("focal_length_px", "--focal-length")] = None,
    calibration: Annotated[Path | None, option("calibration_file", "--calibration")] = None,
    registration_model: Annotated[str | None, option("registration_model")] = None,
    module_of: Annotated[str | None, option("module_of")] = None,
    keep_frame: Annotated[list[str] | None, option("keep_frames", "--keep-frame")] = None,
    skip_frame: Annotated[list[str] | None, option("skip_frames", "--skip-frame")] = None,
    psf_sigma: Annotated[float | None, option("psf_sigma_lr_px", "--psf-sigma")] = None,
    motion_blur: Annotated[str | None, option("motion_blur")] = None,
    crack_threshold: Annotated[float | None, option("crack_threshold")] = None,
    detector: Annotated[str | None, option("detector")] = None,
    cell_width_mm: Annotated[float | None, option("cell_width_mm")] = None,
    dark_frame: Annotated[Path | None, option("dark_frame")] = None,
    flat_frame: Annotated[Path | None, option("flat_frame")] = None,
    max_frame_mpx: Annotated[float | None, option("max_frame_mpx")] = None,
    max_frames: Annotated[int | None, option("max_frames")] = None,
    second_pass: Annotated[
        bool | None, option("second_pass", "--second-pass/--no-second-pass")
    ] = None,
    settings_file: Annotated[
        Path | None,
        typer.Option("--settings", help="TOML file of settings; the options above win over it."),
    ] = None,
    threads: Annotated[
        int | None,
        typer.Option(min=1, help="Threads to compute with; all cores if not given."),
    ] = None,
    quiet: Quiet = False,
    debug: Debug = False,
) -> None:
    """Reconstruct one module and write its result folder.

    Writes module_hr.tif, support.tif, cracks.tif, cells/, cells.csv, report.html and result.json.
    Exit code: 0 if the result is whole and without doubt; 3 if it is written but must not be relied
    on (the summary begins with the reason); 1 if there is none.
    """
    with one_sentence_on_errors(debug) as cleanup:
        # Imported here: --help and --version answer at once.
        from pv_inspect.calibration.camera_file import read_camera
        from pv_inspect.inspection.summary import summary
        from pv_inspect.pipeline import inspect_steps
        from pv_inspect.progress.follow import follow
        from pv_inspect.results.folder import reserve_result
        from pv_inspect.results.write import write_result
        from pv_inspect.sequence.sequence import FrameSequence

        given = {
            "rows": rows,
            "cols": cols,
            "cell_aspect": cell_aspect,
            "module_at": module_at,
            "magnification": magnification,
            "prior": prior,
            "prior_weight": prior_weight,
            "kappa": kappa,
            "focal_length_px": focal_length,
            "calibration_file": calibration,
            "registration_model": registration_model,
            "module_of": module_of,
            "keep_frames": keep_frame,
            "skip_frames": skip_frame,
            "psf_sigma_lr_px": psf_sigma,
            "motion_blur": motion_blur,
            "dark_frame": dark_frame,
            "flat_frame": flat_frame,
            "max_frame_mpx": max_frame_mpx,
            "max_frames": max_frames,
            "second_pass": second_pass,
            "max_iterations": max_iterations,
            "crack_threshold": crack_threshold,
            "detector": detector,
            "cell_width_mm": cell_width_mm,
        }
        settings = Settings.from_toml(settings_file) if settings_file else Settings()
        settings = settings.changed(**{k: v for k, v in given.items() if v is not None})
        place = cleanup.hold(reserve_result(out))
        check_not_inside(out, sequence, "The frames")
        cleanup.written_so_far = place.so_far
        use_threads(threads)
        begun = perf_counter()
        references = settings.dark_frame, settings.flat_frame
        opened = FrameSequence.open(sequence, *references, settings.read_limits)
        wanted = [] if settings.module_of is None else [settings.module_of]
        opened.indices((*wanted, *settings.keep_frames, *settings.skip_frames))
        if settings.calibration_file is not None:  # complain before the long part
            read_camera(settings.calibration_file, opened.shape)
        inspection = follow(inspect_steps(opened, settings), quiet=quiet)
        write_result(inspection, out, place)
        if quiet:
            for doubt in inspection.doubts:
                typer.echo(f"pv-inspect: in doubt: {doubt}", err=True)
        else:
            typer.echo(summary(inspection, out, perf_counter() - begun))
        if inspection.doubts:
            raise typer.Exit(IN_DOUBT)
