"""The command ``pv-inspect review``: how far the review of a result is, and its export."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

import typer

from pv_inspect.cli.cleanup import Cleanup
from pv_inspect.errors import printable

__all__ = ["Current", "Export", "Exposure", "Folder", "Serial", "Temperature", "review_of"]

Folder = Annotated[
    Path,
    typer.Argument(help="Result folder of `pv-inspect run`.", metavar="DIR", show_default=False),
]
Export = Annotated[
    bool, typer.Option("--export", help="Write verdicts.csv and review.html into DIR.")
]
Serial = Annotated[
    str | None, typer.Option("--serial", help="Store the serial number of the module.")
]
Current = Annotated[
    float | None, typer.Option("--current", help="Store the current through the module [A].")
]
Exposure = Annotated[
    float | None, typer.Option("--exposure", help="Store the exposure time of a frame [s].")
]
Temperature = Annotated[
    float | None, typer.Option("--temperature", help="Store the module's temperature [°C].")
]


def review_of(
    folder: Path, module: dict[str, Any], cleanup: Cleanup, *, export: bool, quiet: bool
) -> None:
    """Tell how far the review of a result is; store module data and export if asked for.

    Parameters
    ----------
    folder : Path
        Result folder.
    module : dict
        Fields of `ModuleData` to change; None leaves one as it is.
    cleanup : Cleanup
    export : bool
    quiet : bool
        Print nothing.

    Raises
    ------
    InspectionError
        If the folder is no result, the review can't be read or something can't be written.
    """
    from pv_inspect.cracks import CrackMap
    from pv_inspect.results.read import read_result
    from pv_inspect.review import ReviewStore, of_rater, progress
    from pv_inspect.review.report import export_review
    from pv_inspect.review.tables import DISAGREED, agreed, raters_of

    result = read_result(folder)
    stored: list[str] = []
    cleanup.written_so_far = lambda: (" and ".join(stored)) or "nothing was written"
    cleanup.begin()
    with ReviewStore(result.source) as store:
        changes = {name: value for name, value in module.items() if value is not None}
        if changes:
            store.describe(replace(store.module_data(), **changes))
            stored.append("the module's data are stored")
        verdicts = store.current()
        if export:
            stored.append("some of the exported files may be those of before")
        written = export_review(result, store) if export else ()
    if quiet:
        return
    lines = [
        *(f"IN DOUBT  {text}" for text in result.doubts),
        f"cells     {result.need(CrackMap).counts.text}",
        f"review    {progress(verdicts, result.layout).text}",
    ]
    for rater in raters_of(verdicts):
        found = progress(of_rater(verdicts, rater).values(), result.layout)
        counts = ", ".join(f"{n} {kind.label}" for kind, n in found.counts.items() if n)
        lines.append(f"rater     {rater}: {found.text}" + (f"; {counts}" if counts else ""))
    disagreed = sum(said == DISAGREED for said in agreed(verdicts).values())
    if disagreed:
        lines.append(
            f"differ    the raters disagree on {disagreed} {'cell' if disagreed == 1 else 'cells'}"
        )
    lines += [f"written   {path}" for path in written]
    typer.echo("\n".join(map(printable, lines)))
