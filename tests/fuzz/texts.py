"""Text files that are not what their readers expect: JSON, TOML, YAML, XML, CSV."""

from __future__ import annotations

import copy
import json
import re
from typing import Any

import hypothesis.strategies as st

from tests.fuzz.raw import damaged

__all__ = ["ODD", "encoded", "json_texts", "odd_strings", "tokens"]


class _Text(float):
    """A number as it shall stand in the file."""

    def __new__(cls, text: str) -> _Text:
        made = super().__new__(cls, 0.0)
        made.text = text  # type: ignore[attr-defined]
        return made


ODD = (
    "",
    " ",
    "\t",
    "=1+1",
    "-",
    "--help",
    "../..",
    "/",
    "/dev/null",
    "\x1b[31mred\x07",
    "a\nb",
    "a\r\nb\x00c",
    "\u202egnp.exe",
    "\u2028",
    "ä" * 300,
    "x" * 5000,
    "a b " * 200,
    "\ud800",
    "😀",
    "<script>alert(1)</script>",
    "%s%n{0}{name}",
    "nan",
    "1e400",
    "0x10",
    "१२",
    "frame_0.tif",
    "C:\\x",
    "con",
    "~",
    "$HOME",
)
odd_strings = st.one_of(st.sampled_from(ODD), st.text(max_size=40))

_FEW = st.sampled_from((1, 1, 1, 1, 2, 2, 3, 0))
_NUMBERS: tuple[str, ...] = (
    "0",
    "-1",
    "1",
    "0.5",
    "-0.0",
    "1e308",
    "1e400",
    "-1e400",
    "1e-320",
    "NaN",
    "Infinity",
)
_NUMBERS += ("-Infinity", "2147483648", "9223372036854775808", "1" + "0" * 400, "1" + "0" * 5000)
_NUMBERS += ("1.7976931348623157e308", "200", "201", "3", "1000000000")


def _nested(depth: int, opens: str, closes: str) -> _Text:
    return _Text(opens * depth + closes * depth)


_values: st.SearchStrategy[Any] = st.one_of(
    st.sampled_from([_Text(text) for text in _NUMBERS]),
    st.sampled_from((None, True, False, [], {}, [None], [[]], {"a": 1}, [1, 2], [1, 2, 3], [[1]])),
    st.sampled_from(
        (
            *(_nested(depth, "[", "]") for depth in (60, 3000, 100_000)),
            _nested(5000, '{"a":', "}"),
            _Text("[" + "0," * 200_000 + "0]"),
        )
    ),
    odd_strings,
    st.lists(st.sampled_from((0, 1.5, "a", None, _Text("NaN"), _Text("1e400"))), max_size=9),
)


def _places(value: Any, path: tuple[Any, ...] = ()) -> list[tuple[Any, ...]]:
    found = [path] if path else []
    inner = value.items() if isinstance(value, dict) else enumerate(value)
    for key, item in inner:
        found.append((*path, key))
        if isinstance(item, dict | list) and item:
            found += _places(item, (*path, key))[1:]
    return found


def _dumped(value: Any, twice: tuple[Any, Any] | None) -> str:
    if isinstance(value, _Text):
        return str(value.text)  # type: ignore[attr-defined]
    if isinstance(value, dict):
        items = [(json.dumps(k), _dumped(v, twice)) for k, v in value.items()]
        if twice is not None and twice[0] in value:
            items.append((json.dumps(twice[0]), _dumped(twice[1], None)))
        return "{" + ", ".join(f"{k}: {v}" for k, v in items) + "}"
    if isinstance(value, list):
        return "[" + ", ".join(_dumped(v, twice) for v in value) + "]"
    return json.dumps(value)


@st.composite
def json_texts(draw: st.DrawFn, text: str) -> str:
    """A JSON text with other values, keys that are missing or there twice."""
    value = copy.deepcopy(json.loads(text))
    if draw(st.integers(0, 15)) == 0:
        return _dumped(draw(_values), None)
    twice = None
    for _ in range(draw(_FEW)):
        places = _places(value)
        if not places:
            break
        *way, last = draw(st.sampled_from(places))
        parent = value
        for step in way:
            parent = parent[step]
        kind = draw(st.sampled_from(("replace", "replace", "replace", "remove", "twice", "rename")))
        if kind == "remove":
            del parent[last]
        elif kind == "twice" and isinstance(parent, dict):
            twice = (last, copy.deepcopy(draw(_values)))
        elif kind == "rename" and isinstance(parent, dict):
            parent[draw(odd_strings)] = parent.pop(last)
        else:
            parent[last] = copy.deepcopy(draw(_values))
    return _dumped(value, twice)


_TOKEN = re.compile(r"[\w.+-]+|\s+|.", re.DOTALL)
_TOKENS: tuple[str, ...] = (
    "",
    "[",
    "]",
    "[" * 3000,
    "[" * 60_000,
    "{",
    "}",
    '"',
    "'",
    ":",
    "=",
    "-",
    "\n",
    "#",
)
_TOKENS += (
    "&a",
    "*a",
    "!!python/object:os.system",
    "%YAML:1.0\n",
    "---\n",
    "...\n",
    "<",
    ">",
    "</",
)
_TOKENS += ("<!DOCTYPE a [<!ENTITY b 'c'>]>", "&b;", "]]>", "a.b.c.d", "\x00", "\ufeff", '"""', ",")
_TOKENS += ("1979-05-27T07:32:00Z", "true", "null", "0x7fffffffffffffffffff", "?", "| ", "- " * 500)
_TOKENS += ("a." * 3000 + "a=1\n", "{a=" * 2000, "[[a]]\n", "- " * 60_000, "{a: " * 30_000)
_TOKENS += ("<a>" * 30_000, "!!opencv-matrix", "!!binary", "\\u0000", "\\ud800")


@st.composite
def tokens(draw: st.DrawFn, text: str) -> str:
    """A text with other words, fewer words, or lines in another order."""
    words = _TOKEN.findall(text)
    lines = text.splitlines(keepends=True)
    for _ in range(draw(_FEW)):
        kind = draw(st.sampled_from(("word", "word", "number", "odd", "drop", "lines")))
        at = draw(st.integers(0, len(words) - 1)) if words else 0
        if kind == "lines" and lines:
            moved = lines[draw(st.integers(0, len(lines) - 1))]
            words[at:at] = [moved]
        elif not words:
            words = [draw(odd_strings)]
        elif kind == "drop":
            del words[at : at + draw(st.integers(1, 9))]
        elif kind == "word":
            words[at] = draw(st.sampled_from(_TOKENS))
        elif kind == "number":
            digits = [k for k, word in enumerate(words) if word[-1:].isdigit()]
            where = draw(st.sampled_from(digits)) if digits else at
            words[where] = draw(st.sampled_from((*_NUMBERS, ".Nan", ".Inf", "nan", "inf", "1_000")))
        else:
            words[at] = draw(odd_strings)
    return "".join(words)


@st.composite
def encoded(draw: st.DrawFn, texts: st.SearchStrategy[str]) -> bytes:
    """Bytes of a text, mostly UTF-8, sometimes in another encoding or damaged."""
    text = draw(texts)
    way = draw(st.sampled_from(("utf-8",) * 12 + ("bom", "utf-16", "latin-1", "damaged")))
    if way == "bom":
        return b"\xef\xbb\xbf" + text.encode("utf-8", "surrogatepass")
    if way == "latin-1":
        return text.encode("latin-1", "replace")
    if way == "utf-16":
        return text.encode("utf-16", "surrogatepass")
    data = text.encode("utf-8", "surrogatepass")
    return draw(damaged(data)) if way == "damaged" and data else data
