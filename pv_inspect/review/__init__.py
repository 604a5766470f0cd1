"""The expert's verdicts, cell by cell: what they mean, where they are kept, what they come to."""

from __future__ import annotations

from pv_inspect.review.entries import Change, Entry
from pv_inspect.review.measuring import Measure, measured
from pv_inspect.review.selection import (
    Order,
    Progress,
    filtered,
    next_unjudged,
    ordered,
    progress,
)
from pv_inspect.review.store import REVIEW_FILE, ReviewState, ReviewStore
from pv_inspect.review.tables import verdicts_csv
from pv_inspect.review.verdicts import (
    Cell,
    ModuleData,
    Verdict,
    VerdictKind,
    fingerprint,
    of_rater,
)

__all__ = [
    "REVIEW_FILE",
    "Cell",
    "Change",
    "Entry",
    "Measure",
    "ModuleData",
    "Order",
    "Progress",
    "ReviewState",
    "ReviewStore",
    "Verdict",
    "VerdictKind",
    "filtered",
    "fingerprint",
    "measured",
    "next_unjudged",
    "of_rater",
    "ordered",
    "progress",
    "verdicts_csv",
]
