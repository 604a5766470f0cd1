"""What all commands share: options made from the settings, and one sentence for what goes wrong."""

from __future__ import annotations

import inspect
import traceback
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import wraps
from typing import Annotated, Any

import typer
from typer.core import TyperGroup
from typer.exceptions import TyperException

from pv_inspect.cli.cleanup import Cleanup
from pv_inspect.common.signals import stop_code, stop_word
from pv_inspect.errors import InspectionError, one_sentence
from pv_inspect.settings import Settings

__all__ = [
    "Commands",
    "Debug",
    "Quiet",
    "fail",
    "one_sentence_on_errors",
    "option",
    "use_threads",
    "with_settings",
]


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


def with_settings(*names: str) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """Give a command an option for each setting; it gets those that were given as ``given``.

    Parameters
    ----------
    *names : str
        Fields of `Settings`; all of them if none is named.
    """

    def decorated(command: Callable[..., None]) -> Callable[..., None]:
        settings = names or tuple(Settings.model_fields)

        @wraps(command)
        def called(**values: Any) -> None:
            found = {name: values.pop(name) for name in settings}
            command(given={k: v for k, v in found.items() if v is not None}, **values)

        own = inspect.signature(command, eval_str=True).parameters.values()
        kept = [p.replace(kind=p.KEYWORD_ONLY) for p in own if p.name != "given"]
        made = [
            inspect.Parameter(
                name,
                inspect.Parameter.KEYWORD_ONLY,
                default=None,
                annotation=Annotated[_kind_of(name) | None, option(name)],
            )
            for name in settings
        ]
        required = [p for p in kept if p.default is p.empty]
        others = [p for p in kept if p.default is not p.empty]
        signature = inspect.Signature([*required, *made, *others])
        called.__signature__ = signature  # type: ignore[attr-defined]
        called.__annotations__ = {p.name: p.annotation for p in signature.parameters.values()}
        return called

    return decorated


def _kind_of(setting: str) -> Any:
    """Type of a setting for the command line; `Settings` checks the value."""
    kind, _ = Settings.kind_of(setting)
    if Settings.choices_of(setting):
        return str
    if kind == tuple[str, ...]:
        return list[str]
    return kind


def option(setting: str) -> Any:
    """Option for a setting, with the setting's own description, unit and default."""
    about = Settings.model_fields[setting]
    spelled = Settings.options_of(setting)
    unit = Settings.unit_of(setting)
    unit_text = "" if unit in ("1", "file") else f" {unit}"
    low, high = Settings.limits_of(setting)
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
