from __future__ import annotations

from pathlib import Path

import pytest

from pv_inspect.errors import InspectionError
from pv_inspect.sequence.sidecar import read_sidecar


def read(tmp_path: Path, content: bytes) -> dict[str, object]:
    (tmp_path / "module.json").write_bytes(content)
    return read_sidecar(tmp_path, [tmp_path / "a.tif", tmp_path / "b.tif"])


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (b"[" * 100_000, "too deep"),
        (b'{"rows": ' + b"[" * 100_000, "too deep"),
        (b'{"rows": ' + b"9" * 5000 + b"}", "can't be read as JSON ("),
        (b'{"rows": ' + b"9" * 4000 + b"}", "a number of 4000 digits"),
        (b'{"cell_aspect": ' + b"9" * 4000 + b"}", "a number of 4000 digits"),
        (b'{"cell_aspect": 1e999}', "beyond any number"),
        (b'{"cell_aspect": -Infinity}', "-Infinity, which is no number"),
        (b'{"rows": 6.0}', "rows is 6.0, but a whole number"),
        (b'{"rows": {"a": [1, 2, 3' + b", 4" * 500 + b"]}}", "4, 4 ..., but a whole number"),
        (b'"' + b"x" * 2**20 + b'"', "at most 1048576 are expected"),
        (b'{"rows": "\\ud800\\u001b[2J"}', r"\x1b[2J"),
        (b"\xff\xfe{}", "can't be read as JSON ("),
        (b"", "can't be read as JSON ("),
    ],
)
def test_whatever_stands_in_it_is_told_in_one_sentence(
    tmp_path: Path, content: bytes, said: str
) -> None:
    with pytest.raises(InspectionError) as caught:
        read(tmp_path, content)
    text = str(caught.value)
    assert said in text
    assert len(text) < 400
    assert text.isprintable()
    assert "module.json" in text


def test_widths_of_columns_are_text_or_an_object(tmp_path: Path) -> None:
    assert read(tmp_path, b'{"col_widths": {"12": 0.5}}') == {"col_widths": "12:0.5"}
    assert read(tmp_path, b'{"row_heights": "1:78mm"}') == {"row_heights": "1:78mm"}
    with pytest.raises(InspectionError, match=r"col_widths: 0\.5 is no list of widths"):
        read(tmp_path, b'{"col_widths": 0.5}')
    with pytest.raises(InspectionError, match="row_heights: 'x' is no width: write NUMBER:WIDTH"):
        read(tmp_path, b'{"row_heights": "x"}')


def test_a_byte_order_mark_does_no_harm(tmp_path: Path) -> None:
    assert read(tmp_path, b'\xef\xbb\xbf{"rows": 6}') == {"rows": 6}
    for coding in ("utf-16", "utf-16-be"):
        text = '{"rows": 6}' if coding == "utf-16" else '\ufeff{"rows": 6}'
        assert read(tmp_path, text.encode(coding)) == {"rows": 6}


def test_a_note_that_is_no_file_is_told(tmp_path: Path) -> None:
    (tmp_path / "module.json").mkdir()
    with pytest.raises(InspectionError, match=r"module\.json is no file but a folder"):
        read_sidecar(tmp_path, [tmp_path / "a.tif"])


def test_a_note_that_is_a_circle_is_told(tmp_path: Path) -> None:
    (tmp_path / "module.json").symlink_to("module.json")
    with pytest.raises(InspectionError, match="leads back to itself"):
        read_sidecar(tmp_path, [tmp_path / "a.tif"])
