"""A folder is replaced as a whole, whoever else writes there and whenever the process is killed."""

from __future__ import annotations

import errno
import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from threading import Event, Thread

import numpy as np
import pytest

from pv_inspect.errors import InspectionError
from pv_inspect.review import ReviewStore, Verdict, VerdictKind
from pv_inspect.storage import folders, locks
from pv_inspect.storage.folders import (
    check_replaceable,
    read_steadily,
    recovered,
    replace_file,
    replace_folder,
    reserved,
)
from pv_inspect.storage.output_paths import check_not_inside, output_folder
from pv_inspect.storage.reservations import changing, reserved_files
from pv_inspect.storage.temporaries import MOVING, PARTIAL, PREVIOUS, lock_of, own
from tests.small_folder import MARKER, NAMES, fill, is_ours, names_in, whole


@pytest.fixture
def out(tmp_path: Path) -> Path:
    """A folder of ours that holds a file of somebody else."""
    fill(tmp_path / "out", "old")
    (tmp_path / "out" / "mine.txt").write_text("mine")
    return tmp_path / "out"


@pytest.fixture(params=["exchanged", "renamed twice"])
def way(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> str:
    """Both ways to replace a folder."""
    if request.param == "renamed twice":
        monkeypatch.setattr(folders, "exchange", lambda *_: False)
    elif not sys.platform.startswith(("linux", "darwin")):
        pytest.skip("folders can't be exchanged here")
    return str(request.param)


# Dies by itself exactly where it is told to; nothing can be cleaned up.
KILLED = """
import os, signal, sys
from pathlib import Path
from pv_inspect.storage import folders
from tests.small_folder import fill

out, where = Path(sys.argv[1]), sys.argv[2]

def die(*_):
    os.kill(os.getpid(), signal.SIGKILL)

exchange, rename, write = folders.exchange, Path.rename, folders._write_file
if where == "before the exchange":
    folders.exchange = die
elif where == "after the exchange":
    folders.exchange = lambda a, b: exchange(a, b) and die()
elif where == "while it writes":
    folders._write_file = lambda path, text: die() if path.name == "b.tif" else write(path, text)
else:
    folders.exchange = lambda a, b: False

    def cut(self, target):
        if where == "before both renames" and self == out:
            die()
        rename(self, target)
        if where == "between the renames" and self == out:
            die()
        if where == "after both renames" and target == out:
            die()

    Path.rename = cut
fill(out, "new")
"""


def killed(out: Path, where: str) -> None:
    done = subprocess.run([sys.executable, "-c", KILLED, str(out), where], cwd=Path.cwd())
    assert done.returncode == -signal.SIGKILL


@pytest.mark.skipif(os.name == "nt", reason="needs SIGKILL")
@pytest.mark.parametrize(
    ("where", "expected"),
    [
        ("while it writes", "old"),
        ("before the exchange", "old"),
        ("after the exchange", "new"),
        ("before both renames", "old"),
        ("between the renames", "old"),
        ("after both renames", "new"),
    ],
)
def test_a_kill_leaves_the_old_or_the_new_folder_and_blocks_nobody(
    out: Path, where: str, expected: str
) -> None:
    killed(out, where)
    if where == "between the renames":
        assert not out.exists()  # it was killed where it was meant to be
    assert recovered(out) == out
    assert whole(out) == expected
    assert (out / "mine.txt").read_text() == "mine"
    fill(out, "next")
    assert whole(out) == "next"
    assert (out / "mine.txt").read_text() == "mine"
    assert names_in(out.parent) == {"out"}  # what was left is gone
    assert names_in(out) == {*NAMES, "mine.txt"}


def test_a_file_that_only_a_cut_replacement_holds_is_taken_over(out: Path) -> None:
    """Written between the look into the old folder and the exchange, then came the kill."""
    left = out.with_name(f".out.{MOVING}-999999999-00000000@{locks.this_host()}")
    left.mkdir()
    (left / "note.txt").write_text("kept")
    (left / "a.tif").write_text("of the old result")
    fill(out, "new")
    assert (out / "note.txt").read_text() == "kept"
    assert whole(out) == "new"
    assert names_in(out.parent) == {"out"}


def test_nothing_is_left_by_a_replacement(out: Path, way: str) -> None:
    fill(out, "new")
    assert whole(out) == "new"
    assert names_in(out.parent) == {"out"}
    assert names_in(out) == {*NAMES, "mine.txt"}


# Two processes


def test_a_second_process_is_refused_at_once_and_told_who_writes(out: Path) -> None:
    code = (
        "import sys; from pathlib import Path; from pv_inspect.storage.folders import *\n"
        "from tests.small_folder import *\n"
        "with reserved(Path(sys.argv[1]), MARKER, is_ours): pass"
    )
    with reserved(out, MARKER, is_ours) as place:
        done = subprocess.run(
            [sys.executable, "-c", code, str(out)], capture_output=True, text=True, cwd=Path.cwd()
        )
        assert done.returncode == 1
        sentence = f"Another pv-inspect (process {os.getpid()} on {locks.this_host()}, since "
        assert sentence in done.stderr
        assert "wait until it is done or give another folder" in done.stderr
        place.fill([(name, b"new") for name in NAMES])
    assert whole(out) == "new"
    assert names_in(out.parent) == {"out"}


def test_a_second_reservation_of_the_same_process_is_refused_too(tmp_path: Path) -> None:
    with (
        reserved(tmp_path / "x" / "out", MARKER, is_ours),
        pytest.raises(InspectionError, match="is writing to"),
        reserved(tmp_path / "x" / "out", MARKER, is_ours),
    ):
        pass
    assert names_in(tmp_path) == set()  # the folder that was made for it is gone as well


def test_who_saves_once_waits_for_another_one_who_does(out: Path) -> None:
    begun, ended = Event(), Event()

    def slow() -> Iterator[tuple[str, bytes]]:
        for name in NAMES:
            begun.set()
            ended.wait(0.1)
            yield name, b"slow"

    first = Thread(target=lambda: replace_folder(out, slow(), MARKER, is_ours))
    first.start()
    begun.wait()
    fill(out, "last")
    first.join()
    assert whole(out) == "last"


def begun(out: Path, text: str) -> subprocess.Popen[str]:
    """Start a process that fills the folder and ends with 0, or 1 if it is refused."""
    code = (
        "import sys; from pathlib import Path; from tests.small_folder import fill\n"
        "fill(Path(sys.argv[1]), sys.argv[2])"
    )
    return subprocess.Popen(
        [sys.executable, "-c", code, str(out), text],
        stderr=subprocess.DEVNULL,
        text=True,
        cwd=Path.cwd(),
    )


@pytest.mark.parametrize("seed", range(3))
def test_pairs_of_processes_leave_one_whole_folder_and_true_exit_codes(
    out: Path, seed: int
) -> None:
    """A share of benchmarks/result_faults.py."""
    offset_s = np.random.default_rng(seed).uniform(0, 0.2)
    first = begun(out, "A")
    time.sleep(offset_s)
    second = begun(out, "B")
    codes = {"A": first.wait(), "B": second.wait()}
    assert set(codes.values()) <= {0, 1}
    assert codes[whole(out)] == 0
    assert names_in(out.parent) == {"out"}
    assert (out / "mine.txt").read_text() == "mine"


@pytest.mark.skipif(os.name == "nt", reason="needs SIGKILL")
@pytest.mark.parametrize("seed", range(4))
def test_a_process_killed_at_any_moment_leaves_one_whole_folder(out: Path, seed: int) -> None:
    """A share of benchmarks/result_faults.py."""
    process = begun(out, "A")
    time.sleep(np.random.default_rng(seed).uniform(0, 0.3))
    process.kill()
    assert whole(recovered(out)) in (("A",) if process.wait() == 0 else ("old", "A"))
    fill(out, "next")
    assert names_in(out.parent) == {"out"}
    assert names_in(out) == {*NAMES, "mine.txt"}


def owner(path: Path, **changes: object) -> None:
    record = {"pid": 4_000_000, "host": "elsewhere", "since": "2026-01-02 03:04:05", "token": "x"}
    path.write_text(json.dumps(record | changes))


def test_an_owner_on_another_computer_holds_until_it_gives_no_sign_of_life(out: Path) -> None:
    lock = lock_of(out)
    owner(lock)
    with pytest.raises(InspectionError, match=r"process 4000000 on elsewhere, since 2026-01-02"):
        check_reserved(out)
    os.utime(lock, (1, 1))
    check_reserved(out)
    assert names_in(out.parent) == {"out"}


@pytest.mark.parametrize("text", ["", "no JSON", "[]", '{"pid": "x"}', "[" * 4000])
def test_a_lock_file_that_a_kill_cut_or_somebody_wrote_holds_nobody_up(
    out: Path, text: str
) -> None:
    lock_of(out).write_text(text)
    check_reserved(out)
    assert names_in(out.parent) == {"out"}


@pytest.mark.parametrize("held", [True, False])
def test_without_locks_of_the_system_the_process_of_the_owner_decides(
    out: Path, monkeypatch: pytest.MonkeyPatch, held: bool
) -> None:
    monkeypatch.setattr(locks, "_locked", lambda _: None)
    ended = subprocess.Popen([sys.executable, "-c", ""])
    ended.wait()
    pid = os.getpid() if held else ended.pid
    owner(lock_of(out), pid=pid, host=locks.this_host())
    if held:
        with pytest.raises(InspectionError, match=f"process {pid}"):
            check_reserved(out)
    else:
        check_reserved(out)


def check_reserved(out: Path) -> None:
    with reserved(out, MARKER, is_ours):
        pass


def test_one_that_lost_its_lock_while_it_slept_writes_nothing(out: Path) -> None:
    with reserved(out, MARKER, is_ours) as place:
        owner(lock_of(out), pid=1)
        with pytest.raises(InspectionError, match=r"took .* over while this one stood still"):
            place.fill([(name, b"new") for name in NAMES])
    assert whole(out) == "old"
    assert names_in(out.parent) == {"out", ".out.lock"}  # it belongs to the other one


def test_what_living_processes_write_is_left_alone_and_what_dead_ones_left_is_removed(
    out: Path,
) -> None:
    beside = out.parent
    living = own(out, PARTIAL)
    gone = beside / f".out.{PARTIAL}-4000000-00000000@{locks.this_host()}"
    abandoned = beside / f".out.{PARTIAL}-1-00000000@elsewhere"
    elsewhere = beside / f".out.{PARTIAL}-2-00000000@elsewhere"
    others = beside / f".out.2.{PARTIAL}-4000000-00000000@{locks.this_host()}"
    earlier = beside / ".out.partial"
    for folder in (living, gone, abandoned, elsewhere, others, earlier):
        folder.mkdir()
    os.utime(abandoned, (1, 1))
    fill(out, "new")
    assert names_in(beside) == {"out", living.name, elsewhere.name, others.name}


def test_an_old_folder_is_not_brought_back_while_another_process_moves(
    out: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(folders, "_GAP_S", 0.1)
    with reserved(out, MARKER, is_ours):
        out.rename(own(out, PREVIOUS))
        assert not recovered(out).exists()
    assert whole(recovered(out)) == "old"


def test_a_reader_sees_the_old_or_the_new_folder_never_both(out: Path, way: str) -> None:
    done = Event()

    def replacing() -> None:
        for k in range(15):
            fill(out, f"result {k}")
        done.set()

    def read() -> str:
        said = []
        for name in NAMES:
            try:
                said.append((out / name).read_text())
            except OSError:
                raise InspectionError("a file is missing") from None
        if len(set(said)) != 1:
            # As a result whose files do not fit each other.
            raise InspectionError(f"a mixture: {said}")
        return said[0]

    writer = Thread(target=replacing)
    writer.start()
    try:
        while not done.is_set():
            read_steadily(out, read)
    finally:
        writer.join()


# What others have put there


def test_a_file_that_appears_or_changes_while_the_folders_change_places_is_kept(
    out: Path, monkeypatch: pytest.MonkeyPatch, way: str
) -> None:
    real = folders._sync_folder
    (out / "linked.txt").write_text("before")

    def late(folder: Path) -> None:
        real(folder)
        if ".partial-" in folder.name:  # looked through already, not yet in place
            (out / "late.txt").write_text("late")
            (out / "deep").mkdir()
            (out / "deep" / "late.txt").write_text("late")
            (out / "linked.new").write_text("after")
            (out / "linked.new").replace(out / "linked.txt")

    monkeypatch.setattr(folders, "_sync_folder", late)
    fill(out, "new")
    assert whole(out) == "new"
    assert (out / "late.txt").read_text() == (out / "deep" / "late.txt").read_text() == "late"
    assert (out / "linked.txt").read_text() == "after"
    assert (out / "mine.txt").read_text() == "mine"


def no_links(*_: object, **__: object) -> None:
    raise OSError(errno.EPERM, "no hard links here")


@pytest.mark.parametrize("links", [True, False])
def test_no_verdict_is_lost_that_is_stored_while_results_are_replaced(
    out: Path, monkeypatch: pytest.MonkeyPatch, way: str, links: bool
) -> None:
    if not links:
        monkeypatch.setattr(os, "link", no_links)
    ended, stored = Event(), 0

    def judge() -> None:
        nonlocal stored
        with ReviewStore(out) as store:
            while not ended.is_set():
                cell = divmod(stored, 40)
                # What is refused aloud is given again; what was taken must stay.
                with suppress(InspectionError):
                    store.give(Verdict(*cell, VerdictKind.OK, "Ann"))
                    stored += 1
                ended.wait(0.002)  # faster than any hand, and others get their turn

    judging = Thread(target=judge)
    judging.start()
    try:
        n = 0
        while judging.is_alive() and (n < 6 or stored <= 6):
            fill(out, f"result {n}")
            n += 1
    finally:
        ended.set()
        judging.join()
    assert stored > 6
    assert len(ReviewStore(out).current()) == stored


def test_without_links_a_database_in_use_is_refused_and_not_copied_half(
    out: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(os, "link", no_links)
    monkeypatch.setattr("pv_inspect.storage.preserved_files._BUSY_S", 0.05)
    with ReviewStore(out) as store:
        store.give(Verdict(0, 0, VerdictKind.OK, "Ann"))
        with (
            store.writing(),
            pytest.raises(InspectionError, match=r"review\.sqlite is in use .*nothing was changed"),
        ):
            fill(out, "new")
    assert whole(out) == "old"
    assert names_in(out.parent) == {"out"}


def test_a_file_is_not_written_while_the_folder_changes_places(out: Path) -> None:
    begun, order = Event(), list[str]()

    def write() -> None:
        begun.wait()
        with changing(out):
            order.append("file")
            replace_file(out / "trials.npz", b"x")

    thread = Thread(target=write)
    thread.start()
    with changing(out):
        begun.set()
        thread.join(0.2)
        order.append("folder")
    thread.join()
    assert order == ["folder", "file"]
    assert names_in(out) == {*NAMES, "mine.txt", "trials.npz"}


def test_what_is_said_about_the_folder_is_looked_up(
    out: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with reserved(out, MARKER, is_ours) as place:
        assert place.so_far() == "nothing was changed there"
        out.rename(out.with_name("moved by its owner"))
        assert "was changed by somebody else" in place.so_far()
        place.fill([(name, b"new") for name in NAMES])
        assert place.so_far() == f"the new result is in {out}"
    with reserved(out.with_name("other"), MARKER, is_ours) as place:
        assert place.so_far() == "nothing was written"


@pytest.mark.skipif(os.name == "nt", reason="needs limits of a process")
@pytest.mark.parametrize("room", [0, 5_000, 25_000, 45_000])
def test_a_real_limit_of_the_system_leaves_the_old_folder_and_says_so(out: Path, room: int) -> None:
    code = (
        "import resource, sys; from pathlib import Path; from pv_inspect.storage.folders import *\n"
        "from tests.small_folder import *\n"
        "resource.setrlimit(resource.RLIMIT_FSIZE, (int(sys.argv[2]),) * 2)\n"
        "files = [(name, b'x' * size) for name, size in zip(NAMES, (10_000, 30_000, 50_000))]\n"
        "replace_folder(Path(sys.argv[1]), files, MARKER, is_ours)"
    )
    done = subprocess.run(
        [sys.executable, "-B", "-c", code, str(out), str(room)],
        capture_output=True,
        text=True,
        cwd=Path.cwd(),
    )
    assert done.returncode == 1
    assert "InspectionError: The result can't be written to" in done.stderr
    assert whole(out) == "old"
    assert names_in(out.parent) == {"out"}


# Where an output may go


@pytest.fixture
def place(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Folders, files and links of every bad kind; ``here`` is the current folder."""
    (tmp_path / "here").mkdir()
    monkeypatch.chdir(tmp_path / "here")
    (tmp_path / "loop").symlink_to("pool")
    (tmp_path / "pool").symlink_to("loop")
    (tmp_path / "self").symlink_to("self")
    (tmp_path / "nowhere").symlink_to("gone/far")
    (tmp_path / "file").write_text("")
    return tmp_path


@pytest.mark.parametrize(
    ("out", "said"),
    [
        ("/", "is the root of the file system"),
        ("", "is the current folder or holds it"),
        (".", "is the current folder or holds it"),
        ("..", "is the current folder or holds it"),
        ("../loop", "is a link that leads back to itself"),
        ("../self/out", "is a link that leads back to itself"),
        ("../nowhere", "is a link to gone/far, which does not exist"),
        ("../nowhere/out", "is a link to gone/far, which does not exist"),
        ("../file", "is a file: give a folder"),
        ("../file/out", "is a file, so that there can't be a folder"),
        ("../" + "n" * 300, "can't be a folder"),
        ("~nobody-of-this-name/out", "no such home folder is known"),
        ("a\0b", "can't be a folder"),
    ],
)
def test_a_place_where_no_result_can_be_is_one_sentence(place: Path, out: str, said: str) -> None:
    before = names_in(place)
    with pytest.raises(InspectionError, match=said) as caught:
        check_replaceable(Path(out), MARKER)
    assert len(str(caught.value)) < 400
    assert names_in(place) == before


def test_a_name_as_long_as_the_system_takes_is_fine(tmp_path: Path) -> None:
    for name in ("n" * 255, "ä" * 127):
        fill(tmp_path / name, "new")
        fill(tmp_path / name, "newer")
        assert whole(tmp_path / name) == "newer"
        assert names_in(tmp_path) == {name}
        with reserved(tmp_path / name, MARKER, is_ours):
            pass
        for path in (tmp_path / name).iterdir():
            path.unlink()
        (tmp_path / name).rmdir()


@pytest.mark.parametrize("code", [errno.EROFS, errno.EACCES, errno.EPERM])
def test_a_read_only_folder_is_named_as_such(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, code: int
) -> None:
    def denied(*_: object, **__: object) -> None:
        raise OSError(code, os.strerror(code))

    monkeypatch.setattr(Path, "mkdir", denied)
    with pytest.raises(InspectionError) as caught:
        check_replaceable(tmp_path / "out", MARKER)
    assert f"{tmp_path} is read-only ({os.strerror(code)})" in str(caught.value)


def test_a_result_that_is_read_only_itself_is_named_as_such(
    out: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(os, "access", lambda *_: False)
    with pytest.raises(InspectionError, match=f"{out} is read-only"):
        check_replaceable(out, MARKER)


def test_the_folder_of_the_frames_and_those_around_it_are_refused(tmp_path: Path) -> None:
    frames = tmp_path / "a" / "frames"
    frames.mkdir(parents=True)
    for bad in (frames, tmp_path / "a", tmp_path):
        with pytest.raises(InspectionError, match="would be replaced together with"):
            check_not_inside(bad, frames, "The frames")
    check_not_inside(frames / "result", frames, "The frames")
    check_not_inside(tmp_path / "b", frames, "The frames")


def test_files_written_one_by_one_have_their_folder_alone(tmp_path: Path) -> None:
    with reserved_files(tmp_path / "maps") as place:
        replace_file(place / "a.tif", b"x")
        with (
            pytest.raises(InspectionError, match=f"process {os.getpid()} on .* is writing to"),
            reserved_files(tmp_path / "maps"),
        ):
            pass
    assert names_in(tmp_path / "maps") == {"a.tif"}
    with suppress(KeyboardInterrupt), reserved_files(tmp_path / "empty"):
        raise KeyboardInterrupt
    assert names_in(tmp_path) == {"maps"}


def test_a_link_to_a_folder_stays_a_link(tmp_path: Path) -> None:
    (tmp_path / "real").mkdir()
    (tmp_path / "link").symlink_to("real")
    fill(tmp_path / "link", "new")
    assert (tmp_path / "link").is_symlink()
    assert whole(tmp_path / "real") == "new"
    assert output_folder(tmp_path / "link") == tmp_path / "real"


def test_a_reader_is_not_deceived_by_a_folder_with_the_number_of_the_old_one(
    out: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A folder that was replaced twice may have the inode that the reader has seen first."""
    real = Path.stat

    def same_number(self: Path, **options: bool) -> os.stat_result:
        found = list(real(self, **options))
        if self == out:
            found[1] = 7
        times = real(self, **options)
        return os.stat_result(found, {"st_mtime_ns": times.st_mtime_ns})

    def read() -> str:
        first = (out / NAMES[0]).read_text()
        if first == "old":
            monkeypatch.undo()
            fill(out, "new")
            monkeypatch.setattr(Path, "stat", same_number)
        if (out / NAMES[1]).read_text() != first:
            raise InspectionError("a mixture")
        return first

    monkeypatch.setattr(Path, "stat", same_number)
    assert read_steadily(out, read) == "new"
