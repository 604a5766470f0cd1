"""The scripted session of docs/tour, walked through on the sample in a real window."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from napari_pv_inspect.sample import CHECKOUT_SAMPLE

DOCS = Path(__file__).parents[2] / "docs"


@pytest.mark.xvfb
@pytest.mark.slow
def test_an_expert_walks_through_all_six_steps_by_mouse_and_keyboard(
    make_napari_viewer: Callable[..., Any], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    if not CHECKOUT_SAMPLE.is_dir():
        pytest.skip("sample_data/ is not in this checkout")
    monkeypatch.syspath_prepend(str(DOCS))
    from tour import walk

    walk(lambda: make_napari_viewer(show=True), CHECKOUT_SAMPLE, tmp_path / "tour")
    assert len(list((tmp_path / "tour").iterdir())) == 14


def test_every_picture_of_the_tour_is_on_a_page() -> None:
    pages = "".join(page.read_text("utf-8") for page in (DOCS / "tour").glob("*.md"))
    pictures = list((DOCS / "tour").glob("*.png"))
    assert pictures
    assert [p.name for p in pictures if f"({p.name})" not in pages] == []
