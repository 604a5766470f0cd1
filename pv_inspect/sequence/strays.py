"""Images in a folder of frames that are none of them: previews, overviews, compressed twins.

A file is left out only if two things say so: what it is (size, type, kind) differs from most
files, and its name is not made like theirs. A frame that merely has another size is an error that
a person has to look at.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Sequence

from pv_inspect.errors import printable
from pv_inspect.sequence.frame_files import FrameFile

__all__ = ["without_strays"]

# What every frame of one file says is the same as what its first one says.
Frames = Sequence[FrameFile]
_NAMED = 3


def without_strays(found: Sequence[Frames]) -> tuple[list[Frames], tuple[str, ...]]:
    """Leave out what is no frame.

    Parameters
    ----------
    found : sequence of sequence of FrameFile
        The frames of every file of the folder.

    Returns
    -------
    kept : list
    said : tuple of str
        What was left out and why, in sentences.
    """
    lossless = {_stem(frames) for frames in found if not frames[0].picture.lossy}
    twins = [f for f in found if f[0].picture.lossy and _stem(f) in lossless]
    rest = [frames for frames in found if not any(frames is twin for twin in twins)]
    kinds = Counter(_kind(frames) for frames in rest)
    common, n = kinds.most_common(1)[0]
    others: list[Frames] = []
    if 2 * n > len(rest) and n > 1:
        patterns = {_pattern(frames) for frames in rest if _kind(frames) == common}
        others = [f for f in rest if _kind(f) != common and _pattern(f) not in patterns]
    kept = [frames for frames in rest if not any(frames is other for other in others)]
    said = []
    if twins:
        said.append(
            _sentence(
                twins,
                "has the name of a frame that is stored without loss",
                "have the names of frames that are stored without loss",
            )
        )
    for kind in dict.fromkeys(map(_kind, others)):
        what = f"{_words(kind)}, and not named like the frames"
        group = [frames for frames in others if _kind(frames) == kind]
        said.append(_sentence(group, f"is {what}", f"are {what}"))
    return kept, tuple(said)


def _sentence(frames: list[Frames], of_one: str, of_many: str) -> str:
    names = ", ".join(f[0].path.name for f in frames[:_NAMED])
    more = f" and {len(frames) - _NAMED} more" if len(frames) > _NAMED else ""
    what = f"is left out: it {of_one}" if len(frames) == 1 else f"are left out: they {of_many}"
    return printable(f"{names}{more} {what}.")


def _stem(frames: Frames) -> str:
    return frames[0].path.stem.casefold()


def _pattern(frames: Frames) -> str:
    return re.sub(r"\d+", "#", _stem(frames))


def _kind(frames: Frames) -> tuple[str, tuple[int, int], str, bool]:
    first = frames[0]
    return first.format.name, first.shape, str(first.dtype), first.picture.coloured


def _words(kind: tuple[str, tuple[int, int], str, bool]) -> str:
    name, (height, width), dtype, coloured = kind
    return f"{name} of {width} x {height} px, {'colour' if coloured else dtype}"
