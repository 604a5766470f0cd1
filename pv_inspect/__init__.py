"""Super-resolved, rectified images of solar modules from sequences of coarse frames.

    import pv_inspect as pv

    frames = pv.open_sequence("folder")
    inspection = pv.inspect(frames, pv.Settings(magnification=3))
    pv.write_result(inspection, "out")

The names below are loaded when they are first used: ``import pv_inspect`` itself is light.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

from pv_inspect._version import __version__

if TYPE_CHECKING:
    from pv_inspect.calibration.calibrate import calibrate
    from pv_inspect.cracks import look_at_first
    from pv_inspect.errors import InspectionError
    from pv_inspect.geometry.grid import HrGrid
    from pv_inspect.geometry.layout import ModuleLayout
    from pv_inspect.inspection.inspection import Inspection, Step
    from pv_inspect.notebook import plots
    from pv_inspect.pipeline import inspect, inspect_steps
    from pv_inspect.reconstruction.preview import Preview, Region
    from pv_inspect.reconstruction.single_frame import bicubic
    from pv_inspect.results.read import read_result
    from pv_inspect.results.write import write_result
    from pv_inspect.sequence.sequence import FrameSequence, open_sequence
    from pv_inspect.settings import Settings, Stage

__all__ = [
    "FrameSequence",
    "HrGrid",
    "Inspection",
    "InspectionError",
    "ModuleLayout",
    "Preview",
    "Region",
    "Settings",
    "Stage",
    "Step",
    "__version__",
    "bicubic",
    "calibrate",
    "inspect",
    "inspect_steps",
    "look_at_first",
    "open_sequence",
    "plots",
    "read_result",
    "write_result",
]

_HOME = {
    "FrameSequence": "sequence.sequence",
    "HrGrid": "geometry.grid",
    "Inspection": "inspection.inspection",
    "InspectionError": "errors",
    "ModuleLayout": "geometry.layout",
    "Preview": "reconstruction.preview",
    "Region": "reconstruction.preview",
    "Settings": "settings",
    "Stage": "settings",
    "Step": "inspection.inspection",
    "bicubic": "reconstruction.single_frame",
    "calibrate": "calibration.calibrate",
    "inspect": "pipeline",
    "inspect_steps": "pipeline",
    "look_at_first": "cracks",
    "open_sequence": "sequence.sequence",
    "read_result": "results.read",
    "write_result": "results.write",
}


def __getattr__(name: str) -> Any:
    if name == "plots":
        return import_module(f"{__name__}.notebook.plots")
    if name not in _HOME:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    value = globals()[name] = getattr(import_module(f"{__name__}.{_HOME[name]}"), name)
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
