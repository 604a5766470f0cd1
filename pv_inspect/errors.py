"""The one exception that a user is meant to read, and how text is made fit to be printed."""

from __future__ import annotations

__all__ = ["LONGEST_SENTENCE", "InspectionError", "one_sentence", "printable"]

# With "pv-inspect: " before it a sentence stays under 400 characters.
LONGEST_SENTENCE = 380
# So much of the end is kept: there stands what to do.
_KEPT_END = 170
_ELLIPSIS = " ... "


def printable(text: str) -> str:
    r"""Show what a terminal would obey or hide: control, bidirectional and invisible characters.

    A file can have any name. Its name is shown as Python would write it.

    >>> print(printable("frame\x1b[2J\n.tif"))
    frame\x1b[2J\n.tif
    """
    if text.isprintable():
        return text
    return "".join(c if c.isprintable() else ascii(c)[1:-1] for c in text)


def one_sentence(text: str, longest: int = LONGEST_SENTENCE) -> str:
    """Make a text printable and, in the middle, short enough to be read.

    >>> one_sentence(500 * "a" + " can't be read: remove it.", 40)
    'aaaaaaaaaaaaaaa ... be read: remove it.'
    """
    text = printable(text)
    if len(text) <= longest:
        return text
    end = min(_KEPT_END, longest // 2)
    return text[: longest - end - len(_ELLIPSIS)].rstrip() + _ELLIPSIS + text[-end:].lstrip()


class InspectionError(Exception):
    """Something in the input, the settings or the environment keeps a stage from its result.

    The text is one sentence for the user: what is wrong, what was found, what was expected,
    and what to do. The command line prints it as it is, the workbench shows it as a notice.

    Parameters
    ----------
    text : str
        May quote anything: it is made printable and shortened to `LONGEST_SENTENCE` characters.
    """

    def __init__(self, text: str) -> None:
        super().__init__(one_sentence(text))
