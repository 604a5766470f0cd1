"""The command ``pv-inspect calibrate``: results of one camera pooled into a camera profile."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from pv_inspect.cli.common import Debug, Quiet, one_sentence_on_errors
from pv_inspect.errors import printable

__all__ = ["calibrate"]


def calibrate(
    results: Annotated[
        list[Path],
        typer.Argument(
            help="Result folders of pv-inspect run, of one camera, in the order of the pictures.",
            metavar="RESULT...",
            show_default=False,
        ),
    ],
    out: Annotated[
        Path,
        typer.Option(
            "--out", "-o", help="Camera profile to write (TOML); replaced.", show_default=False
        ),
    ],
    quiet: Quiet = False,
    debug: Debug = False,
) -> None:
    """Pool what results of one camera say of it into a camera profile.

    Kappa, principal point, optical blur, vignetting and pattern of the columns, each weighted by
    its uncertainty, and defective pixels. Results that do not go with the others and a drift are
    told. Use it with pv-inspect run --camera.
    """
    with one_sentence_on_errors(debug):
        from pv_inspect.calibration.camera_profile import write_profile
        from pv_inspect.results.camera_evidence import pooled_profile

        profile = pooled_profile(results)
        write_profile(out, profile)
        if quiet:
            return
        n = profile.results
        typer.echo(f"Camera profile of {n} result{'s' if n > 1 else ''}: {printable(str(out))}")
        for line in profile.described:
            typer.echo(f"  {line}")
        for note in profile.notes:
            typer.echo(f"  Note: {printable(note)}.")
