"""The page on theory leads from every equation of the paper to what computes it."""

from __future__ import annotations

import re
from functools import reduce
from importlib import import_module
from pathlib import Path

import pytest

PAGE = Path(__file__).parents[1] / "docs" / "theory.md"
_SECTION = re.compile(r"^## (?:Eq\. (\d+))?.*?$(.*?)(?=^## |\Z)", re.MULTILINE | re.DOTALL)
_LINK = re.compile(r"\[`([\w.]+)`\]\[(pv_inspect[\w.]*)\]")


def sections() -> dict[int, str]:
    return {int(n): text for n, text in _SECTION.findall(PAGE.read_text("utf-8")) if n}


def named(path: str) -> object:
    """Import the longest module that a dotted name begins with and look up the rest."""
    parts = path.split(".")
    for length in range(len(parts), 0, -1):
        try:
            module = import_module(".".join(parts[:length]))
        except ModuleNotFoundError:
            continue
        return reduce(getattr, parts[length:], module)
    raise ModuleNotFoundError(path)


def test_every_equation_of_the_paper_has_a_section_with_its_formula() -> None:
    assert sorted(sections()) == list(range(1, 13))
    for text in sections().values():
        assert len(re.findall(r"^\$\$.+\$\$$", text, re.MULTILINE)) >= 1


@pytest.mark.parametrize("equation", range(1, 13))
def test_an_equation_leads_to_a_function_or_class_that_exists(equation: int) -> None:
    links = _LINK.findall(sections()[equation])
    assert links
    assert any(callable(named(path)) for _, path in links)


def test_every_name_on_the_page_exists_and_is_shown_as_it_is_called() -> None:
    links = _LINK.findall(PAGE.read_text("utf-8"))
    # Nothing that looks like a link to a name is missed by the pattern.
    assert len(links) == PAGE.read_text("utf-8").count("][pv_inspect")
    for shown, path in links:
        named(path)
        assert path.endswith(f".{shown}")
