"""The command ``pv-inspect cracks``: the crack detector on plain images of cells."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Annotated

import typer

from pv_inspect.cli.cleanup import Cleanup
from pv_inspect.errors import InspectionError, printable
from pv_inspect.settings import Settings
from pv_inspect.storage.folders import replace_file
from pv_inspect.storage.output_paths import output_folder
from pv_inspect.storage.reservations import reserved_files

__all__ = ["cracks_of"]

Images = Annotated[
    list[Path],
    typer.Argument(
        help="Images of one cell each (TIFF, PNG, JPEG, BMP; any size, 8 or 16 bit), or folders "
        "of them.",
        metavar="IMAGES...",
        show_default=False,
    ),
]
Model = Annotated[
    Path | None,
    typer.Option(
        "--model",
        help="ONNX file of a network of one's own, made by pv_inspect.cracks.training.train, with "
        "its JSON file beside it; or sharp or weak, networks that are there for comparison.",
    ),
]


def cracks_of(
    images: list[Path],
    out: Path,
    settings: Settings,
    model: Path | None,
    cleanup: Cleanup,
    *,
    quiet: bool,
) -> bool:
    """Write OUT/STEM.tif for each image and OUT/cells.csv; tell about images that are no cells.

    Parameters
    ----------
    images : list of Path
        Files and folders.
    out : Path
    settings : Settings
    model : Path, optional
        See `NetworkDetector`.
    cleanup : Cleanup
        Holds ``out`` until the command ends.
    quiet : bool
        Print nothing but errors.

    Returns
    -------
    bool
        Whether every image could be read.

    Raises
    ------
    InspectionError
        If there are no images, none of them is a cell, the model is unusable, or ``out`` can't
        be written.
    """
    from pv_inspect.cracks import CellCounts, NetworkDetector, detector_of
    from pv_inspect.cracks.single_cells import (
        PlainCell,
        cells_csv,
        image_files,
        read_plain_cell,
        tiff_bytes,
    )
    from pv_inspect.cracks.wording import finger_text

    files = image_files(images)
    place = output_folder(out)
    if any(Path(os.path.realpath(path.parent)) == place for path in files):
        raise InspectionError(
            f"{out} holds the images themselves, which the maps could replace: give another "
            "folder with --out."
        )
    if model is not None and settings.detector != "network":
        raise InspectionError(
            f"--model {model} is a network, but the detector is {settings.detector}: leave out "
            "--detector or --model."
        )
    detector = NetworkDetector(model) if model is not None else detector_of(settings)
    cells: list[PlainCell] = []
    refused = 0
    cleanup.hold(reserved_files(place))
    cleanup.written_so_far = lambda: (
        f"the maps of {len(cells)} of {len(files)} images are in {out}, without a table"
        if cells
        else "nothing was written"
    )
    for path in files:
        try:
            cell = read_plain_cell(path, detector, settings)
        except InspectionError as error:
            typer.echo(f"pv-inspect: {error}", err=True)
            refused += 1
            continue
        replace_file(place / f"{cell.stem}.tif", tiff_bytes(cell.probability))
        cells.append(cell)
    if cells:
        replace_file(place / "cells.csv", cells_csv(cells).encode())
    if not quiet:
        fingers = finger_text(cell.features for cell in cells)
        typer.echo(
            f"cells     {CellCounts.of(cell.features for cell in cells).text}"
            + (
                f"; {refused} {'image' if refused == 1 else 'images'} could not be used"
                if refused
                else ""
            )
            + (f"\nfingers   {fingers}" if fingers else "")
            + f"\ndetector  {detector.name}\nresults   {printable(str(out))}"
        )
    return not refused
