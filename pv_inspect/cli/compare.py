"""The command ``pv-inspect compare``: methods on the same frames, in one folder."""

from __future__ import annotations

import shlex
from pathlib import Path
from typing import Annotated, Any

import typer

from pv_inspect.cli.common import (
    Debug,
    Quiet,
    one_sentence_on_errors,
    use_threads,
    with_settings,
)
from pv_inspect.errors import printable

__all__ = ["compare"]


@with_settings(
    "rows",
    "cols",
    "cell_aspect",
    "row_gaps",
    "col_gaps",
    "cell_gap",
    "camera_profile",
    "max_frame_mpx",
)
def compare(
    sequences: Annotated[
        list[Path],
        typer.Argument(
            help="Folders of frames, or files that hold several; with a folder truth/ in it, as "
            "pv-inspect simulate writes, images are scored against it.",
            metavar="SEQUENCE...",
            show_default=False,
        ),
    ],
    out: Annotated[
        Path,
        typer.Option(
            "--out", "-o", help="Folder of the comparison; a rerun goes on.", show_default=False
        ),
    ],
    given: dict[str, Any],
    methods: Annotated[
        str,
        typer.Option(
            help="Names of methods, with commas between; if not given, all but networks and "
            "programs of others."
        ),
    ] = "",
    model: Annotated[
        list[Path] | None,
        typer.Option(
            help="ONNX file of a network of your own, with a TOML file of the same name beside "
            "it; several are possible.",
            metavar="FILE",
        ),
    ] = None,
    magnification: Annotated[
        list[float] | None,
        typer.Option("--magnification", "-m", help="HR over LR resolution; several are possible."),
    ] = None,
    cells: Annotated[int, typer.Option(min=1, help="Cells of each sequence that are drawn.")] = 20,
    seed: Annotated[int, typer.Option(min=0, help="Seed of the draw.")] = 0,
    halves: Annotated[
        bool,
        typer.Option(
            "--halves",
            help="Make the images of every second frame too, and correlate both halves: a measure "
            "of resolution without truth; three times the work.",
        ),
    ] = False,
    truth: Annotated[bool, typer.Option(help="Score against the truth where there is one.")] = True,
    threads: Annotated[
        int | None, typer.Option(min=1, help="Threads to compute with; all cores if not given.")
    ] = None,
    quiet: Quiet = False,
    debug: Debug = False,
) -> None:
    """Compare reconstruction methods on the same frames and cells.

    Writes table.csv (one line for every sequence, magnification and method), table.md,
    compare.html and compare.json. Finished cells are kept: the same command goes on where it was
    stopped.
    """
    with one_sentence_on_errors(debug) as cleanup:
        from pv_inspect.evaluation.compare import ComparisonFolder, compare_all
        from pv_inspect.evaluation.methods import METHODS, PEERS, methods_named
        from pv_inspect.evaluation.peers.own_model import OwnModel
        from pv_inspect.progress.follow import follow
        from pv_inspect.settings import Settings

        folder = ComparisonFolder.at(out)
        cleanup.hold(folder.reserved())
        cleanup.written_so_far = lambda: f"finished cells are in {out}, and a rerun goes on"
        use_threads(threads)
        wanted = methods_named([name for name in methods.split(",") if name.strip()])
        for path in model or ():
            taken = [method.name for method in (*METHODS, *PEERS, *wanted)]
            wanted.append(OwnModel.read(path, taken))
        plans = folder.plans(
            sequences,
            [Settings().changed(**given, magnification=m) for m in magnification or [3.0, 4.0]],
            wanted,
            cells,
            seed,
            halves,
        )
        command = shlex.join(
            [
                *("pv-inspect", "compare", *(path.name for path in sequences)),
                *(text for m in magnification or () for text in ("--magnification", f"{m:g}")),
                *(("--methods", methods) if methods else ()),
                *(text for path in model or () for text in ("--model", path.name)),
                *("--cells", str(cells), "--seed", str(seed)),
                *(("--halves",) if halves else ()),
            ]
        )
        rows = follow(compare_all(folder, plans, command, with_truth=truth), quiet=quiet)
        failed = [row for row in rows if row.failed]
        for row in failed:
            typer.echo(
                f"pv-inspect: {row.method} on {row.sequence} at {row.magnification:g}x has no "
                f"figures: {row.failed}",
                err=True,
            )
        if not quiet:
            typer.echo(f"compared  {len(rows) - len(failed)} of {len(rows)} rows have figures")
            if not any(row.image for row in rows):
                typer.echo("truth     none: images are shown, not scored")
            typer.echo(f"results   {printable(str(out))}")
            typer.echo(f"page      {printable(str(out / 'compare.html'))}")
        if failed:
            raise typer.Exit(1)
