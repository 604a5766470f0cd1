"""Undo and redo."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from napari_pv_inspect.models.history import Action, History


def put(values: list[int], value: int) -> Action:
    """Append a value to a list."""
    return Action(f"Add {value}", lambda: values.append(value), lambda: values.pop() and None)


@given(st.lists(st.sampled_from(["do", "undo", "redo"]), max_size=40))
def test_history_is_a_list_with_a_cursor(steps: list[str]) -> None:
    values: list[int] = []
    history, expected, cursor = History(), [], 0
    for k, step in enumerate(steps, start=1):
        if step == "do":
            history.perform(put(values, k))
            expected, cursor = [*expected[:cursor], k], cursor + 1
        elif step == "undo":
            history.undo()
            cursor = max(cursor - 1, 0)
        else:
            history.redo()
            cursor = min(cursor + 1, len(expected))
        assert values == expected[:cursor]
        assert history.undo_text == (f"Add {values[-1]}" if cursor else None)
        assert (history.redo_text is None) == (cursor == len(expected))


def test_an_action_that_fails_is_not_remembered() -> None:
    def fail() -> None:
        raise ValueError("no")

    history = History()
    with pytest.raises(ValueError, match="no"):
        history.perform(Action("Fail", fail, lambda: None))
    assert history.undo_text is None
