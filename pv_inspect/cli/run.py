"""The command ``pv-inspect run``: one sequence from frames to a result folder."""

from __future__ import annotations

from pathlib import Path
from time import perf_counter
from typing import Annotated, Any

import typer

from pv_inspect.cli.common import (
    Debug,
    Quiet,
    one_sentence_on_errors,
    use_threads,
    with_settings,
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


@with_settings()
def run(
    sequence: Annotated[
        Path,
        typer.Argument(
            help="Folder of frames (or one that has them in frames/), or a file that holds "
            "several.",
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
    given: dict[str, Any],
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
        from pv_inspect.calibration.camera_profile import read_profile
        from pv_inspect.inspection.summary import summary
        from pv_inspect.pipeline import inspect_steps
        from pv_inspect.progress.follow import follow
        from pv_inspect.results.folder import reserve_result
        from pv_inspect.results.write import write_result
        from pv_inspect.sequence.sequence import FrameSequence

        settings = Settings.from_toml(settings_file) if settings_file else Settings()
        settings = settings.changed(**given)
        place = cleanup.hold(reserve_result(out))
        check_not_inside(out, sequence, "The frames")
        cleanup.written_so_far = place.so_far
        use_threads(threads)
        begun = perf_counter()
        opened = FrameSequence.open(
            sequence,
            settings.dark_frame,
            settings.flat_frame,
            settings.read_limits,
            settings.series,
            settings.lock_in,
        )
        wanted = [] if settings.module_of is None else [settings.module_of]
        opened.indices((*wanted, *settings.keep_frames, *settings.skip_frames))
        if settings.calibration_file is not None:  # complain before the long part
            read_camera(settings.calibration_file, opened.shape)
        if settings.camera_profile is not None:
            read_profile(settings.camera_profile, opened.shape)
        inspection = follow(inspect_steps(opened, settings), quiet=quiet)
        write_result(inspection, out, place)
        if quiet:
            for doubt in inspection.doubts:
                typer.echo(f"pv-inspect: in doubt: {doubt}", err=True)
        else:
            typer.echo(summary(inspection, out, perf_counter() - begun))
        if inspection.doubts:
            raise typer.Exit(IN_DOUBT)
