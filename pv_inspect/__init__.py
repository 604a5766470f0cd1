"""Super-resolved, rectified images of solar modules from sequences of coarse frames.

The names below are loaded when they are first used: ``import pv_inspect`` itself is light.
"""

from __future__ import annotations

from pv_inspect.common import starting

if starting.is_the_command():  # before the other imports: a Ctrl-C may come at once
    starting.exit_at_once()

import os
from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from pv_inspect.errors import InspectionError
    from pv_inspect.pipeline import Inspection, Step, inspect, run_to_end
    from pv_inspect.sequence.sequence import Sequence
    from pv_inspect.settings import Settings, Stage

__version__ = "0.1.0"

# Threads that spin while they wait take the processor from those that work. It must be said before
# compiled code starts its threads; whoever has said otherwise is right.
os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")

__all__ = [
    "Inspection",
    "InspectionError",
    "Sequence",
    "Settings",
    "Stage",
    "Step",
    "__version__",
    "inspect",
    "run_to_end",
]

_HOME = {
    "Inspection": "pipeline",
    "InspectionError": "errors",
    "Sequence": "sequence.sequence",
    "Settings": "settings",
    "Stage": "settings",
    "Step": "pipeline",
    "inspect": "pipeline",
    "run_to_end": "pipeline",
}


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    value = globals()[name] = getattr(import_module(f"{__name__}.{_HOME[name]}"), name)
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
