"""Trials go with the result folder: they come back, within bounds, and do no harm when damaged."""

from __future__ import annotations

import io
import json
import zipfile
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from pv_inspect.errors import InspectionError
from pv_inspect.results import trials as module
from pv_inspect.results.trials import KeptTrial, read_trials, worth_keeping, write_trials
from pv_inspect.settings import Settings


def trial(number: int, name: str = "", size: int = 12) -> KeptTrial:
    image = np.random.default_rng(number).random((size, size + 1)).astype(np.float32)
    settings = Settings(prior_weight=0.1 * number, skip_frames=("a.png", "b.png"), kappa=-0.25)
    return KeptTrial(number, settings, image, (1, 2), "4.00x, lambda 1", "lambda 1", name)


def test_trials_come_back_with_names_settings_and_pictures(tmp_path: Path) -> None:
    written = [trial(1), trial(2, "scharf, größer")]
    write_trials(written, tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == ["trials.npz"]
    for back, expected in zip(read_trials(tmp_path), written, strict=True):
        assert replace(back, image=expected.image).__dict__ == expected.__dict__
        assert back.image.dtype == np.float32
        # Half precision: a thousandth of a picture's white is below what a screen shows.
        np.testing.assert_allclose(back.image, expected.image, atol=5e-4)


def test_without_a_file_there_are_none(tmp_path: Path) -> None:
    assert read_trials(tmp_path) == ()


def test_what_is_kept_is_bounded_and_names_go_first(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "MOST", 3)
    every = [trial(1, "best"), *(trial(n) for n in range(2, 6))]
    assert [t.number for t in worth_keeping(every)] == [1, 4, 5]
    monkeypatch.setattr(module, "MOST_BYTES", 2 * 12 * 13 * 2)
    assert [t.number for t in worth_keeping(every)] == [1, 5]


@pytest.mark.parametrize("cut", [0, 10, 300, 900])
def test_a_file_that_was_cut_is_one_sentence(tmp_path: Path, cut: int) -> None:
    write_trials([trial(1), trial(2)], tmp_path)
    path = tmp_path / "trials.npz"
    path.write_bytes(path.read_bytes()[:cut])
    with pytest.raises(InspectionError, match=r"The trials kept in .* can't be read"):
        read_trials(tmp_path)


@pytest.mark.parametrize("seed", range(12))
def test_a_file_with_a_turned_bit_is_read_or_is_one_sentence(tmp_path: Path, seed: int) -> None:
    write_trials([trial(1), trial(2)], tmp_path)
    path = tmp_path / "trials.npz"
    content = bytearray(path.read_bytes())
    content[np.random.default_rng(seed).integers(len(content))] ^= 0x10
    path.write_bytes(content)
    with suppress(InspectionError):
        assert len(read_trials(tmp_path)) == 2


@pytest.mark.parametrize(
    "record", [{}, {"number": 1}, {"settings": {"no_such": 1}}, {"cell": [1]}, {"settings": []}]
)
def test_a_record_that_is_none_is_one_sentence(tmp_path: Path, record: dict[str, object]) -> None:
    whole = {"number": 1, "settings": {}, "cell": [0, 0], "caption": "", "text": "", "name": ""}
    about = [{**whole, **record} if "number" not in record and record else record]
    np.savez(
        tmp_path / "trials.npz",
        about=np.array(json.dumps(about)),
        picture_0=np.zeros((2, 2), np.float16),
    )
    with pytest.raises(InspectionError, match="can't be read"):
        read_trials(tmp_path)


def npy(array: NDArray[Any]) -> bytes:
    content = io.BytesIO()
    np.lib.format.write_array(content, array)
    return content.getvalue()


def test_a_text_of_characters_that_do_not_exist_is_one_sentence(tmp_path: Path) -> None:
    # str() of it would be a broken object, on which native code ends in a panic.
    about = np.array([ord("["), 0x19000065, ord("]")], np.uint32).view("<U3")
    np.savez(tmp_path / "trials.npz", about=about)
    with pytest.raises(InspectionError, match="characters that do not exist"):
        read_trials(tmp_path)


HUGE = str({"descr": "<f2", "fortran_order": False, "shape": (10**12, 100)}).ljust(117).encode()


@pytest.mark.parametrize(
    ("about", "picture"),
    [
        ("[{}]", b"no array"),
        ("[{}]", b"\x93NUMPY\x01\x00v\x00" + HUGE + b"\n"),
        ("[" * 100_000, npy(np.zeros((2, 2), np.float16))),
        ('[{"cell": [Infinity, 0], "settings": {}}]', npy(np.zeros((2, 2), np.float16))),
    ],
    ids=["no array", "larger than the memory", "deep", "infinite"],
)
def test_a_file_that_was_made_to_do_harm_is_one_sentence(
    tmp_path: Path, about: str, picture: bytes
) -> None:
    with zipfile.ZipFile(tmp_path / "trials.npz", "w") as file:
        file.writestr("about.npy", npy(np.array(about)))
        file.writestr("picture_0.npy", picture)
    with pytest.raises(InspectionError, match="can't be read"):
        read_trials(tmp_path)


def test_a_damaged_compressed_file_is_one_sentence(tmp_path: Path) -> None:
    np.savez_compressed(tmp_path / "trials.npz", about=np.array("[]"))
    path = tmp_path / "trials.npz"
    content = path.read_bytes()
    begin = content.index(b"about.npy") + len("about.npy") + 20
    path.write_bytes(content[:begin] + b"\xff" * 10 + content[begin + 10 :])
    with pytest.raises(InspectionError, match="can't be read"):
        read_trials(tmp_path)


def test_a_file_larger_than_any_of_ours_is_not_loaded(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write_trials([trial(1, size=60)], tmp_path)
    monkeypatch.setattr(module, "MOST_BYTES", 1000)
    with pytest.raises(InspectionError, match="too large"):
        read_trials(tmp_path)


def test_a_folder_that_went_away_is_one_sentence(tmp_path: Path) -> None:
    with pytest.raises(InspectionError, match="the folder is gone"):
        write_trials([trial(1)], tmp_path / "gone")
    assert not list(tmp_path.iterdir())


def numbers_and_weights(folder: Path) -> list[tuple[int, float | None]]:
    return [(t.number, t.settings.prior_weight) for t in read_trials(folder)]


def test_two_windows_keep_each_others_trials(tmp_path: Path) -> None:
    shared = [trial(1)]
    write_trials(shared, tmp_path)
    ours, theirs = [*shared, trial(2)], [*shared, replace(trial(3), number=2)]
    write_trials(ours, tmp_path, shared)
    write_trials(theirs, tmp_path, shared)
    assert {w for _, w in numbers_and_weights(tmp_path)} == {0.1, 0.2, 3 * 0.1}
    ours = [*ours, trial(4)]
    write_trials(ours, tmp_path, ours[:2])
    found = numbers_and_weights(tmp_path)
    assert {w for _, w in found} == {0.1, 0.2, 3 * 0.1, 0.4}
    assert len({n for n, _ in found}) == 4


def test_a_name_given_in_one_window_survives_a_trial_made_in_the_other(tmp_path: Path) -> None:
    shared = [trial(1), trial(2)]
    write_trials(shared, tmp_path)
    named = [replace(shared[0], name="best"), shared[1]]
    write_trials(named, tmp_path, shared)
    write_trials([*shared, trial(3)], tmp_path, shared)
    assert [t.name for t in read_trials(tmp_path)] == ["best", "", ""]


def test_trials_of_other_frames_are_never_mixed_in(tmp_path: Path) -> None:
    first = [replace(trial(1), frames="/a")]
    second = [replace(trial(2), frames="/b")]
    write_trials(first, tmp_path)
    assert write_trials(second, tmp_path) == 1
    assert [t.frames for t in read_trials(tmp_path)] == ["/b"]
    with pytest.raises(InspectionError, match="a result of other frames"):
        write_trials([*first, replace(trial(3), frames="/a")], tmp_path, first)
    assert [t.frames for t in read_trials(tmp_path)] == ["/b"]
    # The folder has moved together with its frames.
    assert write_trials([replace(second[0], frames="/moved/b")], tmp_path, second) == 0
