"""A network of the user's own among the methods that are compared."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Generator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import ConfigDict, Field

from pv_inspect.common.records import Number, Record, checked
from pv_inspect.common.work import Progress
from pv_inspect.cracks.foreign_network import NetworkApart, Purpose
from pv_inspect.errors import InspectionError
from pv_inspect.evaluation.case import Case, Cell
from pv_inspect.evaluation.frame_patches import video_around
from pv_inspect.settings.toml import read_toml

__all__ = ["OwnModel"]

Image = NDArray[np.float32]

_MOST_BYTES = 2**30
_LONGEST_S = 600.0
_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]{0,60}")


class _Declaration(Record):
    """What the file beside a network says of it."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    layout: Literal["nchw", "nhwc", "ntchw"]
    channels: Annotated[int, Field(strict=True, ge=1, le=3)]
    value_range: tuple[Number, Number]
    scale: Annotated[int, Field(strict=True, ge=1, le=8)]
    frames: Annotated[int, Field(strict=True, ge=1, le=100)] = 1


@dataclass(frozen=True)
class OwnModel:
    """A network in an ONNX file, with a TOML file beside it.

    Parameters
    ----------
    path : Path
        Of the network.
    declared : _Declaration
    sha256 : str
        Of the network.
    """

    path: Path
    declared: _Declaration
    sha256: str
    cell_by_cell: bool = True

    @classmethod
    def read(cls, path: Path, taken: Sequence[str]) -> OwnModel:
        """Read what is declared of a network.

        Parameters
        ----------
        path : Path
        taken : sequence of str
            Names that other methods have.

        Raises
        ------
        InspectionError
            If a file is missing, too large or says something else.
        """
        if not _NAME.fullmatch(path.stem) or path.stem.lower() in {n.lower() for n in taken}:
            raise InspectionError(
                f"{path.name} can't name a row of the table, because its name is that of another "
                "method or has other characters than letters, digits, '.', '_' and '-': rename it."
            )
        about = path.with_suffix(".toml")
        if not about.is_file():
            raise InspectionError(
                f"{path} has no description: write {about.name} beside it, with layout, channels, "
                "value_range and scale."
            )
        try:
            declared = checked(_Declaration, read_toml(about))
        except ValueError as error:
            raise InspectionError(
                f"{about} does not describe a network ({error}): it needs layout, channels, "
                "value_range, scale and, if not 1, frames."
            ) from None
        low, high = declared.value_range
        if low >= high or (declared.frames > 1) != (declared.layout == "ntchw"):
            raise InspectionError(
                f"{about} contradicts itself: value_range is [black, white] with black < white, "
                'and layout is "ntchw" for several frames and only for these.'
            )
        return cls(path, declared, hashlib.sha256(_network(path)).hexdigest())

    @property
    def name(self) -> str:
        """Name of the row: that of the file."""
        return self.path.stem

    @property
    def frames(self) -> Literal["one", "all"]:
        """Whether it sees more than one frame."""
        return "one" if self.declared.frames == 1 else "all"

    @property
    def note(self) -> str:
        """What it is, and how the intensity is scaled for it."""
        declared = self.declared
        low, high = declared.value_range
        seen = "one frame" if declared.frames == 1 else f"{declared.frames} frames in a row"
        return (
            f"{self.path.name}, SHA-256 {self.sha256[:12]}; {seen}, enlarged {declared.scale}x and "
            f"then rectified, at any magnification; {low:g} to {high:g} is black to the 99.9 "
            "percentile of the frame; equal channels, averaged afterwards"
        )

    def images(
        self, case: Case, cells: Sequence[Cell]
    ) -> Generator[Progress | tuple[Cell, Image], None, None]:
        """Enlarge the surroundings of each cell, and rectify the result."""
        declared = self.declared
        purpose = Purpose(
            "a method",
            f"float32 in layout {declared.layout}, with sides of any length",
            f"correct the network or {self.path.with_suffix('.toml').name}",
            _LONGEST_S,
        )
        low, high = (np.float32(value) for value in declared.value_range)
        for cell in cells:
            patch, video, index, unit = video_around(case, cell, declared.frames)
            # One process for each cell: what it has taken is known when it has ended.
            network = NetworkApart(self.path, _network(self.path), purpose)
            try:
                made = self.enlarged(network, low + (high - low) * video, index)
            finally:
                network.close()
            yield cell, patch.rectified(unit.back((made - low) / (high - low)), declared.scale)

    def enlarged(self, network: NetworkApart, video: Image, index: int) -> Image:
        """Run the network on patches.

        Parameters
        ----------
        network : NetworkApart
        video : (n, h, w) float32
        index : int
            The frame that is wanted.

        Returns
        -------
        (scale * h, scale * w) float32

        Raises
        ------
        InspectionError
            If it returns something else.
        """
        declared = self.declared
        given = np.repeat(video[:, None], declared.channels, axis=1)
        if declared.layout == "ntchw":
            given = given[None]
        elif declared.layout == "nhwc":
            given = given.transpose(0, 2, 3, 1)
        found = network.forward(np.ascontiguousarray(given, np.float32))
        made = found
        if declared.layout == "ntchw" and found.ndim == 5 and found.shape[1] == len(video):
            made = found[:, index]
        elif declared.layout == "nhwc" and found.ndim == 4:
            made = found.transpose(0, 3, 1, 2)
        sides = tuple(declared.scale * side for side in video.shape[1:])
        if made.ndim != 4 or made.shape[0] != 1 or made.shape[2:] != sides:
            raise InspectionError(
                f"{self.path} returns {found.shape} for {given.shape}, where its description wants "
                f"pictures of {sides[0]} x {sides[1]}: correct scale or layout in "
                f"{self.path.with_suffix('.toml').name}."
            )
        if not np.isfinite(made).all():
            raise InspectionError(
                f"{self.path} returns values that are no numbers: check value_range in "
                f"{self.path.with_suffix('.toml').name}."
            )
        return np.asarray(made[0].mean(axis=0), np.float32)


def _network(path: Path) -> bytes:
    try:
        if path.stat().st_size > _MOST_BYTES:
            raise InspectionError(
                f"{path} has over {_MOST_BYTES / 2**30:g} GiB: give a smaller network."
            )
        return path.read_bytes()
    except OSError as error:
        raise InspectionError(
            f"{path} can't be read ({error.strerror}): give the ONNX file of a network."
        ) from None
