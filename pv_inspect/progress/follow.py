"""Progress of a run: a bar in a terminal or a notebook, plain lines where there is neither."""

from __future__ import annotations

from collections.abc import Generator
from dataclasses import dataclass
from time import perf_counter
from typing import TypeVar

import numpy as np
from rich.console import Console
from rich.progress import BarColumn, TaskProgressColumn, TextColumn, TimeElapsedColumn
from rich.progress import Progress as Bar
from rich.table import Column

from pv_inspect.common import signals
from pv_inspect.common.compiling import cache_problem
from pv_inspect.common.work import Progress, forwarded, result_of
from pv_inspect.inspection.inspection import Step
from pv_inspect.progress.notebook_bar import NotebookBar, in_notebook
from pv_inspect.settings import Stage

__all__ = ["follow"]

T = TypeVar("T")


def follow(work: Generator[Step | Progress, None, T], what: str = "", quiet: bool = False) -> T:
    """Drive work to its end and show in the notebook or on stderr how far it is.

    Parameters
    ----------
    work : generator of Step or Progress
        A whole run, or one stage.
    what : str
        What is being done, where the work is one stage.
    quiet : bool
        Show nothing.

    Returns
    -------
    object
        What the work returned.
    """
    return _drive(forwarded(work, lambda event: _shown(event, what)), quiet)


@dataclass(frozen=True)
class _Shown:
    """What is shown of one event; some messages close a stage."""

    stage: str
    fraction: float
    message: str
    ends: bool


def _shown(event: Step | Progress, what: str) -> _Shown:
    signals.check()
    if isinstance(event, Progress):
        return _Shown(what, event.fraction, event.message, False)
    # During the reconstruction `partial` is a preview; only a whole part ends a stage.
    unfinished = event.partial is None or isinstance(event.partial, np.ndarray)
    ends = event.stage is Stage.LOAD or not unfinished
    return _Shown(event.stage.value, event.fraction, event.message, ends)


def _drive(events: Generator[_Shown, None, T], quiet: bool) -> T:
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


def _with_bar(events: Generator[_Shown, None, T], console: Console) -> T:
    # In a narrow terminal the message gives way, not the bar or the time.
    rest = Column(ratio=1, no_wrap=True, overflow="ellipsis")
    columns = (
        TextColumn("{task.fields[stage]:<11}", markup=False, table_column=Column(min_width=11)),
        BarColumn(bar_width=16, table_column=Column(min_width=16)),
        TaskProgressColumn(table_column=Column(min_width=4)),
        TimeElapsedColumn(table_column=Column(min_width=7)),
        TextColumn("{task.description}", markup=False, table_column=rest),
    )
    with Bar(*columns, console=console, transient=True, expand=True) as bar:
        task = bar.add_task("", total=1.0, stage="")

        def show(event: _Shown) -> None:
            bar.update(task, completed=event.fraction, description=event.message, stage=event.stage)

        return result_of(events, show)


def _with_notebook_bar(events: Generator[_Shown, None, T]) -> T:
    bar, message = NotebookBar(), ""

    def show(event: _Shown) -> None:
        nonlocal message
        message = event.message
        bar.update(event.fraction, message)

    result = result_of(events, show)
    bar.end(message)
    return result


def _with_lines(events: Generator[_Shown, None, T], console: Console) -> T:
    """One line per finished stage, and a sign of life at least every ten seconds."""
    told = perf_counter()

    def show(event: _Shown) -> None:
        nonlocal told
        if event.ends or perf_counter() - told > 10:
            told = perf_counter()
            line = f"{100 * event.fraction:3.0f} %  {event.stage:<12} {event.message}"
            console.print(line, markup=False, highlight=False, soft_wrap=True)

    return result_of(events, show)
