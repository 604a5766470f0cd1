"""Which paths the workbench can open; everything heavy is imported when one is read."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from napari_pv_inspect.layers.layer_data import LayerData

__all__ = ["get_reader"]

Reader = Callable[[Any], "list[LayerData]"]

NOTHING: list[LayerData] = [(None,)]  # type: ignore[list-item]


def get_reader(path: str | Path | Sequence[str]) -> Reader | None:
    """Return a reader for a folder or file of frames or a result folder, else None.

    Parameters
    ----------
    path : str, Path or list of str
        One path, or the frames of one sequence as a list.
    """
    if not isinstance(path, (str, Path)):
        return read_sequence if path and all(_is_frame_file(Path(p)) for p in path) else None
    place = Path(path)
    try:
        if not place.is_dir():
            return read_sequence if _is_frame_file(place) else None
        if (place / "result.json").is_file():
            return read_result
        folder = place / "frames" if (place / "frames").is_dir() else place
        return read_sequence if any(map(_is_frame_file, folder.iterdir())) else None
    except OSError:
        return read_sequence  # It says why the folder can't be read.


def read_sequence(path: Any) -> list[LayerData]:
    """Read frames as one lazy stack."""
    from napari_pv_inspect.layers.layer_data import open_sequence, sequence_layer

    return _or_notice(lambda: [sequence_layer(open_sequence(path))])


def read_result(path: Any) -> list[LayerData]:
    """Read the module image, its support and its cracks."""
    from napari_pv_inspect.layers.layer_data import result_layers

    return _or_notice(lambda: result_layers(Path(path)))


def _or_notice(read: Callable[[], list[LayerData]]) -> list[LayerData]:
    """Turn what is wrong with the input into one sentence instead of a traceback."""
    from napari.utils.notifications import show_error

    from pv_inspect.errors import InspectionError

    try:
        return read()
    except InspectionError as error:
        show_error(str(error))
        # What napari takes as "read, and nothing to show".
        return NOTHING


def _is_frame_file(path: Path) -> bool:
    from pv_inspect.image_files.endings import is_frame_file

    return is_frame_file(path)
