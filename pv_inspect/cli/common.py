"""What all commands share: options made from the settings, and one sentence for what goes wrong."""

from __future__ import annotations

import traceback
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Annotated, Any

import typer
from typer.core import TyperGroup
from typer.exceptions import TyperException

from pv_inspect.cli.cleanup import Cleanup
from pv_inspect.common.signals import stop_code, stop_word
from pv_inspect.errors import InspectionError, one_sentence
from pv_inspect.settings import Settings

__all__ = ["Commands", "Debug", "Quiet", "fail", "one_sentence_on_errors", "option", "use_threads"]


class Commands(TyperGroup):
    """The commands; wrong usage is told in one sentence, like every other mistake."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Read the arguments of a command."""
        if not args:  # this prints the help
            return super().parse_args(ctx, args)
        with _wrong_usage(ctx):
            return super().parse_args(ctx, args)

    def invoke(self, ctx: Any) -> Any:
        """Run a command."""
        with _wrong_usage(ctx):
            return super().invoke(ctx)


@contextmanager
def _wrong_usage(ctx: Any) -> Iterator[None]:
    try:
        yield
    except TyperException as error:
        said = " ".join(error.format_message().split()).rstrip(".")
        words = [word for word in ("pv-inspect", ctx.invoked_subcommand, "--help") if word]
        fail(f"{said}; see {' '.join(words)}.", error.exit_code)


def option(setting: str, *names: str) -> Any:
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


@contextmanager
def one_sentence_on_errors(debug: bool) -> Iterator[Cleanup]:
    """Turn whatever goes wrong into one sentence on stderr and an exit code."""
    cleanup = Cleanup()
    try:
        with cleanup:
            yield cleanup
    except InspectionError as error:
        fail(str(error), 1)
    except KeyboardInterrupt as stop:
        fail(f"{stop_word(stop)}; {cleanup.said}.", stop_code(stop))
    except MemoryError:
        fail("Not enough memory: lower the magnification or close other programs.", 1)
    except (typer.Exit, typer.Abort):
        raise
    except Exception as error:
        if debug:
            traceback.print_exc()
        hint = "" if debug else " (--debug shows where)"
        reason = " ".join(str(error).split()) or "no message"
        fail(f"The program failed unexpectedly: {type(error).__name__}: {reason}{hint}.", 1)


def fail(sentence: str, code: int) -> None:
    """End the command with one sentence on stderr and an exit code."""
    typer.echo(f"pv-inspect: {one_sentence(sentence)}", err=True)
    raise typer.Exit(code)


def use_threads(threads: int | None) -> None:
    """Compute with so many threads, if a number is given."""
    import cv2
    import numba

    if threads is not None:
        available = numba.config.NUMBA_NUM_THREADS  # type: ignore[attr-defined]
        numba.set_num_threads(min(threads, available))
        cv2.setNumThreads(threads)
