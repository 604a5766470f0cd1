"""The command ``pv-inspect simulate``: a sequence with its complete truth."""

from __future__ import annotations

from dataclasses import fields
from pathlib import Path
from typing import Annotated, Any

import typer

from pv_inspect.cli.common import (
    Debug,
    Quiet,
    one_sentence_on_errors,
)
from pv_inspect.errors import InspectionError, printable

__all__ = ["simulate"]


def simulate(
    out: Annotated[
        Path,
        typer.Argument(
            help="Folder to make; must not hold anything.", metavar="OUT", show_default=False
        ),
    ],
    rows: Annotated[int, typer.Option(help="Rows of cells [cells].")] = 6,
    cols: Annotated[int, typer.Option(help="Columns of cells [cells].")] = 10,
    cell_aspect: Annotated[float, typer.Option(help="Cell width / cell height.")] = 1.0,
    frames: Annotated[int, typer.Option(help="Number of frames.")] = 20,
    width: Annotated[int, typer.Option(help="Width of a frame [LR px].")] = 640,
    height: Annotated[int, typer.Option(help="Height of a frame [LR px].")] = 512,
    kappa: Annotated[
        float, typer.Option(help="Radial distortion, r_d = r_u + kappa r_u^3.")
    ] = -0.2,
    wafer: Annotated[str, typer.Option(help="Kind of cells: multi or mono.")] = "multi",
    seed: Annotated[int, typer.Option(help="Same seed and settings, same frames.")] = 0,
    more: Annotated[
        list[str] | None,
        typer.Option(
            "--set",
            metavar="NAME=VALUE",
            help="Any other number of the simulation, for example --set psf_sigma_px=0.6; "
            "OUT --set help lists all with unit and range and writes nothing.",
        ),
    ] = None,
    quiet: Quiet = False,
    debug: Debug = False,
) -> None:
    """Simulate a sequence with its complete truth.

    Writes frames/, module.json and truth/ (truth.json, hr.png, cracks.png).
    """
    with one_sentence_on_errors(debug) as cleanup:
        from pv_inspect.progress.follow import follow
        from pv_inspect.simulate import SimulationSettings, reserve_sequence, write_sequence
        from pv_inspect.simulate import simulate as simulate_sequence

        if more and "help" in more:
            typer.echo(_simulation_help())
            return
        values: dict[str, Any] = {
            "rows": rows,
            "cols": cols,
            "cell_aspect": cell_aspect,
            "n_frames": frames,
            "width": width,
            "height": height,
            "kappa": kappa,
            "wafer": wafer,
            "seed": seed,
        }
        values.update(_assignment(text) for text in more or [])
        settings = SimulationSettings(**values)
        cleanup.hold(reserve_sequence(out))
        sequence = follow(simulate_sequence(settings), "simulating", quiet=quiet)
        write_sequence(sequence, out)
        if not quiet:
            where = printable(str(out))
            typer.echo(f"{frames} frames of {width} x {height} with their truth are in {where}")


def _assignment(text: str) -> tuple[str, Any]:
    from pv_inspect.simulate import SimulationSettings

    name, equals, value = text.partition("=")
    spec = {f.name: f for f in fields(SimulationSettings)}.get(name.strip())
    if spec is None or not equals:
        raise InspectionError(
            f"--set {text} is no setting of the simulation: give NAME=VALUE; --set help lists all."
        )
    kind, value = str(spec.type), value.strip()
    try:
        if kind == "bool":
            return spec.name, {"true": True, "false": False}[value.lower()]
        if kind == "str":
            return spec.name, value
        return spec.name, int(value) if kind == "int" else float(value)
    except (KeyError, ValueError):
        raise InspectionError(f"--set {text}: {value!r} is no value of type {kind}.") from None


def _simulation_help() -> str:
    from pv_inspect.simulate import SimulationSettings

    lines = []
    for spec in fields(SimulationSettings):
        about = spec.metadata
        limits = (
            f"{about['low']:g} to {about['high']:g} {about['unit']}"
            if "low" in about
            else about["unit"]
            if "unit" in about
            else ", ".join(about.get("choices", ("true", "false")))
        )
        lines.append(f"{spec.name} = {spec.default}  [{limits}]  {about.get('help', '')}")
    return "\n".join(lines)
