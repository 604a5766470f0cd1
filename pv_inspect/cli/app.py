"""The command line: ``pv-inspect run | compare | calibrate | cracks | review | simulate | gui``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from pv_inspect._version import __version__
from pv_inspect.cli import cracks as cli_cracks
from pv_inspect.cli import gui as cli_gui
from pv_inspect.cli import review as cli_review
from pv_inspect.cli.calibrate import calibrate
from pv_inspect.cli.common import (
    Commands,
    Debug,
    Quiet,
    one_sentence_on_errors,
    with_settings,
)
from pv_inspect.cli.compare import compare
from pv_inspect.cli.run import WORDS, run
from pv_inspect.cli.simulate import simulate
from pv_inspect.settings import Settings

__all__ = ["app", "main"]


app = typer.Typer(
    name="pv-inspect",
    cls=Commands,
    help=(
        "Turn a short sequence of coarse frames of a solar module into one straight, sharp image, "
        "cut it into cells and mark suspected cracks."
    ),
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
    context_settings={"help_option_names": ["-h", "--help"]},
)


def main() -> None:
    """Entry point of the command ``pv-inspect``."""
    app()


def _print_version(wanted: bool) -> None:
    if wanted:
        typer.echo(f"pv-inspect {__version__}")
        raise typer.Exit


@app.callback()
def _common(
    version: Annotated[
        bool,
        typer.Option(
            "--version", callback=_print_version, is_eager=True, help="Print the version and exit."
        ),
    ] = False,
) -> None:
    pass


app.command(epilog=WORDS)(run)


@app.command()
@with_settings("crack_threshold", "detector", "cell_width_mm", "max_frame_mpx")
def cracks(
    images: cli_cracks.Images,
    out: Annotated[
        Path,
        typer.Option("--out", "-o", help="Folder for the maps and cells.csv.", show_default=False),
    ],
    given: dict[str, Any],
    model: cli_cracks.Model = None,
    quiet: Quiet = False,
    debug: Debug = False,
) -> None:
    """Look for cracks in plain images of cells.

    Writes for each image a map of the crack probability (float32 TIFF of the same size and stem)
    and cells.csv with the features of all cells.
    """
    with one_sentence_on_errors(debug) as cleanup:
        settings = Settings().changed(**given)
        if not cli_cracks.cracks_of(images, out, settings, model, cleanup, quiet=quiet):
            raise typer.Exit(1)


@app.command()
def review(
    folder: cli_review.Folder,
    export: cli_review.Export = False,
    serial: cli_review.Serial = None,
    current: cli_review.Current = None,
    exposure: cli_review.Exposure = None,
    temperature: cli_review.Temperature = None,
    quiet: Quiet = False,
    debug: Debug = False,
) -> None:
    """Tell how far the review of a result is, and export it.

    Verdicts are given in the workbench; what is known about the module can be stored here.
    """
    with one_sentence_on_errors(debug) as cleanup:
        module = {
            "serial_number": serial,
            "current_a": current,
            "exposure_s": exposure,
            "temperature_c": temperature,
        }
        cli_review.review_of(folder, module, cleanup, export=export, quiet=quiet)


app.command()(calibrate)
app.command()(compare)
app.command()(simulate)


@app.command()
def gui(
    sequence: cli_gui.Shown = None,
    debug: Debug = False,
) -> None:
    """Open the workbench in napari, with a sequence if one is given."""
    with one_sentence_on_errors(debug):
        cli_gui.open_workbench(sequence)
