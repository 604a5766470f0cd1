"""The files of a comparison: a tidy table, a table to read, and what made them."""

from __future__ import annotations

import json
from collections.abc import Sequence
from typing import Any

import numpy as np

from pv_inspect.common.csv_tables import csv_text
from pv_inspect.common.versions import versions
from pv_inspect.evaluation.scoring import PROTOCOLS, Row

__all__ = ["MEAN_OF_ALL", "average_rows", "csv_table", "markdown_tables", "settings_json"]

MEAN_OF_ALL = "mean"
"""Stands in the place of the sequence in rows of averages."""

_COLUMNS = (
    ("flat_psnr_db", "PSNR, dB", 2),
    ("ssim", "SSIM", 3),
    ("frc_cutoff", "FRC, cycles/LR px", 2),
    ("half_frc_cutoff", "FRC of halves", 2),
)
_TABLE1 = (
    ("precision", "precision"),
    ("recall", "recall"),
    ("ap", "AP"),
    ("f1", "F1"),
    ("instance_precision", "inst. precision"),
    ("instance_recall", "inst. recall"),
    ("instance_f1", "inst. F1"),
)


def csv_table(rows: Sequence[Row]) -> str:
    """Return one line for every row, with all figures."""
    tables = [row.figures() for row in rows]
    names = list(dict.fromkeys(name for table in tables for name in table))
    names.sort(key=lambda name: name in ("note", "failed"))
    return csv_text([names, *([table.get(name, "") for name in names] for table in tables)])


def average_rows(rows: Sequence[Row]) -> list[dict[str, Any]]:
    """Average the figures of each method at each magnification over all sequences.

    A method that failed on a sequence has no average: it would be over other images. Of one
    sequence there is none at all.
    """
    found: list[dict[str, Any]] = []
    sequences = {row.sequence for row in rows}
    if len(sequences) == 1:
        return found
    groups = dict.fromkeys((row.magnification, row.method) for row in rows)
    for magnification, method in groups:
        some = [r for r in rows if (r.magnification, r.method) == (magnification, method)]
        if any(row.failed for row in some) or len(some) < len(sequences):
            continue
        figures = [row.figures() for row in some]
        mean: dict[str, Any] = {"sequence": MEAN_OF_ALL}
        for name, value in figures[0].items():
            values = [table.get(name) for table in figures]
            if isinstance(value, float) and all(isinstance(v, float | int) for v in values):
                mean[name] = float(np.mean(np.asarray(values, np.float64)))
        found.append(mean | {"magnification": magnification, "method": method, "failed": ""})
    return found


def markdown_tables(rows: Sequence[Row]) -> str:
    """Return all tables in Markdown: images, cracks by each protocol, methods."""
    tables = [row.figures() for row in rows] + average_rows(rows)
    lines = ["# Comparison", "", _images(tables)]
    for protocol, told in PROTOCOLS.items():
        if any(f"{protocol}_ap" in table for table in tables):
            lines += ["", f"## Cracks: {told}", "", _cracks(tables, protocol)]
    lines += ["", "## Methods", ""]
    notes = {row.method: row.note for row in rows}
    lines += [f"- **{method}**: {note}" for method, note in notes.items()]
    failed = [row for row in rows if row.failed]
    if failed:
        lines += ["", "## Without figures", ""]
        lines += [
            f"- {row.method} on {row.sequence} at {row.magnification:g}x: {row.failed}"
            for row in failed
        ]
    return "\n".join(lines) + "\n"


def settings_json(commands: dict[str, Any]) -> str:
    """Return what was compared, with the versions of what computes, as JSON."""
    return json.dumps(commands | {"versions": versions()}, indent=1) + "\n"


def _images(tables: Sequence[dict[str, Any]]) -> str:
    head = [
        "sequence",
        "x",
        "method",
        *(title for _, title, _ in _COLUMNS),
        "shift, LR px",
        "CPU s",
    ]
    lines = []
    for table in tables:
        if table.get("failed"):
            continue
        shift = "–"
        if "shift_x_lr_px" in table:
            shift = f"{table['shift_x_lr_px']:+.2f}, {table['shift_y_lr_px']:+.2f}"
        figures = [_text(table.get(name), digits) for name, _, digits in _COLUMNS]
        lines.append([*_place(table), *figures, shift, _text(table.get("cpu_s"), 1)])
    return _table(head, lines, 3)


def _cracks(tables: Sequence[dict[str, Any]], protocol: str) -> str:
    head = ["sequence", "x", "method", *(title for _, title in _TABLE1)]
    lines = [
        [*_place(table), *(_text(table[f"{protocol}_{name}"], 3) for name, _ in _TABLE1)]
        for table in tables
        if f"{protocol}_ap" in table
    ]
    return _table(head, lines, 3)


def _place(table: dict[str, Any]) -> list[str]:
    return [str(table["sequence"]), f"{table['magnification']:g}", str(table["method"])]


def _text(value: object, digits: int) -> str:
    known = isinstance(value, int | float) and np.isfinite(value)
    return f"{value:.{digits}f}" if known else "–"


def _table(head: Sequence[str], lines: Sequence[Sequence[str]], texts: int) -> str:
    rule = ["---" if k < texts else "--:" for k in range(len(head))]
    return "\n".join("| " + " | ".join(line) + " |" for line in (head, rule, *lines))
