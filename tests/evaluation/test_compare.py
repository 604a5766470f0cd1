"""A whole comparison on a small sequence: the tables, going on, and what can go wrong."""

from __future__ import annotations

import csv
import json
import shutil
import subprocess
import sys
from collections.abc import Generator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np
import pytest

from pv_inspect.common.work import Progress, result_of
from pv_inspect.errors import InspectionError
from pv_inspect.evaluation import cell_images
from pv_inspect.evaluation.case import Case, Cell, prepared, sampled_cells
from pv_inspect.evaluation.compare import ComparisonFolder, compare_all
from pv_inspect.evaluation.methods import Bicubic, CellImages, MeanOfFrames, Method, methods_named
from pv_inspect.evaluation.scoring import Row
from pv_inspect.evaluation.tables import average_rows
from pv_inspect.evaluation.truth import Truth, read_truth
from pv_inspect.geometry.layout import ModuleLayout
from pv_inspect.sequence.sequence import FrameSequence
from pv_inspect.settings import Settings

N_CELLS = 6


@dataclass(frozen=True)
class Known:
    """Returns the truth, and counts how often it was asked."""

    truth: Truth
    asked: list[int]
    name: str = "KNOWN"
    frames: Literal["one", "all"] = "all"
    cell_by_cell: bool = True
    note: str = "the truth itself"

    def images(self, case: Case, cells: Sequence[Cell]) -> CellImages:
        grid = case.grid
        for cell in cells:
            self.asked.append(1)
            window = grid.cell_slices(*cell)
            yield cell, self.truth.on(grid, window)  # type: ignore[arg-type]


@dataclass(frozen=True)
class Missing:
    """A method whose package is not there."""

    name: str = "MISSING"
    frames: Literal["one", "all"] = "one"
    cell_by_cell: bool = True
    note: str = "never there"

    def images(self, case: Case, cells: Sequence[Cell]) -> CellImages:
        yield Progress(0.0, f"looking for the package for {len(cells)} cells of {case.grid.shape}")
        raise InspectionError("MISSING needs a package that is not installed.")


def truth_of(folder: Path) -> Truth:
    read = read_truth(folder)
    assert read is not None
    return read[0]


def run(
    out: Path, sequence: Path, methods: Sequence[Method], *, with_truth: bool = True
) -> list[Row]:
    folder = ComparisonFolder.at(out)
    with folder.reserved():
        plans = folder.plans([sequence], [Settings(magnification=3)], methods, N_CELLS, 0)
        steps = compare_all(folder, plans, "pv-inspect compare", with_truth=with_truth)
        return result_of(steps)


@pytest.fixture(scope="module")
def quick_case(quick_folder: Path) -> Case:
    return result_of(prepared(FrameSequence.open(quick_folder), Settings(magnification=3)))


@pytest.fixture(autouse=True)
def one_geometry(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    """The geometry is found once: it is not what these tests are about."""
    case = request.getfixturevalue("quick_case")

    def found(_sequence: FrameSequence, _settings: Settings) -> Generator[Progress, None, Case]:
        yield Progress(1.0, "known")
        return case

    monkeypatch.setattr(cell_images, "prepared", found)


@pytest.fixture(scope="module")
def made(quick_folder: Path, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, list[Row]]:
    out = tmp_path_factory.mktemp("compared") / "out"
    methods = (Bicubic(), MeanOfFrames(), Known(truth_of(quick_folder), []), Missing())
    return out, run(out, quick_folder, methods)


def test_a_method_that_returns_the_truth_scores_1(made: tuple[Path, list[Row]]) -> None:
    row = {row.method: row for row in made[1]}["KNOWN"]
    assert row.image is not None
    assert row.image.psnr_db > 100
    assert row.image.ssim == pytest.approx(1.0, abs=1e-6)
    score = row.cracks["table1"]
    assert (score.precision, score.recall, score.f1, score.ap) == pytest.approx((1, 1, 1, 1))
    assert (score.instance_precision, score.instance_recall) == pytest.approx((1, 1))


def test_all_methods_are_scored_on_the_same_cells(made: tuple[Path, list[Row]]) -> None:
    out, rows = made
    scored = [row for row in rows if not row.failed]
    assert {row.cells for row in scored} == {N_CELLS}
    files = [
        sorted(p.name for p in (out / "quick" / "3x" / r.method).glob("*.tif")) for r in scored
    ]
    assert all(names == files[0] for names in files)


def test_what_failed_says_why_and_has_no_figures(made: tuple[Path, list[Row]]) -> None:
    row = {row.method: row for row in made[1]}["MISSING"]
    assert row.failed == "MISSING needs a package that is not installed."
    assert row.image is None
    assert not row.cracks
    assert "MISSING needs a package" in (made[0] / "table.md").read_text()
    assert "MISSING needs a package" in (made[0] / "compare.html").read_text()


def test_the_table_has_one_line_for_every_method(made: tuple[Path, list[Row]]) -> None:
    out, rows = made
    with (out / "table.csv").open() as file:
        lines = list(csv.DictReader(file))
    assert [line["method"] for line in lines] == [row.method for row in rows]
    assert float(lines[0]["flat_psnr_db"]) == rows[0].image.flat_psnr_db  # type: ignore[union-attr]
    record = json.loads((out / "compare.json").read_text())
    assert record["versions"]["pv-inspect"]
    assert record["settings"][0]["magnification"] == 3


def test_the_page_shows_the_crops_and_asks_nothing_of_a_network(
    made: tuple[Path, list[Row]],
) -> None:
    page = (made[0] / "compare.html").read_text()
    assert page.count('<div class="crop"') == 3 * 4  # BICUBIC, MEAN, KNOWN, truth
    assert "http" not in page.replace("http-equiv", "")


def test_the_order_of_the_methods_changes_nothing(
    quick_folder: Path, made: tuple[Path, list[Row]], tmp_path: Path
) -> None:
    turned = run(tmp_path / "turned", quick_folder, (MeanOfFrames(), Bicubic()))
    before = {row.method: row for row in made[1]}
    for row in turned:
        assert row.image == before[row.method].image
        assert row.cracks == before[row.method].cracks


def test_a_rerun_makes_only_what_is_missing(quick_folder: Path, tmp_path: Path) -> None:
    asked: list[int] = []
    method = Known(truth_of(quick_folder), asked)
    first = run(tmp_path / "out", quick_folder, [method])
    assert len(asked) == N_CELLS
    (next((tmp_path / "out").rglob("*.tif"))).unlink()
    again = run(tmp_path / "out", quick_folder, [method])
    assert len(asked) == N_CELLS + 1
    assert again[0].image == first[0].image


def test_images_of_other_frames_are_not_taken_for_these(quick_folder: Path, tmp_path: Path) -> None:
    sequence = tmp_path / "quick"
    shutil.copytree(quick_folder, sequence)
    asked: list[int] = []
    method = Known(truth_of(quick_folder), asked)
    run(tmp_path / "out", sequence, [method])
    (sequence / "frames" / "frame_007.tif").unlink()
    run(tmp_path / "out", sequence, [method])
    assert len(asked) == 2 * N_CELLS


def test_without_truth_images_are_made_and_not_scored(quick_folder: Path, tmp_path: Path) -> None:
    rows = run(tmp_path / "out", quick_folder, [Bicubic()], with_truth=False)
    assert rows[0].image is None
    assert rows[0].cells == N_CELLS
    assert (tmp_path / "out" / "compare.html").read_text().count('<div class="crop"') == 3


def test_averages_leave_out_methods_that_failed_somewhere(made: tuple[Path, list[Row]]) -> None:
    rows = made[1]
    assert average_rows(rows) == []  # of one sequence there is nothing to average
    other = [replace(row, sequence="other", cpu_s=row.cpu_s + 2) for row in rows]
    averages = {row["method"]: row for row in average_rows([*rows, *other])}
    assert list(averages) == ["BICUBIC", "MEAN", "KNOWN"]
    assert averages["MEAN"]["cpu_s"] == pytest.approx(rows[1].cpu_s + 1, abs=0.01)


def test_a_folder_of_something_else_is_refused(tmp_path: Path) -> None:
    (tmp_path / "notes.txt").write_text("mine")
    with pytest.raises(InspectionError, match="holds no comparison"):
        ComparisonFolder.at(tmp_path)
    assert (tmp_path / "notes.txt").read_text() == "mine"


def test_two_sequences_of_one_name_are_refused(tmp_path: Path) -> None:
    folder = ComparisonFolder.at(tmp_path / "out")
    with pytest.raises(InspectionError, match="wanted 2 times"):
        folder.plans([Path("a/D2"), Path("b/D2")], [Settings()], [Bicubic()], 1, 0)


def test_an_unknown_method_is_named_with_those_there_are() -> None:
    with pytest.raises(InspectionError, match=r"no method 'esrgan'.*BICUBIC.*OURS-P"):
        methods_named(["esrgan"])


def test_the_draw_of_cells_is_that_of_its_seed() -> None:
    layout = ModuleLayout(6, 10)
    cells = sampled_cells(layout, 20, 1)
    assert cells == sampled_cells(layout, 20, 1) != sampled_cells(layout, 20, 2)
    assert len(set(cells)) == 20
    assert cells == sorted(cells)
    assert sampled_cells(layout, 100, 1) == [(r, c) for r in range(6) for c in range(10)]
    assert np.ptp([row for row, _ in cells]) > 0


def test_halves_of_the_frames_are_compared_without_truth(
    quick_folder: Path, tmp_path: Path
) -> None:
    folder = ComparisonFolder.at(tmp_path / "out")
    with folder.reserved():
        settings = [Settings(magnification=3)]
        plans = folder.plans(
            [quick_folder], settings, [Bicubic(), MeanOfFrames()], N_CELLS, 0, halves=True
        )
        rows = result_of(compare_all(folder, plans, "pv-inspect compare", with_truth=False))
    one, mean = (row.half_frc_cutoff for row in rows)
    assert one is not None
    assert mean is not None
    assert 0 < one < mean  # noise of four frames is half of that of one
    assert "half_frc_cutoff" in (tmp_path / "out" / "table.csv").read_text()


def test_one_frame_has_no_halves(quick_case: Case) -> None:
    used = np.arange(len(quick_case.sequence)) == 2
    alone = replace(quick_case, registration=replace(quick_case.registration, used=used))
    assert alone.half(0).registration.used.tolist() == used.tolist()
    with pytest.raises(InspectionError, match="no halves"):
        alone.half(1)


def test_halves_share_no_frame(quick_case: Case) -> None:
    first, second = (quick_case.half(k).registration.used for k in (0, 1))
    assert not (first & second).any()
    assert ((first | second) == quick_case.registration.used).all()


def test_the_cpu_time_of_a_process_that_a_method_starts_counts() -> None:
    busy = "import time\nwhile time.process_time() < 0.3: pass"
    since = cell_images._cpu_s()
    subprocess.run([sys.executable, "-c", busy], check=True)
    assert cell_images._cpu_s() - since > 0.25
