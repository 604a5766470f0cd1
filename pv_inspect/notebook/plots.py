"""Plots of an inspection with matplotlib, the only place that imports it.

Colours are of the Okabe-Ito set, which stays distinct with a colour-vision deficiency.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from pv_inspect.errors import InspectionError
from pv_inspect.inspection.figures import REGISTRATION_RESIDUAL, RESIDUAL
from pv_inspect.reports.pictures import contrast_of, crack_mask, crack_overlay
from pv_inspect.settings import Stage

try:
    from matplotlib import pyplot as plt
    from matplotlib.collections import LineCollection
    from matplotlib.patches import Rectangle
    from matplotlib.ticker import MaxNLocator
except ImportError:
    raise InspectionError(
        "Plots need matplotlib, which is not installed: pip install 'pv-inspect[notebook]'."
    ) from None

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from pv_inspect.calibration.calibrate import Calibration
    from pv_inspect.inspection.inspection import Inspection
    from pv_inspect.registration.registration import Registration

__all__ = ["cells", "grid", "residuals"]

GRID = "#56B4E9"
MEASURED = "#F0E442"
PREDICTED = "#D55E00"
UNDECIDABLE = "#E69F00"
USED, NOT_USED = "#0072B2", "#D55E00"

# Distortion bends a cell border by far less than a pixel within a quarter of a cell.
_STEPS_PER_CELL = 4


def grid(inspection: Inspection, frame: int | None = None, ax: Axes | None = None) -> Axes:
    """Plot a frame with its crossing points and, once it is fitted, the grid.

    Parameters
    ----------
    inspection : Inspection
        At least its crossing points.
    frame : int, optional
        Index of the frame; the first one in use if not given.
    ax : matplotlib.axes.Axes, optional
        Where to draw; new axes if not given.

    Returns
    -------
    matplotlib.axes.Axes
        In LR pixels.

    Raises
    ------
    InspectionError
        If there are no crossing points yet, or no such frame.
    """
    if inspection.crossings is None:
        raise _too_early("the grid", Stage.DETECT)
    poses = inspection.registration or inspection.calibration
    index = _frame_index(inspection, poses) if frame is None else frame
    n_frames = len(inspection.frames)
    if not 0 <= index < n_frames:
        raise InspectionError(
            f"There is no frame {index} in a sequence of {n_frames}: give 0 to {n_frames - 1}."
        )
    found = inspection.crossings.frames[index]
    ax = _axes(ax, (8.0, 6.4))
    _show_frame(ax, inspection, index)
    height, width = inspection.frames.shape
    measured = found.measured & np.isfinite(found.points_px).all(axis=1)
    points, why = found.points_px.copy(), found.why
    if poses is not None:
        why = "" if poses.used[index] else poses.why[index] or why
        if poses.used[index]:
            lines = _borders(poses, index)
            ax.add_collection(
                LineCollection(lines, colors=GRID, linewidths=1.0, label="fitted grid")
            )
            points[~measured] = poses.crossings_px(index)[~measured]
    _dots(ax, points[measured], MEASURED, "measured crossing")
    _dots(ax, points[~measured & np.isfinite(points).all(axis=1)], PREDICTED, "predicted crossing")
    ax.set(xlim=(-0.5, width - 0.5), ylim=(height - 0.5, -0.5), xlabel="x [LR px]")
    ax.set(ylabel="y [LR px]", title=_titled(inspection.frames.names[index], why))
    if ax.get_legend_handles_labels()[0]:
        ax.legend(loc="upper left", bbox_to_anchor=(0.0, -0.1), ncols=3, frameon=False)
    return ax


def cells(inspection: Inspection, ax: Axes | None = None) -> Axes:
    """Plot the module, cell by cell, with marks, class, and a "?" where nothing can be said.

    Parameters
    ----------
    inspection : Inspection
        At least its reconstruction; cracks are drawn once they have been looked for.
    ax : matplotlib.axes.Axes, optional
        Where to draw; new axes if not given.

    Returns
    -------
    matplotlib.axes.Axes
        In module units, one cell width each; the ticks count rows and columns from 1.

    Raises
    ------
    InspectionError
        If there is no module image yet.
    """
    reconstruction, cracks = inspection.reconstruction, inspection.cracks
    if reconstruction is None:
        raise _too_early("the cells", Stage.RECONSTRUCT)
    image, grid = reconstruction.image, reconstruction.grid
    layout = grid.layout
    width, height = layout.size
    (left, top), (right, bottom) = grid.to_module(
        np.array([[-0.5, -0.5], [image.shape[1] - 0.5, image.shape[0] - 0.5]])
    )
    extent = (left, right, bottom, top)
    ax = _axes(ax, (10.0, 10.0 * height / width + 0.6))
    low, high = contrast_of(image, grid)
    ax.imshow(image, cmap="gray", vmin=low, vmax=high, extent=extent)
    title = f"{layout.rows} x {layout.cols} cells"
    if cracks is not None:
        marks = crack_mask(cracks, grid)
        ax.imshow(crack_overlay(cracks.probability, marks, max(marks.shape)), extent=extent)
        for cell in cracks.cells:
            corner = layout.cell_corners(cell.row, cell.col)
            if cell.crack_suspected:
                _box(ax, corner, f"{cell.crack_class} {cell.crack_length_cells:.2f}")
            elif cell.undecidable:
                _box(ax, corner, "?", UNDECIDABLE)
        title = cracks.counts.text
        if cracks.counts.suspected:
            title += "\nclass, and length of its cracks in cell widths"
        if cracks.counts.undecidable:
            title += "\n?: can't be judged"
    x, y = layout.places_in_cells(np.array([0.5]), np.array([0.5]))
    ax.set_xticks(x, [str(j + 1) for j in range(layout.cols)])
    ax.set_yticks(y, [str(i + 1) for i in range(layout.rows)])
    ax.set(xlim=(left, right), ylim=(bottom, top), title=title)
    ax.set(xlabel="column [cells]", ylabel="row [cells]")
    return ax


def residuals(inspection: Inspection, ax: Axes | None = None) -> Axes:
    """Plot the residual of every frame, as the last stage that looked at the frames knows it.

    Parameters
    ----------
    inspection : Inspection
        At least its calibration.
    ax : matplotlib.axes.Axes, optional
        Where to draw; new axes if not given.

    Returns
    -------
    matplotlib.axes.Axes
        After the calibration the rms distance of the crossing points from the grid, LR px; after
        the registration the registration residual, after the reconstruction the residual, both in
        units of the noise, where 1 is noise alone (see `figures`).

    Raises
    ------
    InspectionError
        If nothing has been fitted yet.
    """
    registration, calibration = inspection.registration, inspection.calibration
    poses = registration or calibration
    if poses is None:
        raise _too_early("the residuals", Stage.CALIBRATE)
    if inspection.reconstruction is not None:
        values = np.array(inspection.reconstruction.residual_rms, np.float64)
        label, title = f"{RESIDUAL} [noise]", "Frames against the module image"
    elif registration is not None:
        values = registration.rms
        label, title = f"{REGISTRATION_RESIDUAL} [noise]", "Frames against their mean"
    else:
        assert calibration is not None
        values = calibration.rms_px
        label, title = "rms distance [LR px]", "Crossing points against the grid"
    in_noise = label.endswith("[noise]")
    ax = _axes(ax, (8.0, 3.2))
    used = poses.used & np.isfinite(values)
    ax.bar(np.flatnonzero(used), values[used], color=USED, label="used")
    left_out = np.flatnonzero(~poses.used)
    if left_out.size:
        ax.plot(left_out, np.zeros(left_out.size), "x", color=NOT_USED, label="not used")
    if in_noise:
        ax.axhline(1.0, color="black", linestyle="--", linewidth=1.0, label="noise alone")
    ax.set(xlabel="frame (index, from 0)", ylabel=label, title=title)
    ax.set_xlim(-0.8, len(values) - 0.2)
    ax.xaxis.set_major_locator(MaxNLocator(integer=True))
    ax.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0), frameon=False)
    return ax


def _axes(ax: Axes | None, size: tuple[float, float]) -> Axes:
    if ax is not None:
        return ax
    _, made = plt.subplots(figsize=size, layout="constrained")
    return made


def _too_early(what: str, stage: Stage) -> InspectionError:
    return InspectionError(
        f"This inspection does not know {what} yet: run it at least to the end of "
        f"the stage {stage.value!r}."
    )


def _titled(name: str, why: str) -> str:
    return f"{name}: {why}" if why else name


def _frame_index(inspection: Inspection, poses: Registration | Calibration | None) -> int:
    """First frame that is used, or else in which the module was found, or else the first."""
    assert inspection.crossings is not None
    found = [not frame.why for frame in inspection.crossings.frames]
    return int(np.argmax(found if poses is None else poses.used))


def _show_frame(ax: Axes, inspection: Inspection, index: int) -> None:
    image = inspection.frames.frame(index).image
    low, high = np.percentile(image, [0.5, 99.8])
    ax.imshow(image, cmap="gray", vmin=low, vmax=max(high, low + 1e-6))


def _borders(poses: Registration | Calibration, index: int) -> list[NDArray[np.float64]]:
    """Borders of the cells in a frame: (n, 2) LR pixels each."""
    layout = poses.layout
    lines = layout.grid_lines(_STEPS_PER_CELL)
    return [poses.camera.project(poses.homographies[index], line) for line in lines]


def _dots(ax: Axes, points: NDArray[np.float64], colour: str, label: str) -> None:
    if len(points):
        ax.plot(*points.T, "o", color=colour, markersize=3.5, markeredgewidth=0, label=label)


def _box(ax: Axes, corners: NDArray[np.float64], text: str, colour: str = GRID) -> None:
    """Outline a cell and write into its upper left corner."""
    x, y = corners[0]
    inset = 0.03
    width, height = corners[2] - corners[0] - 2 * inset
    ax.add_patch(
        Rectangle((x + inset, y + inset), width, height, fill=False, edgecolor=colour, lw=1.2)
    )
    ax.text(
        x + 0.06,
        y + 0.06,
        text,
        color="white",
        fontsize=7,
        va="top",
        bbox={"facecolor": "black", "alpha": 0.6, "pad": 1.0, "linewidth": 0},
    )
