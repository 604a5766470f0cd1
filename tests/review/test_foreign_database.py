"""A database that others made or changed: refused in one sentence, before anything is believed."""

from __future__ import annotations

import os
import sqlite3
import struct
import zlib
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest

from pv_inspect.errors import InspectionError
from pv_inspect.review import (
    REVIEW_FILE,
    ModuleData,
    ReviewState,
    ReviewStore,
    Verdict,
    VerdictKind,
)
from pv_inspect.review import entries as entries_module
from pv_inspect.review import file as file_module
from pv_inspect.review.mask_png import mask_from_png, mask_to_png

# As the first release has written it; such files have to open for ever.
FIRST_SCHEMA = """
CREATE TABLE masks (
    id INTEGER PRIMARY KEY,
    png BLOB NOT NULL
);
CREATE TABLE history (
    id INTEGER PRIMARY KEY AUTOINCREMENT,
    action TEXT NOT NULL CHECK (action IN ('edit', 'undo', 'redo')),
    edit INTEGER REFERENCES history (id),
    stored TEXT NOT NULL,
    rater TEXT NOT NULL,
    "row" INTEGER NOT NULL,
    col INTEGER NOT NULL,
    kind TEXT,
    note TEXT,
    time TEXT,
    settings TEXT,
    software TEXT,
    crack_length_cells REAL,
    isolated_area_share REAL,
    mask INTEGER REFERENCES masks (id)
);
CREATE INDEX history_of_cell ON history (rater, "row", col, id);
CREATE TRIGGER history_is_not_changed BEFORE UPDATE ON history
    BEGIN SELECT RAISE(ABORT, 'the history is append-only'); END;
CREATE TRIGGER history_is_not_cut BEFORE DELETE ON history
    BEGIN SELECT RAISE(ABORT, 'the history is append-only'); END;
CREATE TABLE module_data (
    id INTEGER PRIMARY KEY,
    stored TEXT NOT NULL,
    data TEXT NOT NULL
);
CREATE TABLE state (
    rater TEXT PRIMARY KEY,
    stored TEXT NOT NULL,
    "row" INTEGER NOT NULL,
    col INTEGER NOT NULL
);
PRAGMA application_id = 1886808434;
PRAGMA user_version = 1;
"""


def given(row: int, col: int, note: str = "") -> Verdict:
    return Verdict(row, col, VerdictKind.CRACK_A, "Ann", note)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A review with something in every table."""
    with ReviewStore(tmp_path) as store:
        store.correct((0, 1), "Ann", np.eye(20, 30, dtype=bool), 1.5, 0.25)
        store.give(given(0, 1, "seen"))
        store.note((1, 1), "Ben", "later")
        store.describe(ModuleData("S1", 8.5))
        store.remember(ReviewState("Ann", 0, 1))
    return tmp_path


def change(folder: Path, *statements: str) -> None:
    with closing(sqlite3.connect(folder / REVIEW_FILE, isolation_level=None)) as connection:
        for statement in statements:
            connection.execute(statement)


def unlocked(*statements: str) -> tuple[str, ...]:
    """Statements that change the history, with its own triggers as they were afterwards."""
    again = [s for s in FIRST_SCHEMA.split(";\nCREATE ") if s.startswith("TRIGGER")]
    drops = ("DROP TRIGGER history_is_not_changed", "DROP TRIGGER history_is_not_cut")
    return (*drops, *statements, *(f"CREATE {trigger}" for trigger in again))


def refusal(folder: Path) -> str:
    """The sentence with which reading and storing are both refused; nothing is changed."""
    path = folder / REVIEW_FILE
    before = path.read_bytes()
    said = set()
    for act in (ReviewStore.current, ReviewStore.contents, lambda store: store.give(given(0, 0))):
        with ReviewStore(folder) as store, pytest.raises(InspectionError) as error:
            act(store)
        said.add(str(error.value))
    assert path.read_bytes() == before
    assert len(said) == 1
    return said.pop()


def test_a_review_of_the_first_release_opens_and_can_be_continued(tmp_path: Path) -> None:
    with closing(sqlite3.connect(tmp_path / REVIEW_FILE)) as connection:
        connection.executescript(FIRST_SCHEMA)
    change(
        tmp_path,
        'INSERT INTO history (action, stored, rater, "row", col, kind, note, time, settings, '
        "software) VALUES ('edit', '2026-01-01', 'Ann', 0, 2, 'ok', '', '2026', '', '0.1')",
        "ANALYZE",
    )
    with ReviewStore(tmp_path) as store:
        store.give(given(0, 1))
        assert [v.cell for v in store.current()] == [(0, 1), (0, 2)]


@pytest.mark.parametrize(
    ("statements", "named"),
    [
        (
            ["CREATE TRIGGER z BEFORE INSERT ON history BEGIN SELECT RAISE(IGNORE); END"],
            "the trigger 'z'",
        ),
        (
            ["CREATE TRIGGER z AFTER INSERT ON masks BEGIN DELETE FROM state; END"],
            "the trigger 'z'",
        ),
        (
            [
                "ALTER TABLE history RENAME TO h2",
                "CREATE VIEW history AS WITH RECURSIVE r(id) AS (SELECT 1 UNION ALL "
                "SELECT id + 1 FROM r) SELECT id, '' AS action FROM r",
            ],
            "the table 'h2'",
        ),
        (["CREATE VIEW v AS SELECT 1"], "the view 'v'"),
        (["CREATE TABLE more (x)"], "the table 'more'"),
        (["CREATE INDEX i ON history (abs(col))"], "the index 'i'"),
        (["ALTER TABLE state ADD COLUMN more AS (hex(zeroblob(1000000)))"], "table 'state'"),
        (["DROP TABLE state", 'CREATE TABLE state (rater, stored, "row", col)'], "'state'"),
        (["DROP INDEX history_of_cell"], "no index 'history_of_cell'"),
        (["DROP TRIGGER history_is_not_cut"], "no trigger 'history_is_not_cut'"),
    ],
)
def test_whatever_no_review_has_is_named_and_refused(
    folder: Path, statements: list[str], named: str
) -> None:
    change(folder, *statements)
    said = refusal(folder)
    assert named in said
    assert "was changed by another program" in said
    assert "put a copy of your review in its place" in said


@pytest.mark.parametrize("value", ["'many'", "x'00ff'", "1e300", "-1", "9223372036854775807"])
@pytest.mark.parametrize("column", ["row", "col", "crack_length_cells", "mask", "edit"])
def test_what_is_no_number_where_one_belongs_is_named(
    folder: Path, column: str, value: str
) -> None:
    change(folder, *unlocked(f'UPDATE history SET "{column}" = {value} WHERE id = 2'))
    said = refusal(folder)
    assert f"history, entry 2: {column} is " in said


@pytest.mark.parametrize(
    ("statement", "named"),
    [
        ("UPDATE history SET kind = 'splendid'", "history, entry 1: kind is 'splendid'"),
        ("UPDATE history SET kind = x'6f6b'", "history, entry 1: kind is b'ok'"),
        ("UPDATE history SET rater = ' '", "history, entry 1: rater is ' ', expected is a name"),
        ("UPDATE history SET note = x'00'", "history, entry 1: note is b"),
        ("UPDATE history SET time = NULL", "history, entry 2: kind is 'crack_a'"),
        ("UPDATE masks SET png = 'text'", "masks, entry 1: png is 'text'"),
        ("UPDATE state SET \"row\" = 'x'", "state, entry 1: row is 'x'"),
        ("UPDATE module_data SET data = x'7b7d'", "module_data, entry 1: data is"),
        ("UPDATE sqlite_sequence SET seq = 9223372036854775806", "seq is 9223372036854775806"),
        ("UPDATE sqlite_sequence SET seq = 'much'", "seq is 'much'"),
    ],
)
def test_every_column_is_checked_for_what_it_holds(
    folder: Path, statement: str, named: str
) -> None:
    change(folder, *unlocked(statement))
    assert named in refusal(folder)


@pytest.mark.parametrize(
    "data",
    [
        "{",
        "7",
        '{"current_a": "much"}',
        '{"current_a": [1]}',
        '{"current_a": NaN}',
        '{"current_a": 1e999}',
        f'{{"current_a": {10**400}}}',
        '{"serial_number": 5}',
        '{"exposure_s": true}',
        100_000 * "[",
    ],
)
def test_module_data_that_can_not_be_understood_are_told(folder: Path, data: str) -> None:
    change(folder, f"UPDATE module_data SET data = '{data}'")
    with ReviewStore(folder) as store:
        with pytest.raises(InspectionError, match=r"review\.sqlite is damaged .*module data"):
            store.module_data()
        assert len(store.current()) == 1


def test_a_trigger_that_comes_while_the_review_is_open_is_found_before_the_next_verdict(
    folder: Path,
) -> None:
    with ReviewStore(folder) as store:
        store.give(given(0, 0))
        change(folder, "CREATE TRIGGER z BEFORE INSERT ON history BEGIN SELECT RAISE(IGNORE); END")
        with pytest.raises(InspectionError, match="the trigger 'z' that no review has"):
            store.give(given(0, 2))
        change(folder, "DROP TRIGGER z")
        store.give(given(0, 2))
        assert [v.cell for v in store.current()] == [(0, 0), (0, 1), (0, 2)]


@pytest.mark.parametrize(
    "trigger",
    [
        "BEFORE INSERT ON {} BEGIN SELECT RAISE(IGNORE); END",
        "AFTER INSERT ON {} BEGIN DELETE FROM {} WHERE rowid = new.rowid; END",
    ],
)
@pytest.mark.parametrize("table", ["history", "masks", "module_data", "state"])
def test_what_the_database_does_not_keep_is_not_confirmed(
    folder: Path, monkeypatch: pytest.MonkeyPatch, trigger: str, table: str
) -> None:
    """Also if the check of the schema had missed something: what is stored is read back."""
    act = {
        "history": lambda store: store.give(given(0, 0)),
        "masks": lambda store: store.correct((0, 0), "Ann", np.ones((2, 2), bool)),
        "module_data": lambda store: store.describe(ModuleData("S2")),
        "state": lambda store: store.remember(ReviewState("Cid", 5, 5)),
    }[table]
    change(folder, "DROP TRIGGER history_is_not_cut")
    change(folder, f"CREATE TRIGGER z {trigger.format(table, table)}")
    for module in ("pv_inspect.review.schema", "pv_inspect.review.file"):
        monkeypatch.setattr(f"{module}.check_schema", lambda *_: None)
    with ReviewStore(folder) as store:
        before = store.contents()
        with pytest.raises(InspectionError, match="did not keep what was to be stored"):
            act(store)
        assert store.contents() == before


def ask(store: ReviewStore, question: str) -> list[tuple[object, ...]]:
    with store.reading() as connection:
        assert connection is not None
        return connection.execute(question).fetchall()


def test_a_question_that_takes_too_long_is_given_up(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(file_module, "_PATIENCE_S", 0.1)
    endless = "WITH RECURSIVE r(n) AS (SELECT 1 UNION ALL SELECT n + 1 FROM r) SELECT max(n) FROM r"
    with ReviewStore(folder, busy_s=0.0) as store:
        assert ask(store, "SELECT 1") == [(1,)]
        with pytest.raises(InspectionError, match="took too long"):
            ask(store, endless)
        assert len(store.current()) == 1


def test_a_huge_file_is_refused_by_its_size(folder: Path) -> None:
    os.truncate(folder / REVIEW_FILE, 2**33)  # takes no room on the disk
    with ReviewStore(folder) as store, pytest.raises(InspectionError, match="has 8590 MB, a revi"):
        store.current()


def test_a_review_ends_at_its_greatest_number_of_entries_and_not_beyond(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(entries_module, "MOST_ENTRIES", 4)
    with ReviewStore(folder) as store:
        store.give(given(0, 0))
        with pytest.raises(InspectionError, match="at most 4 entries: save the result into anoth"):
            store.give(given(0, 2))
        assert [v.cell for v in store.current()] == [(0, 0), (0, 1)]


def test_no_place_in_the_folder_that_is_no_file_is_opened(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / REVIEW_FILE)
    with ReviewStore(tmp_path) as store, pytest.raises(InspectionError, match="it is no file"):
        store.give(given(0, 0))


def test_a_clock_that_goes_back_changes_nothing_about_who_was_here_last(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for module in ("entries", "store"):
        monkeypatch.setattr(f"pv_inspect.review.{module}.now", lambda: "1999-01-01T00:00:00+00:00")
    with ReviewStore(folder) as store:
        store.give(Verdict(0, 1, VerdictKind.OK, "Ann", "newer", time="1999"))
        store.remember(ReviewState("Ben", 1, 1))
        assert [v.note for v in store.current()] == ["newer"]
        assert store.remembered() == ReviewState("Ben", 1, 1)
        store.remember(ReviewState("Ann", 0, 0))
        assert store.remembered() == ReviewState("Ann", 0, 0)
        store.describe(ModuleData("S2"))
        assert store.module_data() == ModuleData("S2")


def chunk(name: bytes, content: bytes) -> bytes:
    body = name + content
    return struct.pack(">I", len(content)) + body + struct.pack(">I", zlib.crc32(body))


def png(width: int, height: int, lines: bytes, depth: int = 1) -> bytes:
    head = struct.pack(">IIBBBBB", width, height, depth, 0, 0, 0, 0)
    parts = chunk(b"IHDR", head), chunk(b"IDAT", zlib.compress(lines)), chunk(b"IEND", b"")
    return b"\x89PNG\r\n\x1a\n" + b"".join(parts)


WHOLE = mask_to_png(np.random.default_rng(0).random((23, 37)) < 0.5)
DAMAGED = {
    "bomb": png(60_000, 60_000, b""),
    "more than it says": png(8, 8, bytes(10_000_000)),
    "less than it says": png(8, 8, bytes(3)),
    "unknown filter": png(8, 1, b"\x09\x00"),
    "cut": WHOLE[:-20],
    "changed": WHOLE[:60] + bytes([WHOLE[60] ^ 1]) + WHOLE[61:],
    "colour": png(8, 8, bytes(16), depth=16),
    "text": WHOLE[:-12] + chunk(b"tEXt", b"x") + WHOLE[-12:],
    "empty": b"",
    "another file": b"GIF89a",
}


@pytest.mark.parametrize("shape", [(1, 1), (23, 37), (256, 128), (1, 300)])
def test_a_mask_is_unpacked_as_it_was_packed(shape: tuple[int, int]) -> None:
    mask = np.random.default_rng(1).random(shape) < 0.3
    np.testing.assert_array_equal(mask_from_png(mask_to_png(mask)), mask)


@pytest.mark.parametrize("damage", DAMAGED)
def test_a_damaged_mask_is_told_and_no_decoder_prints_anything(
    folder: Path, damage: str, capfd: pytest.CaptureFixture[str]
) -> None:
    change(folder, f"UPDATE masks SET png = x'{DAMAGED[damage].hex()}'")
    with ReviewStore(folder) as store:
        for read in (store.masks, lambda: store.mask((0, 1), "Ann")):
            with pytest.raises(InspectionError, match=r"review\.sqlite is damaged .*a mask"):
                read()
        assert len(store.current()) == 1
    assert capfd.readouterr() == ("", "")


def test_characters_that_can_not_be_stored_are_told(folder: Path) -> None:
    with ReviewStore(folder) as store:
        with pytest.raises(InspectionError, match="holds characters that can't be stored"):
            store.give(given(0, 0, "half \ud800"))
        assert len(store.current()) == 1
