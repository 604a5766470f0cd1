"""Keys by which a cell is judged, in the gallery and in the cell view alike."""

from __future__ import annotations

from functools import partial

from qtpy.QtWidgets import QWidget

from napari_pv_inspect.widgets.shortcuts import Key
from napari_pv_inspect.workbench import Workbench
from pv_inspect.review import VerdictKind

__all__ = ["bind_review_keys"]


def bind_review_keys(workbench: Workbench, within: QWidget, group: str) -> None:
    """Bind the letters of the verdicts while the focus is in a widget; F1 lists them."""
    if workbench.shortcuts is None:
        return
    review = workbench.review
    for kind in VerdictKind:
        key = Key(kind.key.upper(), f"{kind.label}: {kind.meaning}", group)
        workbench.shortcuts.add(key, partial(review.judge, kind), within=within)
    for sequence, text, slot in (
        ("Del", "Withdraw the verdict", review.withdraw),
        ("Space", "Next cell without a verdict", review.to_next),
    ):
        workbench.shortcuts.add(Key(sequence, text, group), slot, within=within)
