"""Anything in any order: nothing breaks, nothing hangs, no verdict is lost.

More of it: PV_INSPECT_SEEDS=0,1,2,3 PV_INSPECT_ACTIONS=200 in the environment.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from qtpy.QtWidgets import QFileDialog, QMessageBox

from tests.plugin.monkey import Monkey

SEEDS = [int(seed) for seed in os.environ.get("PV_INSPECT_SEEDS", "0,1").split(",")]
ACTIONS = int(os.environ.get("PV_INSPECT_ACTIONS", "30"))


@pytest.mark.slow
@pytest.mark.parametrize("seed", SEEDS)
def test_any_actions_in_any_order_break_nothing_and_lose_no_verdict(
    seed: int,
    make_napari_viewer: Callable[..., Any],
    tiny_folder: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    errors: list[str] = []
    monkeypatch.setattr("napari_pv_inspect.workbench.show_error", errors.append)
    monkeypatch.setattr(QMessageBox, "question", lambda *_: QMessageBox.StandardButton.Discard)
    monkey = Monkey(seed, make_napari_viewer, tiny_folder, tmp_path)
    monkeypatch.setattr(QFileDialog, "getSaveFileName", lambda *_: (str(monkey.folder), ""))
    monkey.whole()
    monkey.act(ACTIONS)
    assert monkey.lost() == [], monkey.done
    monkey.leave()
    assert all("\n" not in text and "unexpectedly" not in text for text in errors), errors
