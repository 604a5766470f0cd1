"""One input for one reader, and what became of it."""

from __future__ import annotations

import os
import unicodedata
from dataclasses import dataclass
from pathlib import Path

__all__ = ["LONGEST", "MOST_CPU_S", "MOST_MIB", "Case", "Outcome", "fault_of"]

LONGEST = 400
MOST_CPU_S = 2.0
MOST_MIB = 1024.0
# Control characters, marks that turn the direction of writing, halves of surrogate pairs.
_UNPRINTABLE = frozenset({"Cc", "Cf", "Cs", "Zl", "Zp"})


@dataclass(frozen=True)
class Case:
    """Files for a reader.

    Parameters
    ----------
    reader : str
        One of `tests.fuzz.readers.READERS`.
    files : tuple of (name, content)
        Names relative to the folder of the case, in place of those of the reader's valid input;
        None takes a file away.
    args : tuple of str
        What else the reader is given, for instance the command line.
    links : tuple of (name, target)
        Symbolic links; the target "|" makes a pipe without a writer, "/" an empty folder.
    """

    reader: str
    files: tuple[tuple[str, bytes | None], ...] = ()
    args: tuple[str, ...] = ()
    links: tuple[tuple[str, str], ...] = ()

    def write(self, folder: Path) -> None:
        """Put the files into a folder."""
        for name, content in self.files:
            path = folder / name
            if content is None:
                path.unlink(missing_ok=True)
            else:
                path.parent.mkdir(parents=True, exist_ok=True)
                path.write_bytes(content)
        for name, target in self.links:
            path = folder / name
            path.parent.mkdir(parents=True, exist_ok=True)
            if target == "|":
                os.mkfifo(path)
            elif target == "/":
                path.mkdir()
            else:
                path.symlink_to(target)


@dataclass(frozen=True)
class Outcome:
    """What a reader made of a case.

    Parameters
    ----------
    said : str
        The sentence of the refusal; "" if the input was accepted.
    fault : str
        What is wrong with that; "" if all is well.
    cpu_s : float
        Processor time of all threads.
    peak_mib : float
        Growth of the process at its largest.
    where : str
        Frames of the program's own code that an unexpected exception came through.
    """

    said: str = ""
    fault: str = ""
    cpu_s: float = 0.0
    peak_mib: float = 0.0
    where: str = ""


def fault_of(said: str) -> str:
    """What is wrong with a sentence for the user; "" if nothing is."""
    if len(said) >= LONGEST:
        return f"{len(said)} characters"
    if any(unicodedata.category(character) in _UNPRINTABLE for character in said):
        return f"not one printable line: {said!r}"
    if not said.endswith(".") or len(said.split()) < 5:
        return f"no whole sentence: {said!r}"
    return ""
