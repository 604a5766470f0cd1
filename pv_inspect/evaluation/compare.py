"""A whole comparison: all sequences and magnifications by all methods, in one folder."""

from __future__ import annotations

from collections import Counter
from collections.abc import Generator, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from pv_inspect.common.versions import versions
from pv_inspect.common.work import Progress, forwarded
from pv_inspect.errors import InspectionError
from pv_inspect.evaluation.cell_images import Plan, compared
from pv_inspect.evaluation.methods import Method
from pv_inspect.evaluation.page import Strip, page, strips_of
from pv_inspect.evaluation.scoring import Row, known_cells, rows_of
from pv_inspect.evaluation.tables import csv_table, markdown_tables, settings_json
from pv_inspect.settings import Settings
from pv_inspect.storage.folders import replace_file
from pv_inspect.storage.output_paths import output_folder, shown
from pv_inspect.storage.reservations import reserved_files

__all__ = ["ComparisonFolder", "compare_all"]

MARKER = "compare.json"
# The images take the time, not the scores.
_IMAGES = 0.95


@dataclass(frozen=True)
class ComparisonFolder:
    """The folder of a comparison.

    Parameters
    ----------
    path : Path
        Without links.
    """

    path: Path

    @classmethod
    def at(cls, out: Path) -> ComparisonFolder:
        """Check a place for a comparison.

        Raises
        ------
        InspectionError
            If it holds something else.
        """
        path = output_folder(out)
        if path.is_dir() and any(path.iterdir()) and not (path / MARKER).is_file():
            raise InspectionError(
                f"{shown(out)} is not empty and holds no comparison: give another folder."
            )
        return cls(path)

    @contextmanager
    def reserved(self) -> Iterator[None]:
        """Keep other processes away, and mark the folder as a comparison."""
        with reserved_files(self.path):
            if not (self.path / MARKER).is_file():
                replace_file(self.path / MARKER, settings_json({}).encode())
            yield

    def plans(
        self,
        sequences: Sequence[Path],
        settings: Sequence[Settings],
        methods: Sequence[Method],
        n_cells: int,
        seed: int,
        halves: bool = False,
    ) -> list[Plan]:
        """Plan every sequence at every magnification.

        Raises
        ------
        InspectionError
            If two sequences have one name, which their images would share.
        """
        plans = [
            Plan(sequence, one, tuple(methods), n_cells, seed, halves)
            for sequence in sequences
            for one in settings
        ]
        for name, count in Counter(plan.folder for plan in plans).items():
            if count > 1:
                raise InspectionError(
                    f"{name} is wanted {count} times: give each sequence and magnification once, "
                    "and sequences of one name in comparisons of their own."
                )
        return plans


def compare_all(
    folder: ComparisonFolder, plans: Sequence[Plan], command: str, *, with_truth: bool = True
) -> Generator[Progress, None, list[Row]]:
    """Make and score all images, and write the tables and the page.

    Parameters
    ----------
    folder : ComparisonFolder
        Reserved.
    plans : sequence of Plan
    command : str
        What is said to have made it.
    with_truth : bool

    Yields
    ------
    Progress
        Closing the generator cancels; finished cells stay.

    Returns
    -------
    list of Row

    Raises
    ------
    InspectionError
        If frames or truth can't be used or the folder can't be written.
    """
    rows: list[Row] = []
    strips: list[Strip] = []
    for k, plan in enumerate(plans):

        def part(step: Progress, k: int = k) -> Progress:
            return Progress((k + _IMAGES * step.fraction) / len(plans), step.message)

        made = yield from forwarded(compared(plan, folder.path), part)
        known = known_cells(made) if with_truth else None

        def scored(step: Progress, k: int = k) -> Progress:
            return Progress((k + _IMAGES) / len(plans), step.message)

        rows += yield from forwarded(rows_of(made, known), scored)
        strips += strips_of(made, None if known is None else known.radiance)
    told = ", ".join(f"{name} {version}" for name, version in versions().items())
    place = folder.path
    replace_file(place / "table.csv", csv_table(rows).encode())
    replace_file(place / "table.md", markdown_tables(rows).encode())
    replace_file(place / "compare.html", page(rows, strips, command, told).encode())
    record = {"command": command, "settings": [p.settings.model_dump(mode="json") for p in plans]}
    replace_file(place / MARKER, settings_json(record).encode())
    return rows
