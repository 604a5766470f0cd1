"""An inspection made by hand: everything in it is known, nothing has to be computed."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from pv_inspect.calibration.calibrate import Calibration
from pv_inspect.cells import cut_cells
from pv_inspect.cracks import CrackMap, measure_cell
from pv_inspect.detection.crossings import Crossings, FrameCrossings
from pv_inspect.geometry.camera import Camera
from pv_inspect.geometry.grid import HrGrid
from pv_inspect.geometry.layout import ModuleLayout
from pv_inspect.inspection.inspection import Inspection
from pv_inspect.reconstruction.reconstruction import Reconstruction
from pv_inspect.registration.registration import Registration
from pv_inspect.settings import Settings

LAYOUT = ModuleLayout(2, 3)
REASON = "no module of 2 x 3 cells <b>found</b>"


@dataclass(frozen=True, eq=False)
class FakeSequence:
    """What of a FrameSequence the stages after the registration ask for."""

    names: tuple[str, ...] = ("frame_0.tif", "frame_1 & <i>.tif", "frame_2.tif")
    shape: tuple[int, int] = (60, 80)
    source: Path = Path("somewhere/module <7>")
    opened_from: Path = Path("somewhere/module <7>")
    warnings: tuple[str, ...] = ()
    layout_hint: dict[str, float] = field(default_factory=lambda: {"rows": 2, "cols": 3})
    copies: dict[int, int] = field(default_factory=dict)
    lock_in: None = None
    without_current: frozenset[int] = frozenset()
    defects: np.ndarray = field(default_factory=lambda: np.zeros((60, 80), bool))

    def __len__(self) -> int:
        return len(self.names)

    @property
    def measured(self) -> list[int]:
        return list(range(len(self)))

    def layout(self, settings: Settings) -> ModuleLayout:
        return replace(LAYOUT, rows=settings.rows or LAYOUT.rows)

    def says_gaps(self, _settings: Settings) -> bool:
        return True

    def says_sizes(self, _settings: Settings) -> bool:
        return False


def made_crossings(n_frames: int = 3) -> Crossings:
    points = LAYOUT.crossings() * 20 + 10
    good = FrameCrossings(points, np.full(len(points), 0.1), np.ones(len(points), bool), "")
    return Crossings(LAYOUT, (good,) * n_frames)


def made_calibration(n_frames: int = 3) -> Calibration:
    registration = made_registration(n_frames)
    numbers: dict[str, Any] = {"focal_convention": True, "kappa_std": 0.01}
    return Calibration(
        LAYOUT,
        registration.camera,
        registration.homographies,
        np.ones(n_frames, bool),
        ("",) * n_frames,
        np.full(n_frames, 0.1),
        **numbers,
    )


def made_registration(n_frames: int = 3) -> Registration:
    camera = Camera(np.array([[100.0, 0, 40], [0, 100, 30], [0, 0, 1]]), -0.1)
    pose = np.array([[0.2, 0, -0.3], [0, 0.2, -0.2], [0, 0, 1]])
    used = np.arange(n_frames) != 1
    return Registration(
        LAYOUT,
        camera,
        np.stack([pose] * n_frames),
        used,
        tuple("" if ok else REASON for ok in used),
        np.linspace(0.9, 1.1, n_frames),
        np.linspace(0, 0.01, n_frames),
        np.where(used, 1.25, np.nan),
    )


def made_reconstruction() -> Reconstruction:
    grid = HrGrid.covering(LAYOUT, 20.0, 4.0)
    image = np.full(grid.shape, 0.4, np.float32)
    y, x = grid.cell_slices(0, 1)
    cv2.line(image, (x.start + 10, y.start + 10), (x.start + 70, y.start + 50), 0.1, 2)
    support = np.linspace(0, 1, image.size, dtype=np.float32).reshape(image.shape)
    return Reconstruction(
        image,
        support,
        grid,
        0.05,
        0.4,
        (2.0, 1.0),
        True,
        np.ones_like(image),
        (1.0, float("nan"), 1.2),
        ((0.0, 0.0),) * 3,
        12,
    )


def made_inspection(**changes: Any) -> Inspection:
    """Complete: 2 x 3 cells, a crack in row 1, column 2, and 3 frames of which one is rejected."""
    reconstruction = made_reconstruction()
    tiles = cut_cells(reconstruction)
    maps = [(tiles.tile(*place) < 0.3).astype(np.float32) * 0.9 for place in tiles.places]
    cells = tuple(
        measure_cell(
            tiles.tile(i, j), one, 0.5, row=i, col=j, cell_width_px=80, usual_intensity=0.4
        )
        for (i, j), one in zip(tiles.places, maps, strict=True)
    )
    inspection = Inspection(
        FakeSequence(),  # type: ignore[arg-type]
        Settings(),
        LAYOUT,
        made_crossings(),
        made_calibration(),
        made_registration(),
        reconstruction,
        tiles,
        CrackMap(tiles.assemble(maps), 0.5, "by hand", cells),
        {"load": 0.1, "detect": 1.0, "reconstruct": 2.0},
        (f"frame_1 & <i>.tif is not used: {REASON}.",),
    )
    return replace(inspection, **changes)
