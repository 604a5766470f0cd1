"""Archives of arrays, networks and databases that are not what they should be."""

from __future__ import annotations

import io
import struct
import warnings
import zipfile
from collections.abc import Iterator
from functools import cache
from typing import Any

import hypothesis.strategies as st

from tests.fuzz import seeds
from tests.fuzz.coded import png_of
from tests.fuzz.raw import BOMB, damaged, numbers
from tests.fuzz.texts import json_texts

__all__ = ["databases", "models", "zips"]


def _npy(shape: str, descr: str, content: bytes = b"") -> bytes:
    head = f"{{'descr': {descr}, 'fortran_order': False, 'shape': {shape}, }}".encode()
    return b"\x93NUMPY\x01\x00" + struct.pack("<H", len(head)) + head + content


_MEMBERS = (
    _npy("(3, 3)", "'<f2'", bytes(18)),
    _npy("(3, 3)", "'<f2'", bytes(3)),
    _npy("(3, 3)", "'<f8'", bytes(72)),
    _npy("(3, 3)", "'|O'", b"cos\nsystem\n(S'true'\ntR."),
    _npy("(1000000, 1000000)", "'<f2'"),
    _npy("(-1, 3)", "'<f2'"),
    _npy("(0, 3)", "'<f2'"),
    _npy("(2,) * 10", "'<f2'"),
    _npy("(" * 200 + ")" * 200, "'<f2'"),
    _npy("(2, 2)", "[('a', '<f2'), ('b', '<U900000000')]"),
    _npy("(2, 2)", "'<f2'", b"\xff\x7f" * 4),
    _npy("()", "'<U3'", "[[["[:3].encode("utf-32-le")),
    _npy("()", "'<U1000000000'"),
    b"",
    b"\x93NUMPY\x09\x00",
    BOMB,
)


@st.composite
def zips(draw: st.DrawFn, data: bytes, about: st.SearchStrategy[str]) -> bytes:
    """An archive of arrays with other members, other descriptions, or damage."""
    kind = draw(st.sampled_from(("damaged", "members", "members", "about", "about")))
    if kind == "damaged":
        return draw(damaged(data))
    with zipfile.ZipFile(io.BytesIO(data)) as file:
        members: list[tuple[str, bytes]] = [(n, file.read(n)) for n in file.namelist()]
    if kind == "about":
        text = draw(about).encode("utf-32-le", "surrogatepass")
        if not text:
            text = bytes(4)
        members[0] = (members[0][0], _npy("()", f"'<U{len(text) // 4}'", text))
    else:
        for _ in range(draw(st.integers(1, 3))):
            at = draw(st.integers(0, len(members) - 1))
            name = draw(
                st.sampled_from((members[at][0], "picture_9.npy", "../a.npy", "/a", "", "about"))
            )
            change: Any = draw(st.sampled_from(("replace", "damage", "drop", "add")))
            if change == "drop" and len(members) > 1:
                del members[at]
            elif change == "add":
                members.append((name, draw(st.sampled_from(_MEMBERS))))
            elif change == "damage" and members[at][1]:
                members[at] = (members[at][0], draw(damaged(members[at][1], 2)))
            else:
                members[at] = (members[at][0], draw(st.sampled_from(_MEMBERS)))
    packing = draw(st.sampled_from((zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED, zipfile.ZIP_LZMA)))
    return _zipped(members, packing)


def _zipped(members: list[tuple[str, bytes]], packing: int) -> bytes:
    buffer = io.BytesIO()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # two members of one name are meant
        with zipfile.ZipFile(buffer, "w", packing) as file:
            for name, content in members:
                file.writestr(name or "x", content)
    return buffer.getvalue()


def _varint(data: bytes, at: int) -> tuple[int, int]:
    value = shift = 0
    while True:
        value |= (data[at] & 0x7F) << shift
        shift += 7
        at += 1
        if not data[at - 1] & 0x80:
            return value, at


def _as_varint(value: int) -> bytes:
    found = bytearray()
    while value > 0x7F:
        found.append(value & 0x7F | 0x80)
        value >>= 7
    return bytes([*found, value])


# Messages inside of messages of ONNX: model.graph, its nodes, tensors, inputs; their attributes.
_INNER = {(), (7,), (7, 1), (7, 5), (7, 11), (7, 12), (8,), (7, 1, 5), (7, 11, 2), (7, 12, 2)}
_INNER |= {(7, 11, 2, 1), (7, 11, 2, 1, 2), (7, 11, 2, 1, 2, 1), (7, 12, 2, 1), (7, 1, 5, 5)}

Message = list[Any]


def _parsed(data: bytes, path: tuple[int, ...] = ()) -> Message:
    """Fields [number, wire type, value] of a protobuf message; known inner messages are lists."""
    found, at = [], 0
    while at < len(data):
        key, at = _varint(data, at)
        number, wire = key >> 3, key & 7
        value: Any
        if wire == 0:
            value, at = _varint(data, at)
        elif wire == 2:
            size, at = _varint(data, at)
            value, at = data[at : at + size], at + size
            if (*path, number) in _INNER:
                value = _parsed(value, (*path, number))
        else:
            size = {1: 8, 5: 4}[wire]
            value, at = data[at : at + size], at + size
        found.append([number, wire, value])
    return found


def _serialised(message: Message) -> bytes:
    found = []
    for number, wire, value in message:
        content = _serialised(value) if isinstance(value, list) else value
        if wire == 0:
            content = _as_varint(value)
        elif wire == 2:
            content = _as_varint(len(content)) + content
        found.append(_as_varint(number << 3 | wire) + content)
    return b"".join(found)


@cache
def _network() -> Message:
    return _parsed(seeds.model()[0])


def _copied(message: Message) -> Message:
    return [[n, w, _copied(v) if isinstance(v, list) else v] for n, w, v in message]


def _spots(message: Message) -> Iterator[tuple[Message, int]]:
    for k, (_, _, value) in enumerate(message):
        yield message, k
        if isinstance(value, list):
            yield from _spots(value)


@st.composite
def models(draw: st.DrawFn) -> bytes:
    """A network with other numbers, other kinds of layers, fewer or more parts."""
    data = seeds.model()[0]
    if draw(st.integers(0, 4)) == 0:
        return draw(damaged(data))
    message = _copied(_network())
    spots = list(_spots(message))
    short = [(m, k) for m, k in spots if not isinstance(m[k][2], bytes) or len(m[k][2]) < 200]
    for _ in range(draw(st.integers(1, 2))):
        part, k = draw(st.sampled_from(short))
        if k >= len(part):
            continue
        kind = draw(st.sampled_from(("value", "value", "value", "drop", "double", "number")))
        number, wire, value = part[k]
        if kind == "drop":
            del part[k]
        elif kind == "double":
            part.insert(k, part[k])
        elif kind == "number":
            part[k] = [draw(st.integers(1, 20)), wire, value]
        elif wire == 0:
            part[k] = [number, wire, draw(numbers)]
        elif isinstance(value, bytes):
            layers = (b"Conv", b"MaxPool", b"Resize", b"Gather", b"Reshape", b"Div", b"Loop", b"If")
            choices: list[st.SearchStrategy[bytes]] = [st.sampled_from((b"", b"\xff" * 9, *layers))]
            if value and wire == 2:
                choices.append(damaged(value, 1))
            new = (
                draw(st.one_of(choices))
                if wire == 2
                else draw(st.binary(min_size=len(value), max_size=len(value)))
            )
            part[k] = [number, wire, new]
    return _serialised(message)


_COLUMNS: tuple[str, ...] = (
    "action",
    "edit",
    "stored",
    "rater",
    '"row"',
    "col",
    "kind",
    "note",
    "time",
    "settings",
)
_COLUMNS += ("software", "crack_length_cells", "isolated_area_share", "mask", "id")
_SQL_VALUES: tuple[str, ...] = (
    "NULL",
    "-1",
    "0",
    "1",
    "2147483648",
    "9223372036854775807",
    "1e400",
    "-1e400",
    "''",
)
_SQL_VALUES += ("'text'", "X'00ff'", "0.5", "zeroblob(20000000)", "zeroblob(1000)", "'crack_a'")
_SQL_VALUES += ("printf('%.*c', 100000, 'x')", "char(27) || '[31m'", "char(10)", "'\u202e'", "'ok'")
_ENDLESS = "WITH RECURSIVE n(i) AS (SELECT 1 UNION ALL SELECT i + 1 FROM n) SELECT "
# 900 million black pixels in a megabyte.
_PNG_BOMB = png_of(30000, 30000, BOMB)
_TABLES = ("history", "masks", "module_data", "state")
_HOSTILE = (
    "CREATE TRIGGER quiet BEFORE INSERT ON history BEGIN SELECT RAISE(IGNORE); END",
    "CREATE TRIGGER loud AFTER INSERT ON history BEGIN SELECT RAISE(ABORT, 'no'); END",
    "CREATE TRIGGER other AFTER INSERT ON history BEGIN INSERT INTO state VALUES "
    "('x', '', 1, 1); END",
    "CREATE TRIGGER slow AFTER INSERT ON history BEGIN INSERT INTO masks (png) "
    + _ENDLESS
    + "zeroblob(9) FROM n; END",
    "CREATE UNIQUE INDEX one_each ON history (rater)",
    "CREATE INDEX odd ON history (abs(col))",
    "CREATE VIEW extra AS SELECT 1",
    "CREATE VIRTUAL TABLE found USING fts5 (text)",
    "CREATE VIRTUAL TABLE near USING rtree (id, a, b)",
    "PRAGMA user_version = 0",
    "PRAGMA user_version = 2147483647",
    "PRAGMA user_version = -1",
    "PRAGMA application_id = 0",
    "PRAGMA journal_mode = WAL",
    "PRAGMA auto_vacuum = FULL",
    "PRAGMA encoding = 'UTF-16'",
    "PRAGMA ignore_check_constraints = ON",
    "DROP INDEX history_of_cell",
    "DROP TABLE module_data",
    "DROP TABLE masks",
    "DROP TABLE state",
    "DROP TABLE history",
    "ALTER TABLE history ADD COLUMN more TEXT NOT NULL DEFAULT 'x'",
    "ALTER TABLE history DROP COLUMN note",
    "ALTER TABLE history RENAME TO old; ",
    "ALTER TABLE masks RENAME COLUMN png TO jpg",
)


@st.composite
def databases(draw: st.DrawFn) -> bytes:
    """A review with damage, other values, other tables, or objects that do harm."""
    if draw(st.integers(0, 3)) == 0:
        return draw(damaged(seeds.stored_review()))
    statements = []
    for _ in range(draw(st.integers(1, 4))):
        kind = draw(st.sampled_from(("value", "value", "value", "hostile", "view", "mask", "data")))
        if kind == "value":
            column, value = draw(st.sampled_from(_COLUMNS)), draw(st.sampled_from(_SQL_VALUES))
            statements += [
                "DROP TRIGGER IF EXISTS history_is_not_changed",
                "PRAGMA ignore_check_constraints = ON",
                f"UPDATE history SET {column} = {value} WHERE id >= {draw(st.integers(1, 6))}",
            ]
        elif kind == "hostile":
            statements.append(draw(st.sampled_from(_HOSTILE)))
        elif kind == "view":
            table = draw(st.sampled_from(_TABLES))
            body = draw(
                st.sampled_from(
                    (
                        f"SELECT * FROM old_{table}",
                        _ENDLESS + "i AS id, 'edit' AS action, 1 AS edit, '' AS stored, 'a' AS "
                        "rater, 1 AS \"row\", i AS col, 'ok' AS kind, NULL AS note, NULL AS time, "
                        "NULL AS settings, NULL AS software, NULL AS crack_length_cells, "
                        "NULL AS isolated_area_share, NULL AS mask, zeroblob(1000) AS png, "
                        "'{}' AS data FROM n",
                        f"SELECT * FROM {table}",
                    )
                )
            )
            statements += [
                f"ALTER TABLE {table} RENAME TO old_{table}",
                f"CREATE VIEW {table} AS {body}",
            ]
        elif kind == "mask":
            png = draw(st.sampled_from((*seeds.pngs(), b"", b"no picture", _PNG_BOMB)))
            if png is not _PNG_BOMB and png:
                png = draw(damaged(png))
            statements.append(f"UPDATE masks SET png = X'{png.hex()}'")
        else:
            text = draw(_module_data)
            statements.append(f"UPDATE module_data SET data = {_quoted(text)}")
    return seeds.changed_review(statements)


def _quoted(text: str) -> str:
    return "'" + text.replace("'", "''").replace("\0", "").encode("utf-8", "replace").decode() + "'"


_module_data = json_texts('{"serial_number": "7", "current_a": 8.5, "exposure_s": null}')
