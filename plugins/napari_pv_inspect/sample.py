"""The sample module of *File > Open Sample*."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from napari_pv_inspect.reader import read_sequence

if TYPE_CHECKING:
    from napari_pv_inspect.layers.layer_data import LayerData

__all__ = ["sample_folder", "sample_module"]

CHECKOUT_SAMPLE = Path(__file__).parents[2] / "sample_data" / "module"


def sample_module() -> list[LayerData]:
    """Return the frames of the sample module as one lazy stack."""
    return read_sequence(sample_folder())


def sample_folder() -> Path:
    """Return the sample of the checkout, or else one that is simulated once and kept."""
    if (CHECKOUT_SAMPLE / "frames").is_dir():
        return CHECKOUT_SAMPLE
    from napari_pv_inspect.user_state import cache_folder

    folder = cache_folder() / "sample_module"
    if not (folder / "module.json").is_file():
        _simulate(folder)
    return folder


def _simulate(folder: Path) -> None:
    from napari.utils.notifications import show_info

    from pv_inspect.simulate import SimulationSettings, simulated, write_sequence

    show_info(f"Simulating the sample module once into {folder}; this takes a minute.")
    write_sequence(simulated(SimulationSettings()), folder)
