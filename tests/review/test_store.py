from __future__ import annotations

import os
import resource
import shutil
import signal
import sqlite3
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from threading import Thread

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pv_inspect.errors import InspectionError
from pv_inspect.review import (
    REVIEW_FILE,
    ModuleData,
    ReviewState,
    ReviewStore,
    Verdict,
    VerdictKind,
    of_rater,
)
from pv_inspect.storage.folders import replace_folder

SRC = str(Path(__file__).parents[2])
CELLS = [(0, 0), (0, 1), (1, 0)]
KINDS = list(VerdictKind)

# Gives verdicts one after the other and says after each that it is stored.
WRITER = """
import sys
from pathlib import Path
from pv_inspect.review import ReviewStore, Verdict, VerdictKind
folder, rater, first, count = Path(sys.argv[1]), sys.argv[2], int(sys.argv[3]), int(sys.argv[4])
store, kinds = ReviewStore(folder, busy_s=20), list(VerdictKind)
for n in range(first, first + count):
    store.give(Verdict(n // 6, n % 6, kinds[n % 8], rater, note=str(n)))
    print(n, flush=True)
"""


def verdict(row: int, col: int, kind: VerdictKind, rater: str = "Ann", note: str = "") -> Verdict:
    return Verdict(row, col, kind, rater, note)


def writer(folder: Path, rater: str, first: int, count: int) -> subprocess.Popen[str]:
    return subprocess.Popen(
        [sys.executable, "-c", WRITER, str(folder), rater, str(first), str(count)],
        stdout=subprocess.PIPE,
        text=True,
        env={**os.environ, "PYTHONPATH": SRC},
    )


@contextmanager
def unprivileged() -> Iterator[None]:
    """Without the rights of the administrator, to whom every folder can be written."""
    if os.geteuid() != 0:
        yield
        return
    os.seteuid(65534)
    try:
        yield
    finally:
        os.seteuid(0)


@pytest.fixture
def open_folder() -> Iterator[Path]:
    """A folder in which everybody may read."""
    folder = Path(tempfile.mkdtemp())
    folder.chmod(0o755)
    yield folder
    shutil.rmtree(folder)


def test_what_is_stored_is_read_back_as_it_was(tmp_path: Path) -> None:
    stored = Verdict(
        1, 2, VerdictKind.CRACK_B, "Änn O'Neil", 'dünn; "quer"\n2. Zeile', "abc", "2026-01-01T00Z"
    )
    with ReviewStore(tmp_path) as store:
        store.give(stored)
    assert ReviewStore(tmp_path).current() == (stored,)


def test_looking_at_a_result_without_a_review_makes_no_file(tmp_path: Path) -> None:
    store = ReviewStore(tmp_path)
    assert store.current() == ()
    assert store.history() == ()
    assert store.raters() == ()
    assert store.masks() == {}
    assert store.mask((0, 0), "Ann") is None
    assert store.undo("Ann") is None
    assert not store.can_undo("Ann")
    assert not store.can_redo("Ann")
    assert store.remembered() is None
    assert store.module_data() == ModuleData()
    assert store.data_version() == 0
    assert list(tmp_path.iterdir()) == []


class Model:
    """Undo and redo by lists of whole states, per rater."""

    def __init__(self) -> None:
        self.done: list[dict[tuple[int, int], object]] = [{}]
        self.undone: list[dict[tuple[int, int], object]] = []

    def edit(self, cell: tuple[int, int], value: object) -> None:
        self.done.append({**self.done[-1], cell: value})
        self.undone.clear()

    def undo(self) -> None:
        if len(self.done) > 1:
            self.undone.append(self.done.pop())

    def redo(self) -> None:
        if self.undone:
            self.done.append(self.undone.pop())


ACTIONS = st.tuples(
    st.sampled_from(["give", "give", "withdraw", "mask", "undo", "redo"]),
    st.sampled_from(["Ann", "Bob"]),
    st.sampled_from(CELLS),
    st.integers(0, 7),
)


@settings(max_examples=20, deadline=None)
@given(st.lists(ACTIONS, max_size=16), st.integers(0, 25))
def test_undo_and_redo_do_as_a_plain_list_of_states_would(
    actions: list[tuple[str, str, tuple[int, int], int]], reopen_at: int
) -> None:
    with tempfile.TemporaryDirectory() as folder:
        store = ReviewStore(Path(folder))
        models = {"Ann": Model(), "Bob": Model()}
        for n, (action, rater, cell, k) in enumerate(actions):
            model = models[rater]
            kind, mask = model.done[-1].get(cell, (None, None))  # type: ignore[misc]
            if action == "give":
                store.give(verdict(*cell, KINDS[k], rater))
                model.edit(cell, (KINDS[k], mask))
            elif action == "withdraw":
                store.withdraw(cell, rater)
                model.edit(cell, (None, mask))
            elif action == "mask":
                drawn = np.arange(8).reshape(2, 4) == k
                store.correct(cell, rater, drawn, float(k))
                model.edit(cell, (kind, k))
            elif action == "undo":
                assert store.can_undo(rater) == (len(model.done) > 1)
                assert (store.undo(rater) is not None) == (len(model.done) > 1)
                model.undo()
            else:
                assert store.can_redo(rater) == bool(model.undone)
                assert (store.redo(rater) is not None) == bool(model.undone)
                model.redo()
            if n == reopen_at:
                store.close()
                store = ReviewStore(Path(folder))
        for rater, model in models.items():
            held = of_rater(store.current(), rater)
            for cell in CELLS:
                kind, k = model.done[-1].get(cell, (None, None))  # type: ignore[misc]
                found, drawn_now = held.get(cell), store.mask(cell, rater)
                assert (found.kind if found else None) == kind
                assert (None if drawn_now is None else int(drawn_now.argmax())) == k
                assert found is None or found.crack_length_cells == k
        assert len(store.history()) >= sum(a in ("give", "mask") for a, *_ in actions)
        store.close()


def test_undo_says_which_cell_it_has_changed_and_the_old_verdict_keeps_its_time(
    tmp_path: Path,
) -> None:
    store = ReviewStore(tmp_path)
    first = verdict(0, 1, VerdictKind.OK)
    store.give(first)
    store.give(verdict(0, 1, VerdictKind.CRACK_C))
    change = store.undo("Ann")
    assert change is not None
    assert (change.cell, change.verdict, change.mask_changed) == ((0, 1), first, False)
    assert [entry.action for entry in store.history()] == ["edit", "edit", "undo"]


def test_the_history_can_be_neither_changed_nor_cut(tmp_path: Path) -> None:
    with ReviewStore(tmp_path) as store:
        store.give(verdict(0, 0, VerdictKind.OK))
    connection = sqlite3.connect(tmp_path / REVIEW_FILE)
    for statement in ("DELETE FROM history", "UPDATE history SET kind = 'crack_c'"):
        with pytest.raises(sqlite3.IntegrityError, match="append-only"):
            connection.execute(statement)
    connection.close()


@settings(max_examples=12, deadline=None)
@given(st.integers(1, 40), st.integers(1, 40), st.integers(0, 2**32 - 1))
def test_a_corrected_mask_comes_back_pixel_by_pixel(h: int, w: int, seed: int) -> None:
    mask = np.random.default_rng(seed).random((h, w)) < 0.3
    with tempfile.TemporaryDirectory() as folder, ReviewStore(Path(folder)) as store:
        store.correct((0, 0), "Ann", mask, 0.5, 0.25)
        found = store.mask((0, 0), "Ann")
        assert found is not None
        assert found.dtype == np.bool_
        np.testing.assert_array_equal(found, mask)
        assert store.current() == ()  # a correction is no verdict
        store.give(verdict(0, 0, VerdictKind.CRACK_A))
        (given_,) = store.current()
        assert (given_.crack_length_cells, given_.isolated_area_share) == (0.5, 0.25)
        store.correct((0, 0), "Ann", None)
        assert store.masks() == {}
        assert store.current()[0].crack_length_cells is None


def test_only_masks_of_truth_values_are_taken(tmp_path: Path) -> None:
    with pytest.raises(InspectionError, match=r"float64 of shape \(2, 2\): give \(h, w\) bool"):
        ReviewStore(tmp_path).correct((0, 0), "Ann", np.zeros((2, 2)))  # type: ignore[arg-type]


def test_where_one_was_and_what_the_module_is_are_remembered(tmp_path: Path) -> None:
    with ReviewStore(tmp_path) as store:
        store.remember(ReviewState("Ann", 0, 3))
        store.remember(ReviewState("Bob", 2, 2))
        store.remember(ReviewState("Ann", 1, 4))
        store.describe(ModuleData("SN 7", 8.9))
    with ReviewStore(tmp_path) as store:
        assert store.remembered() == ReviewState("Ann", 1, 4)
        assert store.remembered("Bob") == ReviewState("Bob", 2, 2)
        assert store.remembered("Cid") is None
        assert store.module_data() == ModuleData("SN 7", 8.9)


def test_every_acknowledged_verdict_survives_a_kill_in_the_middle_of_writing(
    tmp_path: Path,
) -> None:
    said = -1
    for round_ in range(3):
        process = writer(tmp_path, "Ann", said + 1, 10_000)
        assert process.stdout is not None
        for _ in range(5 + 3 * round_):
            process.stdout.readline()
        process.send_signal(signal.SIGKILL)
        rest = process.stdout.read().split()  # what was acknowledged until then
        process.wait()
        process.stdout.close()
        with ReviewStore(tmp_path) as store:
            notes = [entry.verdict.note for entry in store.history() if entry.verdict]
            acknowledged = int(rest[-1]) if rest else said + 5 + 3 * round_
            # One more may have been stored whose acknowledgement was cut off.
            said = int(notes[-1])
            assert said in (acknowledged, acknowledged + 1)
            assert notes == [str(n) for n in range(said + 1)]
            assert len(store.current()) == said + 1


def test_two_raters_who_write_at_the_same_time_lose_nothing_and_see_each_other(
    tmp_path: Path,
) -> None:
    with ReviewStore(tmp_path) as store:
        version = store.data_version()
        processes = [writer(tmp_path, rater, 0, 40) for rater in ("Ann", "Bob")]
        for process in processes:
            process.communicate()
            assert process.returncode == 0
        assert store.data_version() != version
        found = store.current()
        assert [len(of_rater(found, rater)) for rater in ("Ann", "Bob")] == [40, 40]
        assert store.raters() == ("Ann", "Bob")
        assert len(store.history()) == 80


def test_threads_may_share_a_store(tmp_path: Path) -> None:
    with ReviewStore(tmp_path) as store:

        def write(rater: str) -> None:
            for col in range(20):
                store.give(verdict(0, col, VerdictKind.OK, rater))
                store.current()

        threads = [Thread(target=write, args=(rater,)) for rater in ("Ann", "Bob", "Cid")]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
        assert len(store.current()) == 60


def test_a_verdict_that_another_program_keeps_out_is_told_and_can_be_given_again(
    tmp_path: Path,
) -> None:
    store = ReviewStore(tmp_path, busy_s=0.05)
    store.give(verdict(0, 0, VerdictKind.OK))
    other = sqlite3.connect(tmp_path / REVIEW_FILE, isolation_level=None)
    other.execute("BEGIN EXCLUSIVE")
    with pytest.raises(InspectionError, match="is held by another program: try again"):
        store.give(verdict(0, 1, VerdictKind.OK))
    other.execute("ROLLBACK")
    other.close()
    store.give(verdict(0, 1, VerdictKind.OK))
    assert len(store.current()) == 2
    store.close()


def test_a_full_disk_is_told_and_the_verdict_can_be_given_again(tmp_path: Path) -> None:
    store = ReviewStore(tmp_path)
    store.give(verdict(0, 0, VerdictKind.OK))
    assert store._connection is not None
    (pages,) = store._connection.execute("PRAGMA page_count").fetchone()
    store._connection.execute(f"PRAGMA max_page_count = {pages}")
    long = verdict(0, 1, VerdictKind.OTHER, note="x" * 100_000)
    for _ in range(2):
        with pytest.raises(InspectionError, match=r"the disk is full; free some space and try aga"):
            store.give(long)
        assert [v.cell for v in store.current()] == [(0, 0)]
    store._connection.execute(f"PRAGMA max_page_count = {pages + 1000}")
    store.give(long)
    store.close()
    assert ReviewStore(tmp_path).current()[1] == long


def test_a_disk_that_refuses_to_write_leaves_the_verdicts_before(tmp_path: Path) -> None:
    """The system itself refuses: no file of this process may grow beyond a limit."""
    with ReviewStore(tmp_path) as store:
        store.give(verdict(0, 0, VerdictKind.OK))
        soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
        resource.setrlimit(resource.RLIMIT_FSIZE, (2048, hard))
        try:
            with pytest.raises(InspectionError, match=r"disk.*try again \(all that was stored"):
                store.give(verdict(0, 1, VerdictKind.CRACK_C))
        finally:
            resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
        assert [v.cell for v in store.current()] == [(0, 0)]
        store.give(verdict(0, 1, VerdictKind.CRACK_C))
    assert len(ReviewStore(tmp_path).current()) == 2


def test_a_write_protected_review_can_be_read_and_says_that_it_cannot_be_written(
    open_folder: Path,
) -> None:
    with ReviewStore(open_folder) as store:
        store.give(verdict(0, 0, VerdictKind.OK))
    open_folder.chmod(0o555)
    (open_folder / REVIEW_FILE).chmod(0o444)
    before = (open_folder / REVIEW_FILE).read_bytes()
    with unprivileged(), ReviewStore(open_folder) as store:
        assert len(store.current()) == 1
        with pytest.raises(InspectionError, match=r"can't be written: .* write-protected or gone"):
            store.give(verdict(0, 1, VerdictKind.OK))
        assert len(store.current()) == 1
    assert (open_folder / REVIEW_FILE).read_bytes() == before


def test_a_write_protected_folder_without_a_review_is_told_at_the_first_verdict(
    open_folder: Path,
) -> None:
    open_folder.chmod(0o555)
    with unprivileged(), ReviewStore(open_folder) as store:
        assert store.current() == ()
        with pytest.raises(InspectionError, match=r"can't be written: .* write-protected or gone"):
            store.give(verdict(0, 1, VerdictKind.OK))
    assert list(open_folder.iterdir()) == []


@pytest.mark.parametrize("damage", ["noise", "short", "half", "hole"])
def test_a_damaged_file_is_told_in_one_sentence_and_stays_as_it_is(
    tmp_path: Path, damage: str
) -> None:
    with ReviewStore(tmp_path) as store:
        for n in range(60):
            store.correct((0, n), "Ann", np.random.default_rng(n).random((30, 30)) < 0.5)
    path = tmp_path / REVIEW_FILE
    whole = path.read_bytes()
    hole = whole[:8192] + bytes(8192) + whole[16384:]
    damaged = {"noise": b"x" * 5000, "short": b"SQLite", "half": whole[: len(whole) // 2]}
    path.write_bytes(damaged.get(damage, hole))
    before = path.read_bytes()
    for act in (ReviewStore.current, lambda s: s.give(verdict(0, 0, VerdictKind.OK))):
        store = ReviewStore(tmp_path)
        with pytest.raises(InspectionError, match=r"is damaged or no review .* it was not changed"):
            act(store)
        store.close()
    assert path.read_bytes() == before


def test_a_database_of_another_program_is_not_touched(tmp_path: Path) -> None:
    path = tmp_path / REVIEW_FILE
    connection = sqlite3.connect(path)
    connection.execute("CREATE TABLE mine (x)")
    connection.close()
    before = path.read_bytes()
    with pytest.raises(InspectionError, match="it is a database of another program"):
        ReviewStore(tmp_path).give(verdict(0, 0, VerdictKind.OK))
    assert path.read_bytes() == before


def test_a_review_of_a_newer_version_is_refused(tmp_path: Path) -> None:
    with ReviewStore(tmp_path) as store:
        store.give(verdict(0, 0, VerdictKind.OK))
    connection = sqlite3.connect(tmp_path / REVIEW_FILE)
    connection.execute("PRAGMA user_version = 99")
    connection.close()
    with pytest.raises(InspectionError, match=r"newer version of pv-inspect \(format 99, this one"):
        ReviewStore(tmp_path).current()


@pytest.mark.parametrize("links", [True, False])
def test_verdicts_stay_while_the_result_is_replaced_under_them(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, links: bool
) -> None:
    """A run into the folder of a module that is being reviewed replaces it as a whole."""
    if not links:

        def refuse(*_: object, **__: object) -> None:
            raise OSError("no hard links here")

        monkeypatch.setattr(os, "link", refuse)
    folder = tmp_path / "out"
    folder.mkdir()
    (folder / "result.json").write_text("old")
    with ReviewStore(folder) as store:
        store.give(verdict(0, 0, VerdictKind.OK))
        new = [("result.json", b"new")]
        replace_folder(folder, new, "result.json", lambda path: path.name == "result.json")
        store.give(verdict(0, 1, VerdictKind.CRACK_A))
        assert len(store.current()) == 2
    assert len(ReviewStore(folder).current()) == 2


def test_a_file_that_was_taken_away_is_told_and_not_begun_anew(tmp_path: Path) -> None:
    store = ReviewStore(tmp_path)
    store.give(verdict(0, 0, VerdictKind.OK))
    (tmp_path / REVIEW_FILE).rename(tmp_path / "elsewhere")
    with pytest.raises(InspectionError, match="is gone although it was in use"):
        store.give(verdict(0, 1, VerdictKind.OK))
    (tmp_path / "elsewhere").rename(tmp_path / REVIEW_FILE)
    store.give(verdict(0, 1, VerdictKind.OK))
    assert len(store.current()) == 2
    store.close()


def test_an_edit_is_undone_by_its_number_whatever_came_after_it(tmp_path: Path) -> None:
    with ReviewStore(tmp_path) as store:
        first = store.give(verdict(0, 0, VerdictKind.OK))
        store.give(verdict(0, 1, VerdictKind.CRACK_A))
        store.correct((0, 0), "Ann", np.ones((2, 2), bool), 1.0)
        change = store.undo("Ann", first)
        assert change is not None
        assert (change.cell, change.verdict, change.superseded) == ((0, 0), None, False)
        assert [v.cell for v in store.current()] == [(0, 1)]
        assert store.mask((0, 0), "Ann") is not None
        store.redo("Ann", first)
        assert [v.kind for v in store.current()] == [VerdictKind.OK, VerdictKind.CRACK_A]
        assert store.current()[0].crack_length_cells == 1.0
        assert store.undo("Bob", first) is None


def test_an_undo_does_not_take_away_what_was_said_later(tmp_path: Path) -> None:
    with ReviewStore(tmp_path) as store:
        first = store.give(verdict(0, 0, VerdictKind.OK))
        second = store.give(verdict(0, 0, VerdictKind.CRACK_C, note="newer"))
        change = store.undo("Ann", first)
        assert change is not None
        assert change.superseded
        assert change.verdict == store.current()[0]
        assert store.current()[0].note == "newer"
        assert len(store.history()) == 2
        store.undo("Ann", second)
        store.undo("Ann", first)
        assert store.current() == ()
        assert store.redo("Ann", second).superseded  # type: ignore[union-attr]
        assert store.current() == ()


def test_a_note_waits_for_its_verdict_and_comes_back_when_that_is_undone(tmp_path: Path) -> None:
    with ReviewStore(tmp_path) as store:
        store.note((1, 2), "Ada", "dark corner")
        assert store.waiting_notes("Ada") == {(1, 2): "dark corner"}
        assert store.waiting_notes("Ben") == {}
        assert store.current() == ()
        store.give(Verdict(1, 2, VerdictKind.CRACK_A, "Ada", "dark corner"))
        assert store.waiting_notes("Ada") == {}
        change = store.undo("Ada")
        assert change is not None
        assert (change.verdict, change.note) == (None, "dark corner")
        assert store.waiting_notes("Ada") == {(1, 2): "dark corner"}
        store.redo("Ada")
        store.withdraw((1, 2), "Ada")
        assert store.waiting_notes("Ada") == {(1, 2): "dark corner"}
        assert store.history()[-1].note == "dark corner"


def test_another_review_is_taken_over_whole_and_replaces_nothing(tmp_path: Path) -> None:
    old, new = tmp_path / "old", tmp_path / "new"
    old.mkdir()
    new.mkdir()
    mask = np.eye(20, 30, dtype=bool)
    kinds = VerdictKind.OK, VerdictKind.CRACK_B
    with ReviewStore(old) as source, ReviewStore(new) as target:
        for rater, kind in zip(("Ada", "Ben"), kinds, strict=True):
            source.give(Verdict(0, 0, kind, rater, "old"))
            source.correct((0, 1), rater, mask, 1.25, 0.5)
            source.note((2, 2), rater, "typed")
        source.undo("Ben")
        source.redo("Ben")
        source.describe(ModuleData("S1", 8.5))
        source.remember(ReviewState("Ben", 1, 1))
        target.give(Verdict(0, 0, VerdictKind.CRACK_C, "Ada", "new"))
        target.give(Verdict(3, 3, VerdictKind.OK, "Eve"))
        before = source.history()
        assert target.merge(source.contents()) == (("Ada", (0, 0)),)
        assert {(v.rater, v.cell): (v.kind, v.note) for v in target.current()} == {
            ("Ada", (0, 0)): (VerdictKind.CRACK_C, "new"),
            ("Ben", (0, 0)): (VerdictKind.CRACK_B, "old"),
            ("Eve", (3, 3)): (VerdictKind.OK, ""),
        }
        for rater in ("Ada", "Ben"):
            np.testing.assert_array_equal(target.mask((0, 1), rater), mask)
            assert target.waiting_notes(rater) == {(2, 2): "typed"}
        assert target.module_data() == ModuleData("S1", 8.5)
        assert target.remembered("Ben") == ReviewState("Ben", 1, 1)
        assert source.history() == before
        of_ben = [(e.action, e.stored) for e in before if e.rater == "Ben"]
        assert [(e.action, e.stored) for e in target.history() if e.rater == "Ben"] == of_ben
        n_lines = len(target.history())
        target.merge(source.contents())
        assert len(target.history()) == n_lines, "taken over once"
        change = target.undo("Ben")
        assert change is not None
        assert (change.cell, change.note) == ((2, 2), ""), "the history can be undone here too"


def test_an_empty_review_and_the_same_folder_are_nothing_to_take_over(tmp_path: Path) -> None:
    (tmp_path / "empty").mkdir()
    with ReviewStore(tmp_path) as store, ReviewStore(tmp_path / "empty") as empty:
        store.give(Verdict(0, 0, VerdictKind.OK, "Ada"))
        assert store.merge(empty.contents()) == ()
        assert store.merge(ReviewStore(tmp_path).contents()) == ()
        assert len(store.history()) == 1


def test_what_was_taken_back_in_the_other_folder_does_not_keep_a_verdict_out(
    tmp_path: Path,
) -> None:
    for name in ("a", "b"):
        (tmp_path / name).mkdir()
    with ReviewStore(tmp_path / "a") as source, ReviewStore(tmp_path / "b") as target:
        for store, kind in ((source, VerdictKind.CRACK_A), (target, VerdictKind.OK)):
            store.give(verdict(0, 0, kind))
            store.give(verdict(0, 1, kind))
        target.withdraw((0, 0), "Ann")
        source.withdraw((0, 1), "Ann")
        for _ in range(2):
            assert target.merge(source.contents()) == ()
            assert {v.cell: v.kind for v in target.current()} == {
                (0, 0): VerdictKind.CRACK_A,
                (0, 1): VerdictKind.OK,
            }
        assert len(target.history()) == 4


def test_lines_of_a_damaged_history_that_lead_nowhere_are_not_taken_over(tmp_path: Path) -> None:
    for name in ("a", "b"):
        (tmp_path / name).mkdir()
    with ReviewStore(tmp_path / "a") as source, ReviewStore(tmp_path / "b") as target:
        source.give(verdict(0, 0, VerdictKind.OK))
        source.correct((0, 1), "Ann", np.eye(20, 30, dtype=bool))
        source.give(verdict(1, 0, VerdictKind.CRACK_A))
        source.undo("Ann")
        damaged = sqlite3.connect(tmp_path / "a" / REVIEW_FILE)
        with damaged:
            triggers = "SELECT name, sql FROM sqlite_master WHERE type = 'trigger'"
            made = dict(damaged.execute(triggers).fetchall())
            for name in made:
                damaged.execute(f"DROP TRIGGER {name}")
            damaged.execute("DELETE FROM masks")
            damaged.execute("DELETE FROM history WHERE \"row\" = 1 AND action = 'edit'")
            for sql in made.values():
                damaged.execute(sql)
        damaged.close()
        assert target.merge(source.contents()) == ()
        assert {v.cell: v.kind for v in target.current()} == {(0, 0): VerdictKind.OK}
        assert target.masks() == {}
