"""Progress of a run: a bar in a terminal or a notebook, plain lines where there is neither."""

from __future__ import annotations

from collections.abc import Generator
from time import perf_counter
from typing import TypeVar

import numpy as np
from rich.console import Console
from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeElapsedColumn
from rich.table import Column

from pv_inspect.common import signals
from pv_inspect.common.compiling import cache_problem
from pv_inspect.common.work import relayed, result_of
from pv_inspect.notebook.progress_bar import NotebookBar, in_notebook
from pv_inspect.pipeline import Inspection, Step
from pv_inspect.settings import Stage

__all__ = ["follow", "follow_fraction"]

T = TypeVar("T")


def follow(steps: Generator[Step, None, Inspection], quiet: bool = False) -> Inspection:
    """Drive `pipeline.inspect` to its end and show in the notebook or on stderr how far it is.

    Parameters
    ----------
    steps : generator of Step
    quiet : bool
        Show nothing.

    Returns
    -------
    Inspection
    """
    return _drive(relayed(steps, _event), quiet)


def follow_fraction(work: Generator[float, None, T], what: str, quiet: bool = False) -> T:
    """Drive a generator of bare fractions to its end and show on stderr how far it is.

    Parameters
    ----------
    work : generator of float
    what : str
        What is being done.
    quiet : bool
        Show nothing.
    """

    def event(fraction: float) -> _Event:
        signals.check()
        return what, fraction, what, False

    return _drive(relayed(work, event), quiet)


# (what is at work, fraction of the whole, message, whether the message closes a stage)
_Event = tuple[str, float, str, bool]


def _event(step: Step) -> _Event:
    signals.check()
    # During the reconstruction `partial` is a preview; only a whole part ends a stage.
    unfinished = step.partial is None or isinstance(step.partial, np.ndarray)
    ends = step.stage is Stage.LOAD or not unfinished
    return step.stage.value, step.fraction, step.message, ends


def _drive(events: Generator[_Event, None, T], quiet: bool) -> T:
    console = Console(stderr=True)
    if quiet:
        return result_of(events)
    if problem := cache_problem():
        console.print(f"pv-inspect: {problem}", markup=False, highlight=False, soft_wrap=True)
    if in_notebook():
        return _with_notebook_bar(events)
    if console.is_terminal:
        return _with_bar(events, console)
    return _with_lines(events, console)


def _with_bar(events: Generator[_Event, None, T], console: Console) -> T:
    # In a narrow terminal the message gives way, not the bar or the time.
    rest = Column(ratio=1, no_wrap=True, overflow="ellipsis")
    columns = (
        TextColumn("{task.fields[stage]:<11}", markup=False, table_column=Column(min_width=11)),
        BarColumn(bar_width=16, table_column=Column(min_width=16)),
        TaskProgressColumn(table_column=Column(min_width=4)),
        TimeElapsedColumn(table_column=Column(min_width=7)),
        TextColumn("{task.description}", markup=False, table_column=rest),
    )
    with Progress(*columns, console=console, transient=True, expand=True) as bar:
        task = bar.add_task("", total=1.0, stage="")

        def show(event: _Event) -> None:
            stage, fraction, message, _ = event
            bar.update(task, completed=fraction, description=message, stage=stage)

        return result_of(events, show)


def _with_notebook_bar(events: Generator[_Event, None, T]) -> T:
    bar, message = NotebookBar(), ""

    def show(event: _Event) -> None:
        nonlocal message
        _, fraction, message, _ = event
        bar.update(fraction, message)

    result = result_of(events, show)
    bar.end(message)
    return result


def _with_lines(events: Generator[_Event, None, T], console: Console) -> T:
    """One line per finished stage, and a sign of life at least every ten seconds."""
    told = perf_counter()

    def show(event: _Event) -> None:
        nonlocal told
        stage, fraction, message, ends = event
        if ends or perf_counter() - told > 10:
            told = perf_counter()
            line = f"{100 * fraction:3.0f} %  {stage:<12} {message}"
            console.print(line, markup=False, highlight=False, soft_wrap=True)

    return result_of(events, show)
