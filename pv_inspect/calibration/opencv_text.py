"""YAML and XML as OpenCV writes calibrations, read in Python.

OpenCV's own readers follow nested lists into the end of the stack and the process with it. Here a
file has limits before anything is made of it, and only what calibrations use is understood:
nested names, lists, numbers and texts.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import Any
from xml.parsers import expat

__all__ = ["xml_entries", "yaml_entries"]

# A calibration has three levels and some hundred lines.
_DEEPEST = 12
_MOST_LINES = 100_000
_LONGEST_NUMBER = 60
_NOT_FINITE = {".nan": float("nan"), ".inf": float("inf"), "-.inf": float("-inf")}
_TOKEN = re.compile(r"""\s*([\[\]{},]|"(?:[^"\\]|\\.)*"|'[^']*'|[^\[\]{},]+)""")
_Line = tuple[int, str]


def yaml_entries(text: str) -> dict[str, Any]:
    r"""Read YAML as OpenCV writes it, and ROS.

    Raises
    ------
    ValueError
        One clause that says what can't be understood.

    >>> yaml_entries("camera_matrix: !!opencv-matrix\n  rows: 1\n  data: [ 1., 2e0 ]")
    {'camera_matrix': {'rows': 1, 'data': [1.0, 2.0]}}
    """
    lines = list(_lines(text))
    if not lines:
        return {}
    value, end = _block(lines, 0, 0)
    if end < len(lines) or not isinstance(value, dict):
        raise ValueError(f"{lines[min(end, len(lines) - 1)][1][:40]!r} does not belong there")
    return value


def xml_entries(text: str) -> dict[str, Any]:
    """Read XML as OpenCV writes it: numbers with blanks between them are a list.

    Raises
    ------
    ValueError
        One clause that says what can't be understood.
    """
    root: dict[str, Any] = {}
    open_: list[tuple[str, dict[str, Any], list[str]]] = []
    parser = expat.ParserCreate()

    def begin(name: str, _: dict[str, str]) -> None:
        if len(open_) > _DEEPEST:
            raise ValueError(f"its entries lie more than {_DEEPEST} deep within each other")
        open_.append((name, {}, []))

    def end(_: str) -> None:
        name, inner, words = open_.pop()
        value = inner or _words(" ".join(words))
        holder = open_[-1][1] if open_ else root
        if name == "_":  # an entry of a list
            holder.setdefault(name, []).append(value)
        elif name in holder:
            raise ValueError(f"it holds {name[:40]!r} twice")
        else:
            holder[name] = value

    def no_entities(*_: Any) -> None:
        raise ValueError("it declares a document type, which no calibration needs")

    parser.StartElementHandler, parser.EndElementHandler = begin, end
    parser.CharacterDataHandler = lambda part: open_[-1][2].append(part) if open_ else None
    parser.StartDoctypeDeclHandler = no_entities
    parser.buffer_text = True
    try:
        parser.Parse(text.encode(), True)
    except expat.ExpatError as error:
        raise ValueError(f"it is no XML: {error}") from None
    storage = root.get("opencv_storage")
    if not isinstance(storage, dict):
        raise ValueError("it holds no <opencv_storage>")
    return storage


def _words(text: str) -> Any:
    """Text of an element: a number, a list of numbers, or a text in quotation marks."""
    text = text.strip()
    if text.startswith('"'):
        return text.strip('"')
    values = [_scalar(word) for word in text.split()]
    return values[0] if len(values) == 1 else values


def _lines(text: str) -> Iterator[_Line]:
    """Indent and content of every line; a list over several lines becomes one."""
    begun, indent, depth = list[str](), 0, 0
    raw = text.splitlines()
    if len(raw) > _MOST_LINES:
        raise ValueError(f"it has {len(raw)} lines")
    for line in raw:
        line, brackets = _scanned(line)
        content = line.strip()
        if not content or (not begun and content.startswith(("%", "---", "..."))):
            continue
        if not begun:
            indent = len(line) - len(line.lstrip())
            if "\t" in line[:indent]:
                raise ValueError("it is indented by tabs")
        begun.append(content)
        for bracket in brackets:
            depth += 1 if bracket in "[{" else -1
            if depth > _DEEPEST:
                raise ValueError(f"its lists lie more than {_DEEPEST} deep within each other")
        if depth <= 0:
            yield indent, " ".join(begun)
            begun, depth = [], 0
    if begun:
        raise ValueError("a list in it does not end")


def _scanned(line: str) -> tuple[str, str]:
    """Line without its comment, and the brackets in it; neither counts between quotes."""
    quote, brackets, escaped = "", "", False
    for k, c in enumerate(line):
        if quote:
            if c == quote and not escaped:
                quote = ""
            escaped = c == "\\" and not escaped and quote == '"'
        elif c in "\"'":
            quote = c
        elif c in "[{]}":
            brackets += c
        elif c == "#" and (k == 0 or line[k - 1].isspace()):
            return line[:k], brackets
    return line, brackets


def _named(content: str) -> tuple[str, str] | None:
    """Name and rest of a line ``name: rest``; None if it is none."""
    if content[:1] in ("'", '"'):
        end = content.find(content[0], 1)
        if end < 0 or not content[end + 1 :].startswith(":"):
            return None
        return content[1:end], content[end + 2 :].strip()
    end = content.find(": ")
    if end < 0:
        end = len(content) - 1 if content.endswith(":") else -1
    name = content[:end].strip()
    if end < 1 or name[0] in "[]{},#&*!|>%@`-" or any(c in "[]{}," for c in name):
        return None
    return name, content[end + 1 :].strip()


def _block(lines: list[_Line], at: int, level: int) -> tuple[Any, int]:
    """Value of the lines from ``at`` that are indented alike, and where it ends."""
    if level > _DEEPEST:
        raise ValueError(f"its entries lie more than {_DEEPEST} deep within each other")
    indent = lines[at][0]
    found: dict[str, Any] = {}
    items: list[Any] = []
    while at < len(lines) and lines[at][0] == indent:
        content = lines[at][1]
        if content == "-" or content.startswith("- "):
            if found:
                break
            value, at = _value(lines, at, content[1:].strip(), level)
            items.append(value)
            continue
        named = _named(content)
        if named is None or items:
            break
        name, rest = named
        if name in found:
            raise ValueError(f"it holds {name[:40]!r} twice")
        found[name], at = _value(lines, at, rest, level)
    if at < len(lines) and lines[at][0] >= indent and not (found and lines[at][0] < indent):
        raise ValueError(f"{lines[at][1][:40]!r} can't be understood")
    return (items or found), at


def _value(lines: list[_Line], at: int, rest: str, level: int) -> tuple[Any, int]:
    """Value behind a name or a dash, and the line after it."""
    rest = re.sub(r"^!!?[\w:-]+\s*", "", rest)
    if rest:
        return _flow(rest), at + 1
    following = at + 1
    if following < len(lines):
        deeper = lines[following][0] > lines[at][0]
        # The items of a list may stand as far left as its name.
        dash = lines[following][0] == lines[at][0] and lines[following][1].startswith("- ")
        if deeper or (dash and not lines[at][1].startswith("-")):
            return _items(lines, following, level) if dash else _block(lines, following, level + 1)
    return None, following


def _items(lines: list[_Line], at: int, level: int) -> tuple[list[Any], int]:
    found = []
    indent = lines[at][0]
    while at < len(lines) and lines[at][0] == indent and lines[at][1].startswith("- "):
        value, at = _value(lines, at, lines[at][1][1:].strip(), level)
        found.append(value)
    return found, at


def _flow(text: str) -> Any:
    """Value on one line: a number, a text, a list or names in braces."""
    if text[0] not in "[{":
        return _scalar(text)
    tokens = [match[1].strip() for match in _TOKEN.finditer(text)]
    value, end = _flow_at([token for token in tokens if token], 0)
    if end != sum(map(bool, tokens)):
        raise ValueError(f"{text[:40]!r} can't be understood")
    return value


def _flow_at(tokens: list[str], at: int) -> tuple[Any, int]:
    """Value that begins at a token; `_lines` has limited how deep it goes."""
    if at >= len(tokens):
        raise ValueError("a list in it does not end")
    closing = {"[": "]", "{": "}"}.get(tokens[at])
    if closing is None:
        if tokens[at] in "]},":
            raise ValueError(f"{tokens[at]!r} stands where a value should")
        return _scalar(tokens[at]), at + 1
    is_list, at = tokens[at] == "[", at + 1
    items: list[Any] = []
    found: dict[str, Any] = {}
    while True:
        if at >= len(tokens):
            raise ValueError("a list in it does not end")
        if tokens[at] == closing:
            return (items if is_list else found), at + 1
        if is_list:
            value, at = _flow_at(tokens, at)
            items.append(value)
        else:
            name, colon, rest = tokens[at].partition(":")
            if not colon:
                raise ValueError(f"{tokens[at][:40]!r} has no value")
            if name.strip("\"' ") in found:
                raise ValueError(f"it holds {name[:40]!r} twice")
            if rest.strip():
                value, at = _scalar(rest.strip()), at + 1
            else:
                value, at = _flow_at(tokens, at + 1)
            found[name.strip("\"' ")] = value
        if at < len(tokens) and tokens[at] == ",":
            at += 1
        elif at >= len(tokens) or tokens[at] != closing:
            raise ValueError("a comma is missing in a list")


def _scalar(text: str) -> int | float | str:
    text = re.sub(r"^!!?[\w:-]+\s*", "", text)
    if len(text) > 1 and text[0] in "'\"" and text[-1] == text[0]:
        return text[1:-1]
    if len(text) > _LONGEST_NUMBER:
        return text
    lower = text.lower()
    if lower in _NOT_FINITE:
        return _NOT_FINITE[lower]
    if re.fullmatch(r"[-+]?\d{1,40}", text):
        return int(text)
    if re.fullmatch(r"[-+]?(\d+\.?\d*|\.\d+)([eE][-+]?\d+)?", text):
        return float(text)
    return text
