"""Tables as CSV: what a person has typed stays a text, also for a spreadsheet.

A spreadsheet runs a cell that begins with ``=``, ``+``, ``-`` or ``@``. An apostrophe before it
says that it is a text; numbers stay as they are.
"""

from __future__ import annotations

import csv
import io
import re
from collections.abc import Iterable, Iterator

__all__ = ["csv_lines", "csv_text", "guarded", "unguarded"]

# Also the full-width signs, which some spreadsheets take for the others.
_RUN = r"'*\s*[=+\-@\t\r\n\uff1d\uff0b\uff0d\uff20]"
_NUMBER = re.compile(r"[-+]?(\d+\.?\d*|\.\d+)([eE][-+]?\d{1,3})?|[-+]?(inf|nan)")


def guarded(text: str) -> str:
    """Put an apostrophe before a text that a spreadsheet would run.

    >>> guarded("=1+1"), guarded("-1.5"), guarded("fine - or not")
    ("'=1+1", '-1.5', 'fine - or not')
    """
    is_number = len(text) < 40 and _NUMBER.fullmatch(text)
    return f"'{text}" if not is_number and _begins(text) else text


def unguarded(text: str) -> str:
    """Undo `guarded`.

    >>> unguarded("'=1+1"), unguarded("'t was fine")
    ('=1+1', "'t was fine")
    """
    return text[1:] if text.startswith("'") and _begins(text) else text


def csv_text(rows: Iterable[Iterable[object]]) -> str:
    """Return a table as CSV, all texts `guarded`."""
    return "".join(",".join(_quoted(guarded(str(value))) for value in row) + "\n" for row in rows)


def csv_lines(text: str) -> Iterator[dict[str, str]]:
    """Lines of a table of `csv_text` by the names of its first line.

    Raises
    ------
    ValueError
        If a line has more or fewer cells than the first.
    """
    rows = csv.reader(io.StringIO(text), strict=True)
    try:
        names = next(rows, [])
        for n, row in enumerate(rows, start=2):
            if len(row) != len(names):
                raise ValueError(f"line {n} has {len(row)} cells, the first line {len(names)}")
            yield {unguarded(name): unguarded(cell) for name, cell in zip(names, row, strict=True)}
    except csv.Error as error:
        raise ValueError(str(error)) from None


def _quoted(text: str) -> str:
    """Put quotation marks around a text that would end its cell or line."""
    if any(c in text for c in '",;\t\r\n') or text != text.strip():
        return '"' + text.replace('"', '""') + '"'
    return text


def _begins(text: str) -> bool:
    return re.match(_RUN, text) is not None
