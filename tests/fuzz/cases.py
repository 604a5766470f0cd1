"""What every reader is given, and how often."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import fields

import hypothesis.strategies as st

from pv_inspect.settings import Settings
from pv_inspect.simulate import SimulationSettings
from tests.fuzz import seeds
from tests.fuzz.case import Case
from tests.fuzz.coded import jpegs, pngs
from tests.fuzz.raw import damaged, tiffs
from tests.fuzz.readers import matching
from tests.fuzz.stacks import array_files, videos
from tests.fuzz.stored import databases, models, zips
from tests.fuzz.texts import encoded, json_texts, odd_strings, tokens
from tests.fuzz.values import VALUE_TYPES, odd_values, other_text

__all__ = ["CASES", "SHARES"]


@st.composite
def _tiff_frames(draw: st.DrawFn) -> Case:
    name = draw(st.sampled_from(("frames/frame_1.tif", "frames/stack.tiff", "frames/frame_9.tif")))
    files: list[tuple[str, bytes | None]] = [(name, draw(tiffs()))]
    if draw(st.booleans()):  # alone
        files += [(known, None) for known in seeds.frames() if known.endswith(".tif")]
        files.sort(key=lambda file: file[1] is not None)
    return Case("frames", tuple(files))


@st.composite
def _png_frames(draw: st.DrawFn) -> Case:
    files: list[tuple[str, bytes | None]] = [("frames/frame_1.png", draw(pngs()))]
    if draw(st.booleans()):
        files = [(known, None) for known in seeds.frames() if known.endswith(".tif")] + files
    return Case("frames", tuple(files))


@st.composite
def _photo_frames(draw: st.DrawFn) -> Case:
    """JPEG and BMP, alone or beside the others."""
    suffix = draw(st.sampled_from((".jpg", ".jpeg", ".bmp")))
    name = draw(st.sampled_from(("frame_1", "frame_9", "preview")))
    files: list[tuple[str, bytes | None]] = [(f"frames/{name}{suffix}", draw(jpegs()))]
    if draw(st.booleans()):
        files = [(known, None) for known in seeds.frames() if not known.endswith(".json")] + files
    return Case("frames", tuple(files))


@st.composite
def _value_frames(draw: st.DrawFn) -> Case:
    """Whole TIFF files whose values are odd."""
    files: list[tuple[str, bytes | None]] = [
        (known, None) for known in seeds.frames() if not known.endswith(".json")
    ]
    odd, dtype = draw(odd_values()), draw(st.sampled_from(VALUE_TYPES))
    files += [
        (f"frames/f_{k}.tif", seeds.tiff_of(odd(seeds.picture(k), dtype)))
        for k in range(draw(st.integers(1, 3)))
    ]
    return Case("frames", tuple(files))


@st.composite
def _series_frames(draw: st.DrawFn) -> Case:
    """Stacks of several series, with a wish or without one."""
    stacks = [data for data in seeds.tiffs() if len(data) > 20_000]
    data = draw(st.sampled_from(stacks))
    if draw(st.booleans()):
        data = draw(damaged(data))
    files: list[tuple[str, bytes | None]] = [
        (known, None) for known in seeds.frames() if not known.endswith(".json")
    ]
    wish = draw(st.one_of(st.just(()), st.sampled_from((("1",), ("2",))), st.tuples(odd_strings)))
    return Case("frames", (*files, ("frames/stack.tif", data)), wish)


@st.composite
def _videos(draw: st.DrawFn) -> Case:
    """Damaged videos, and whole ones under the names of others."""
    known = videos() or {"a.avi": b"RIFF"}
    name = draw(st.sampled_from(sorted(known)))
    data = known[name]
    kind = draw(st.sampled_from(("whole", "anywhere", "anywhere", "head", "head", "tail")))
    if kind == "anywhere":
        data = draw(damaged(data, 6))
    elif kind == "head":
        n = draw(st.sampled_from((60, 400, 1500)))
        data = draw(damaged(data[:n])) + data[n:]
    elif kind == "tail":  # where MP4 has its index
        n = draw(st.sampled_from((60, 400, 1500)))
        data = data[:-n] + draw(damaged(data[-n:]))
    ending = draw(st.sampled_from((name[1:], name[1:], ".mp4", ".avi", ".m4v")))
    files: list[tuple[str, bytes | None]] = [
        (known, None) for known in seeds.frames() if not known.endswith(".json")
    ]
    return Case("frames", (*files, (f"frames/v{ending}", data)))


@st.composite
def _array_frames(draw: st.DrawFn) -> Case:
    """Damaged stacks of NumPy, FITS and HDF5."""
    name = draw(st.sampled_from(sorted(array_files())))
    data = array_files()[name]
    kind = draw(st.sampled_from(("whole", "anywhere", "head", "head", "text")))
    if kind == "anywhere":
        data = draw(damaged(data))
    elif kind == "head":  # where the sizes stand
        n = draw(st.sampled_from((80, 400, 3000)))
        data = draw(damaged(data[:n])) + data[n:]
    elif kind == "text":
        data = draw(other_text(data))
    files: list[tuple[str, bytes | None]] = [
        (known, None) for known in seeds.frames() if not known.endswith(".json")
    ]
    wish = draw(st.sampled_from(((), (), ("1",), ("2",), ("frames",), ("entry/data",))))
    return Case("frames", (*files, (f"frames/{name}", data)), wish)


@st.composite
def _named_frames(draw: st.DrawFn) -> Case:
    """Pictures under the names of other kinds, and odd names."""
    data = draw(st.sampled_from(seeds.pictures()))
    stem = draw(st.sampled_from(("a", "ä b", "x" * 240, "\x1b[31m", "a\nb", "=1+1", "%s", "-x")))
    suffix = draw(st.sampled_from((".tif", ".png", ".TIFF", ".PNG", ".jpg")))
    content = draw(damaged(data)) if draw(st.booleans()) else data
    return Case("frames", ((f"frames/{stem}{suffix}", content),))


_TARGETS = ("frame_0.tif", "../frames/frame_0.tif", "loop.tif", ".", "..", "none", "|", "/")
_TARGETS += ("/dev/null", "/dev/zero", "/dev/full", "/proc/self/mem", "/proc/self/environ")
_LINKS = {
    "frames": ("frames/frame_9.tif", "frames/frame_9.png", "frames/module.json", "frames/frames"),
    "settings": ("settings.toml",),
    "camera": ("camera.yaml",),
    "session": ("session.json",),
    "trials": ("trials.npz",),
    "review": ("review.sqlite",),
    "model": ("model.onnx", "model.json"),
    "result": tuple(f"result/{name}" for name in ("result.json", "geometry.json", "cells.csv"))
    + tuple(f"result/{name}.tif" for name in ("module_hr", "support", "cracks")),
    "plain cell": ("cells/cell.png", "cells/cell.jpg"),
}


@st.composite
def _links(draw: st.DrawFn) -> Case:
    """Files that are links, pipes, folders or devices."""
    reader = draw(st.sampled_from(sorted(_LINKS)))
    name = draw(st.sampled_from(_LINKS[reader]))
    links = [(name, draw(st.sampled_from(_TARGETS)))]
    if reader == "frames" and draw(st.booleans()):
        links.append(("frames/loop.tif", draw(st.sampled_from(("loop.tif", "loop2.tif")))))
        links.append(("frames/loop2.tif", "loop.tif"))
    gone = [(name, None)]
    if reader == "plain cell":
        gone.append(("cells/cell.png", None))
    args = ("camera.yaml",) if reader == "camera" else ()
    return Case(reader, tuple(gone), args, tuple(links))


@st.composite
def _sidecars(draw: st.DrawFn) -> Case:
    text = '{"rows": 2, "cols": 3, "cell_aspect": 1.0, "serial": "7", "more": [1, {"a": null}]}'
    data = draw(encoded(st.one_of(json_texts(text), tokens(text))))
    return Case("frames", (("frames/module.json", data),))


@st.composite
def _references(draw: st.DrawFn) -> Case:
    kind = draw(st.sampled_from(("dark_frame", "flat_frame")))
    data = draw(st.one_of(tiffs(), st.sampled_from(seeds.pictures())))
    name = draw(st.sampled_from(("other.tif", "other.png", "other.jpg")))
    return Case("references", ((name, data),), (kind, name))


@st.composite
def _plain_cells(draw: st.DrawFn) -> Case:
    kind = draw(st.sampled_from(("jpg", "jpg", "bmp", "jpeg", "png", "tif", "any")))
    if kind == "any":
        kind = draw(st.sampled_from(("jpg", "bmp", "png", "tif")))
        data = draw(damaged(draw(st.sampled_from(seeds.pictures()))))
    else:
        data = draw({"png": pngs(), "tif": tiffs()}.get(kind, jpegs()))
    return Case("plain cell", (("cells/cell.png", None), (f"cells/cell.{kind}", data)))


@st.composite
def _settings(draw: st.DrawFn) -> Case:
    return Case("settings", (("settings.toml", draw(encoded(tokens(seeds.settings_text())))),))


@st.composite
def _presets(draw: st.DrawFn) -> Case:
    data = draw(encoded(tokens("magnification = 3.0\nprior = 'btv'\nsecond_look = true\n")))
    name = draw(st.one_of(st.just("good for mono"), odd_strings))
    files = (("presets/usual.toml", data),) if draw(st.booleans()) else ()
    return Case("preset", files, (name.replace("\0", ""),))


@st.composite
def _cameras(draw: st.DrawFn) -> Case:
    name, text = draw(st.sampled_from(seeds.calibrations()))
    texts = json_texts(text) if name.endswith(".json") and draw(st.booleans()) else tokens(text)
    return Case("camera", ((name, draw(encoded(texts))),), (name,))


_RESULT_FILES = (*("result.json",) * 6, *("geometry.json",) * 4, "cells.csv", "tif")


@st.composite
def _results(draw: st.DrawFn) -> Case:
    files = seeds.result_files()
    name = draw(st.sampled_from(_RESULT_FILES))
    if name == "tif":
        known = [n for n in files if n.startswith("result/") and n.endswith(".tif")]
        path = draw(st.sampled_from(known))
        kinds = st.one_of(tiffs(), damaged(files[path]), damaged(files[path][-600:]))
        return Case("result", ((path, draw(st.one_of(kinds, st.none()))),))
    path = f"result/{name}"
    text = files[path].decode()
    texts = tokens(text) if name == "cells.csv" else json_texts(text)
    return Case("result", ((path, draw(encoded(texts))),))


@st.composite
def _sessions(draw: st.DrawFn) -> Case:
    texts = st.one_of(json_texts(seeds.SESSION), tokens(seeds.SESSION))
    return Case("session", (("session.json", draw(encoded(texts))),))


_ABOUT = (
    '[{"number": 1, "settings": {"prior_weight": 0.1, "kappa": -0.2}, "cell": [1, 2], '
    '"caption": "c", "text": "t", "name": "n"}, {"number": 2, "settings": {}, "cell": [0, 0], '
    '"caption": "", "text": "", "name": ""}]'
)


@st.composite
def _trials(draw: st.DrawFn) -> Case:
    return Case("trials", (("trials.npz", draw(zips(seeds.kept_trials(), json_texts(_ABOUT)))),))


@st.composite
def _reviews(draw: st.DrawFn) -> Case:
    return Case("review", (("review.sqlite", draw(databases())),))


@st.composite
def _models(draw: st.DrawFn) -> Case:
    network, about = seeds.model()
    if draw(st.integers(0, 2)) == 0:
        text = draw(encoded(json_texts(about)))
        return Case("model", (("model.json", text),))
    network = draw(models())
    return Case("model", (("model.onnx", network), ("model.json", matching(network, about))))


_PATHS = st.one_of(
    st.sampled_from(("frames", "result", "cells", "settings.toml", "camera.yaml", "none")),
    odd_strings,
)
_OPTION_NAMES = tuple(f"--{name.replace('_', '-')}" for name in Settings.model_fields)
_OPTION_NAMES += ("--out", "-o", "-m", "--lambda", "--settings", "--threads", "-q", "--keep-frame")
_OPTION_NAMES += ("--skip-frame", "--calibration", "--focal-length", "--psf-sigma", "--no-such")
_VALUES = st.one_of(
    st.sampled_from(("0", "1", "2", "3", "-1", "1e400", "nan", "inf", "-inf", "200", "201", "0.5")),
    st.sampled_from(("1" * 400, "btv", "ridge", "network", "frames/frame_0.tif", "1,2", "１")),
    _PATHS,
)


@st.composite
def _commands(draw: st.DrawFn) -> Case:
    verb = draw(st.sampled_from(("run",) * 6 + ("review", "review", "cracks", "cracks", "odd")))
    if verb == "odd":
        verb = draw(odd_strings)
    args = [verb]
    if draw(st.integers(0, 9)):
        args.append("frames" if draw(st.booleans()) else draw(_PATHS))
    if draw(st.integers(0, 9)):
        args += ["--out", draw(st.one_of(st.just("new"), _PATHS))]
    for _ in range(draw(st.integers(0, 3))):
        args.append(draw(st.one_of(st.sampled_from(_OPTION_NAMES), odd_strings)))
        args += [draw(_VALUES) for _ in range(draw(st.sampled_from((0, 1, 1, 1, 2))))]
    if verb == "review":
        option = st.sampled_from(("--serial", "--current", "--exposure", "--temperature"))
        args = [verb, draw(st.one_of(st.just("result"), _PATHS)), draw(option), draw(_VALUES)]
    if verb == "cracks":  # it writes: nothing outside of the folder of the case
        args = [argument.lstrip("/").replace("../../..", "..") for argument in args]
    return Case("command", (), tuple(map(_speakable, args)))


@st.composite
def _simulations(draw: st.DrawFn) -> Case:
    args = ["simulate", draw(st.sampled_from(("new", "frames", "settings.toml")))]
    names = [spec.name for spec in fields(SimulationSettings)]
    for _ in range(draw(st.integers(1, 3))):
        name = draw(st.one_of(st.sampled_from(names), st.sampled_from(names), odd_strings))
        sign = draw(st.sampled_from(("=", "=", "=", " = ", "", "==")))
        args += ["--set", f"{name}{sign}{draw(_VALUES)}"]
    return Case("command", (), tuple(map(_speakable, args)))


def _speakable(argument: str) -> str:
    """Return what a shell can hand over."""
    return argument.replace("\0", "")


CASES: dict[str, Callable[[], st.SearchStrategy[Case]]] = {
    "frames, TIFF": _tiff_frames,
    "frames, PNG": _png_frames,
    "frames, photos": _photo_frames,
    "frames, values": _value_frames,
    "frames, series": _series_frames,
    "frames, arrays": _array_frames,
    "frames, videos": _videos,
    "frames, odd names": _named_frames,
    "links, pipes, devices": _links,
    "module.json": _sidecars,
    "dark and flat frames": _references,
    "plain cells": _plain_cells,
    "settings": _settings,
    "presets": _presets,
    "calibration": _cameras,
    "result folder": _results,
    "session.json": _sessions,
    "trials.npz": _trials,
    "review.sqlite": _reviews,
    "crack model": _models,
    "command line": _commands,
    "simulate --set": _simulations,
}
SHARES = {
    "frames, TIFF": 24,
    "frames, PNG": 10,
    "frames, photos": 4,
    "frames, values": 4,
    "frames, series": 3,
    "frames, arrays": 8,
    "frames, videos": 6,
    "frames, odd names": 3,
    "links, pipes, devices": 2,
    "module.json": 5,
    "dark and flat frames": 4,
    "plain cells": 9,
    "settings": 6,
    "presets": 3,
    "calibration": 8,
    "result folder": 10,
    "session.json": 2,
    "trials.npz": 4,
    "review.sqlite": 6,
    "crack model": 3,
    "command line": 6,
    "simulate --set": 3,
}
"""Weights of the kinds among all cases."""
assert CASES.keys() == SHARES.keys()
