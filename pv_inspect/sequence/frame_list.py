"""Which files are the frames: found, told apart, named, and each counted once."""

from __future__ import annotations

import os
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

from pv_inspect.errors import InspectionError, printable
from pv_inspect.image_files.formats import FORMAT_NAMES, format_of
from pv_inspect.image_files.limits import ReadLimits
from pv_inspect.image_files.problems import ImageFileError
from pv_inspect.image_files.regular import file_state
from pv_inspect.sequence.frame_files import FrameFile, expand_with_notes, natural_key
from pv_inspect.sequence.strays import without_strays

__all__ = ["FrameList", "existing_image", "list_frames"]

# Noise hardly shrinks: camera frames are stored in a half to a twentieth of their size, simulated
# ones without any noise in a fiftieth. Zeros unfold a thousandfold.
_UNFOLDING = 200
# Less is read in no time, whatever it is.
_HARMLESS_BYTES = 2**26
# What was compressed with loss has no noise left to speak of.
_LOSSY_UNFOLDING = 4000


@dataclass(frozen=True)
class FrameList:
    """The frames of a source, from their headers.

    Parameters
    ----------
    root : Path
        What was opened; the folder of the first one for a list of files.
    paths : tuple of Path
        The image files, in order.
    files : tuple of FrameFile
        The frames in them, in order.
    names : tuple of str
        Printable name of each frame, no two the same.
    warnings : tuple of str
        What was left out and why.
    """

    root: Path
    paths: tuple[Path, ...]
    files: tuple[FrameFile, ...]
    names: tuple[str, ...]
    warnings: tuple[str, ...]


def list_frames(
    source: Path | str | Iterable[Path | str], limits: ReadLimits, series: str | None = None
) -> FrameList:
    """List the frames of a folder, a file that holds several, or a list of files.

    Parameters
    ----------
    source : path or paths
    limits : ReadLimits
    series : str, optional
        Which one, where a file holds several series of pictures.

    Raises
    ------
    InspectionError
        If anything is missing, unreadable, no image, too large or too much.
    """
    try:
        root, paths, warnings = _find(source)
    except OSError as error:
        raise InspectionError(
            f"{source} can't be read ({error.strerror}): check its name and its permissions."
        ) from None
    in_files: list[Sequence[FrameFile]] = []
    for path in paths:
        frames, notes = expand_with_notes(path, limits, series)
        in_files.append(frames)
        warnings += notes
        if sum(map(len, in_files)) > limits.max_frames:
            raise InspectionError(
                f"There are more than {limits.max_frames} frames in {root}, but a sequence has "
                "about 20: take some of them, or raise max_frames."
            )
    if root.is_dir() and isinstance(source, (str, Path)):
        in_files, strays = without_strays(in_files)
        warnings += strays
        paths = [frames[0].path for frames in in_files]
    files = [file for frames in in_files for file in frames]
    _check_unfolding(root, files)
    return FrameList(root, tuple(paths), tuple(files), _names(files), warnings)


def _check_unfolding(root: Path, files: list[FrameFile]) -> None:
    """Refuse small files that claim to hold very much: blank pictures, or pages that share one."""
    whole = sum(file.shape[0] * file.shape[1] * file.dtype.itemsize for file in files)
    stored = sum(size for _, size in {(file.path, file.state.size) for file in files})
    lossy = any(file.picture.lossy for file in files)
    if whole > _HARMLESS_BYTES and whole > (_LOSSY_UNFOLDING if lossy else _UNFOLDING) * stored:
        raise InspectionError(
            f"The frames in {root} unfold from {stored / 1e6:.2g} MB to {whole / 1e6:.0f} MB, but "
            "pictures of a camera have noise, which does not shrink so far: remove blank or "
            "repeated ones."
        )


def existing_image(path: Path) -> Path:
    """Return the path if it is a regular file whose name says that it is an image.

    Raises
    ------
    InspectionError
        If it is not.
    """
    if not os.path.lexists(path):
        raise InspectionError(f"{path} is no existing file: correct its name or leave it out.")
    try:
        file_state(path)
    except ImageFileError as problem:
        raise InspectionError(f"{path} {problem}") from None
    if format_of(path) is None:
        raise InspectionError(
            f"{path} is no {FORMAT_NAMES} file: convert it losslessly to TIFF or PNG."
        )
    return path


def _find(
    source: Path | str | Iterable[Path | str],
) -> tuple[Path, list[Path], tuple[str, ...]]:
    """Resolve what the user gave to (source, image files in order, warnings)."""
    if not isinstance(source, (str, Path)):
        paths = [existing_image(Path(p)) for p in source]
        if not paths:
            raise InspectionError("The list of frames is empty: give at least one image.")
        kept, again = _without_repeats(paths)
        if again:
            raise InspectionError(
                f"{again[0][0]} is in the list of frames twice: a frame counts once, remove the "
                "copy."
            )
        return paths[0].parent, kept, ()
    path = Path(source)
    if path.is_dir():
        inner = path / "frames"
        images = _images_in(inner) if inner.is_dir() else []
        kept, again = _without_repeats(images or _images_in(path))
        if not kept:
            raise InspectionError(
                f"{path} holds no {FORMAT_NAMES} image: give the folder that the frames are in."
            )
        return path, kept, _counted_once(again)
    if not os.path.lexists(path):
        raise InspectionError(
            f"{path} does not exist: give a folder of frames, a TIFF with several pages, or a "
            "list of images."
        )
    return path, [existing_image(path)], ()


def _images_in(folder: Path) -> list[Path]:
    """Return the images of a folder in natural order; what only looks like one is no silent gap.

    Files that are meant to hold a whole sequence count where there is nothing else.
    """
    found: dict[bool, list[Path]] = {False: [], True: []}
    for path in folder.iterdir():
        kind = format_of(path)
        if kind is not None and not path.name.startswith(".") and not path.is_dir():
            found[kind.stacks].append(path)
    images = map(existing_image, found[False] or found[True])
    return sorted(images, key=lambda p: natural_key(p.name))


def _without_repeats(paths: list[Path]) -> tuple[list[Path], list[tuple[Path, Path]]]:
    """Keep one name of each file, the file's own before that of a link; also (other, kept)."""
    groups: dict[object, list[int]] = {}
    for k, path in enumerate(paths):
        state = file_state(path)
        # Some network drives have no numbers for their files.
        groups.setdefault(state if state.inode else os.path.realpath(path), []).append(k)
    kept, again = [], []
    for group in groups.values():
        own = next((k for k in group if not paths[k].is_symlink()), group[0])
        kept.append(own)
        again += [(paths[k], paths[own]) for k in group if k != own]
    return [paths[k] for k in sorted(kept)], again


def _counted_once(again: list[tuple[Path, Path]]) -> tuple[str, ...]:
    if not again:
        return ()
    other, own = again[0]
    more = f" (and {len(again) - 1} more such names)" if len(again) > 1 else ""
    return (
        printable(f"{other.name} is a link to the same file as {own.name}{more}: it counts once."),
    )


def _names(files: list[FrameFile]) -> tuple[str, ...]:
    """File names, with as many parent folders as it takes to tell the frames apart."""
    parts = [file.path.absolute().parts for file in files]
    names: list[str] = []
    for depth in range(1, max(map(len, parts)) + 1):
        names = [
            file.label(printable("/".join(part[-depth:])))
            for file, part in zip(files, parts, strict=True)
        ]
        if len(set(names)) == len(names):
            return tuple(names)
    # Names that differ in nothing printable.
    return tuple(f"{name} #{k + 1}" for k, name in enumerate(names))
