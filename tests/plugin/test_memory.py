"""What the collector passes over, and what goes back to the system."""

from __future__ import annotations

import gc
from weakref import ref

from napari_pv_inspect.tasks.memory import gc_frozen


class Ring:
    """Refers to itself: only the collector can free it."""

    def __init__(self) -> None:
        self.itself = self


def test_what_lives_is_passed_over_and_what_comes_later_is_collected() -> None:
    old = Ring()
    before = ref(old)
    with gc_frozen():
        del old
        new = Ring()
        after = ref(new)
        del new
        gc.collect()
        assert after() is None
        assert before() is not None
    gc.collect()
    assert before() is None
