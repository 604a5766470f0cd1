"""The command line: ``pv-inspect run | cracks | review | simulate | gui``."""

from __future__ import annotations

import traceback
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import fields
from pathlib import Path
from time import perf_counter
from typing import Annotated, Any

import typer
from typer.core import TyperGroup
from typer.exceptions import TyperException

from pv_inspect._version import __version__
from pv_inspect.cli import cracks as cli_cracks
from pv_inspect.cli import gui as cli_gui
from pv_inspect.cli import review as cli_review
from pv_inspect.cli.course import Course
from pv_inspect.common.signals import stop_code, stop_word
from pv_inspect.errors import InspectionError, one_sentence, printable
from pv_inspect.settings import Settings
from pv_inspect.storage.output_paths import check_not_inside

__all__ = ["app", "main"]


class _Commands(TyperGroup):
    """The commands; wrong usage is told in one sentence, like every other mistake."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        if not args:  # this prints the help
            return super().parse_args(ctx, args)
        with _wrong_usage(ctx):
            return super().parse_args(ctx, args)

    def invoke(self, ctx: Any) -> Any:
        with _wrong_usage(ctx):
            return super().invoke(ctx)


@contextmanager
def _wrong_usage(ctx: Any) -> Iterator[None]:
    try:
        yield
    except TyperException as error:
        said = " ".join(error.format_message().split()).rstrip(".")
        words = [word for word in ("pv-inspect", ctx.invoked_subcommand, "--help") if word]
        _fail(f"{said}; see {' '.join(words)}.", error.exit_code)


app = typer.Typer(
    name="pv-inspect",
    cls=_Commands,
    help=(
        "Turn a short sequence of coarse frames of a solar module into one straight, sharp image, "
        "cut it into cells and mark suspected cracks."
    ),
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
    context_settings={"help_option_names": ["-h", "--help"]},
)


def _option(setting: str, *names: str) -> Any:
    """Option for a setting, with the setting's own description, unit and default."""
    about = Settings.model_fields[setting]
    long = f"--{setting.replace('_', '-')}"
    spelled = names if any(name.startswith("--") for name in names) else (long, *names)
    unit = Settings.unit_of(setting)
    unit_text = "" if unit in ("1", "file") else f" {unit}"
    limits = {
        name: getattr(limit, name)
        for limit in about.metadata
        for name in ("ge", "gt", "le")
        if hasattr(limit, name)
    }
    low, high = limits.get("ge", limits.get("gt")), limits.get("le")
    range_text = "" if low is None or high is None else f" {low:g} to {high:g}"
    number = isinstance(about.default, int | float)
    default = f"default {about.default:g}" if number else f"default {about.default}"
    known = [f"{range_text}{unit_text}".strip(), default if about.default not in (None, ()) else ""]
    facts = ", ".join(fact for fact in known if fact)
    text = f"{about.description}{f' [{facts}]' if facts else ''}"
    if about.default == ():
        return typer.Option(*spelled, help=f"{text} May be given several times.", metavar="NAME")
    return typer.Option(*spelled, help=text)


Debug = Annotated[
    bool, typer.Option("--debug", help="Show the traceback if the program itself fails.")
]
Quiet = Annotated[bool, typer.Option("--quiet", "-q", help="Print nothing but errors.")]


IN_DOUBT = 3
"""Exit code of a run whose result is written but must not be relied on."""


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


_WORDS = (
    "Frames are looked at in LR px (pixels of a frame), the module image in HR px, the module in "
    "cell widths. What is not given is taken from module.json beside the frames or estimated."
)


@app.command(epilog=_WORDS)
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
    rows: Annotated[int | None, _option("rows")] = None,
    cols: Annotated[int | None, _option("cols")] = None,
    cell_aspect: Annotated[float | None, _option("cell_aspect")] = None,
    module_at: Annotated[tuple[float, float] | None, _option("module_at")] = None,
    magnification: Annotated[float | None, _option("magnification", "-m")] = None,
    prior: Annotated[str | None, _option("prior")] = None,
    prior_weight: Annotated[float | None, _option("prior_weight", "--lambda")] = None,
    max_iterations: Annotated[int | None, _option("max_iterations")] = None,
    kappa: Annotated[float | None, _option("kappa")] = None,
    focal_length: Annotated[float | None, _option("focal_length_px", "--focal-length")] = None,
    calibration: Annotated[Path | None, _option("calibration_file", "--calibration")] = None,
    registration_model: Annotated[str | None, _option("registration_model")] = None,
    module_of: Annotated[str | None, _option("module_of")] = None,
    keep_frame: Annotated[list[str] | None, _option("keep_frames", "--keep-frame")] = None,
    skip_frame: Annotated[list[str] | None, _option("skip_frames", "--skip-frame")] = None,
    psf_sigma: Annotated[float | None, _option("psf_sigma_lr_px", "--psf-sigma")] = None,
    motion_blur: Annotated[str | None, _option("motion_blur")] = None,
    crack_threshold: Annotated[float | None, _option("crack_threshold")] = None,
    detector: Annotated[str | None, _option("detector")] = None,
    cell_width_mm: Annotated[float | None, _option("cell_width_mm")] = None,
    dark_frame: Annotated[Path | None, _option("dark_frame")] = None,
    flat_frame: Annotated[Path | None, _option("flat_frame")] = None,
    max_frame_mpx: Annotated[float | None, _option("max_frame_mpx")] = None,
    max_frames: Annotated[int | None, _option("max_frames")] = None,
    second_look: Annotated[
        bool | None, _option("second_look", "--second-look/--no-second-look")
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
    with _one_sentence(debug) as course:
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
            "second_look": second_look,
            "max_iterations": max_iterations,
            "crack_threshold": crack_threshold,
            "detector": detector,
            "cell_width_mm": cell_width_mm,
        }
        settings = Settings.from_toml(settings_file) if settings_file else Settings()
        settings = settings.changed(**{k: v for k, v in given.items() if v is not None})
        place = course.hold(reserve_result(out))
        check_not_inside(out, sequence, "The frames")
        course.so_far = place.so_far
        _use_threads(threads)
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


@app.command()
def cracks(
    images: cli_cracks.Images,
    out: Annotated[
        Path,
        typer.Option("--out", "-o", help="Folder for the maps and cells.csv.", show_default=False),
    ],
    crack_threshold: Annotated[float | None, _option("crack_threshold")] = None,
    detector: Annotated[str | None, _option("detector")] = None,
    cell_width_mm: Annotated[float | None, _option("cell_width_mm")] = None,
    max_frame_mpx: Annotated[float | None, _option("max_frame_mpx")] = None,
    model: cli_cracks.Model = None,
    quiet: Quiet = False,
    debug: Debug = False,
) -> None:
    """Look for cracks in plain images of cells.

    Writes for each image a map of the crack probability (float32 TIFF of the same size and stem)
    and cells.csv with the features of all cells.
    """
    with _one_sentence(debug) as course:
        given = {
            "crack_threshold": crack_threshold,
            "detector": detector,
            "cell_width_mm": cell_width_mm,
            "max_frame_mpx": max_frame_mpx,
        }
        settings = Settings().changed(**{k: v for k, v in given.items() if v is not None})
        if not cli_cracks.cracks_of(images, out, settings, model, course, quiet=quiet):
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
    with _one_sentence(debug) as course:
        module = {
            "serial_number": serial,
            "current_a": current,
            "exposure_s": exposure,
            "temperature_c": temperature,
        }
        cli_review.review_of(folder, module, course, export=export, quiet=quiet)


@app.command()
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
    with _one_sentence(debug) as course:
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
        course.hold(reserve_sequence(out))
        sequence = follow(simulate_sequence(settings), "simulating", quiet=quiet)
        write_sequence(sequence, out)
        if not quiet:
            where = printable(str(out))
            typer.echo(f"{frames} frames of {width} x {height} with their truth are in {where}")


@app.command()
def gui(
    sequence: cli_gui.Shown = None,
    debug: Debug = False,
) -> None:
    """Open the workbench in napari, with a sequence if one is given."""
    with _one_sentence(debug):
        cli_gui.open_workbench(sequence)


@contextmanager
def _one_sentence(debug: bool) -> Iterator[Course]:
    """Turn whatever goes wrong into one sentence on stderr and an exit code."""
    course = Course()
    try:
        with course:
            yield course
    except InspectionError as error:
        _fail(str(error), 1)
    except KeyboardInterrupt as stop:
        _fail(f"{stop_word(stop)}; {course.said}.", stop_code(stop))
    except MemoryError:
        _fail("Not enough memory: lower the magnification or close other programs.", 1)
    except (typer.Exit, typer.Abort):
        raise
    except Exception as error:
        if debug:
            traceback.print_exc()
        hint = "" if debug else " (--debug shows where)"
        reason = " ".join(str(error).split()) or "no message"
        _fail(f"The program failed unexpectedly: {type(error).__name__}: {reason}{hint}.", 1)


def _fail(sentence: str, code: int) -> None:
    typer.echo(f"pv-inspect: {one_sentence(sentence)}", err=True)
    raise typer.Exit(code)


def _use_threads(threads: int | None) -> None:
    import cv2
    import numba

    if threads is not None:
        available = numba.config.NUMBA_NUM_THREADS  # type: ignore[attr-defined]
        numba.set_num_threads(min(threads, available))
        cv2.setNumThreads(threads)


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
            else ", ".join(about.get("choices", ("true", "false")))
        )
        lines.append(f"{spec.name} = {spec.default}  [{limits}]  {about.get('help', '')}")
    return "\n".join(lines)
