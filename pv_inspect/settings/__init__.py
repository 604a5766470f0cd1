"""Every number that a user may tune, with unit, range and the stage that it makes stale."""

from pv_inspect.settings.declaration import Declaration, Group
from pv_inspect.settings.settings import Settings
from pv_inspect.settings.stages import Stage

__all__ = ["Declaration", "Group", "Settings", "Stage"]
