"""Every place where the program reads what others may have written.

A reader gets a folder with files and returns nothing. It raises InspectionError where the input is
refused; what is accepted has to be what the reader promises, or an AssertionError is raised.
"""

from __future__ import annotations

import hashlib
import json
import os
import shutil
import signal
import threading
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from time import process_time
from typing import Any

import numpy as np

from pv_inspect.errors import InspectionError
from tests.fuzz import seeds
from tests.fuzz.case import fault_of

__all__ = ["MISBEHAVIOUR", "READERS", "Kind", "prepared"]

Args = tuple[str, ...]


@dataclass(frozen=True)
class Kind:
    """A reader and its valid input.

    Parameters
    ----------
    read : callable
        Takes the folder and the arguments of the case.
    files : callable
        Returns what lies in the folder where a case says nothing else.
    args : tuple of str
        Arguments that are valid.
    """

    read: Callable[[Path, Args], None]
    files: Callable[[], dict[str, bytes]] = field(default=dict)
    args: Args = ()


def prepared(reader: str, folder: Path) -> None:
    """Put the valid input of a reader into a folder, which is made anew."""
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    for name, content in READERS[reader].files().items():
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(content)


def _frames(folder: Path, args: Args) -> None:
    from pv_inspect.sequence.sequence import FrameSequence

    sequence = FrameSequence.open(folder / "frames", series=args[0] if args else None)
    _check_sequence(sequence)


def _references(folder: Path, args: Args) -> None:
    from pv_inspect.sequence.sequence import FrameSequence

    given = {kind: folder / name for kind, name in zip(args[::2], args[1::2], strict=True)}
    _check_sequence(FrameSequence.open(folder / "frames", **given))


def _check_sequence(sequence: Any) -> None:
    assert len(set(sequence.names)) == len(sequence) >= 1
    assert np.isfinite([sequence.full_scale, sequence.black_level]).all()
    assert sequence.black_level < sequence.full_scale
    if sequence.bit_depth is None:
        assert any("computed values" in text for text in sequence.warnings)
    else:
        assert sequence.black_level >= 0
        assert 1 <= sequence.bit_depth <= 16
    assert not any(map(fault_of, sequence.warnings)), sequence.warnings
    for index in {0, len(sequence) // 2, len(sequence) - 1}:
        frame = sequence.frame(index)
        assert frame.image.shape == frame.valid.shape == sequence.shape
        assert frame.image.dtype == np.float32
        assert np.isfinite(frame.image).all()
    hint = sequence.layout_hint
    assert set(hint) <= {"rows", "cols", "cell_aspect"}
    if {"rows", "cols"} <= set(hint):
        from pv_inspect.settings import Settings

        layout = sequence.layout(Settings())
        assert (layout.rows, layout.cols) == (hint["rows"], hint["cols"])


def _plain_cell(folder: Path, args: Args) -> None:
    from pv_inspect.cracks.single_cells import image_files, read_cell

    (path,) = image_files([folder / "cells"])
    image = read_cell(path)
    assert image.ndim == 2
    assert image.dtype == np.float32
    assert np.isfinite(image).all()


def _settings(folder: Path, _: Args) -> None:
    from pv_inspect.settings import Settings

    _check_settings(Settings.from_toml(folder / "settings.toml"))


def _preset(folder: Path, args: Args) -> None:
    from napari_pv_inspect.models.presets import PresetStore

    shelf = PresetStore(folder / "presets")
    for name in shelf.names():
        _check_settings(shelf.read(name))
    name = shelf.save(args[0], _default_settings())
    assert name in shelf.names()
    assert shelf.read(name) is not None


def _default_settings() -> Any:
    from pv_inspect.settings import Settings

    return Settings()


def _check_settings(settings: Any) -> None:
    numbers = [v for v in settings.model_dump().values() if isinstance(v, float)]
    assert np.isfinite(numbers).all()
    assert 1 <= settings.magnification <= 6
    assert settings.rows is None or 1 <= settings.rows <= 200
    settings.to_toml()


def _camera(folder: Path, args: Args) -> None:
    from pv_inspect.calibration.camera_file import read_camera

    known = read_camera(folder / args[0], (seeds.HEIGHT, seeds.WIDTH))
    assert known.K.shape == (3, 3)
    assert np.isfinite(known.K).all()
    assert known.K[0, 0] > 0
    assert known.K[1, 1] > 0
    assert known.kappa is None or np.isfinite(known.kappa)


def _result(folder: Path, _: Args) -> None:
    from pv_inspect.cracks import CrackMap
    from pv_inspect.reconstruction.reconstruction import Reconstruction
    from pv_inspect.registration.registration import Registration
    from pv_inspect.results.read import read_result
    from pv_inspect.results.resume import reopen, resume

    result = read_result(folder / "result")
    made, found, layout = result.need(Reconstruction), result.need(CrackMap), result.layout
    assert made.image.shape == made.support.shape == found.probability.shape
    assert made.image.shape == made.consistency.shape == made.grid.shape
    assert np.isfinite(result.need(Registration).camera.K).all()
    assert np.isfinite([found.threshold, made.grid.pixels_per_unit]).all()
    assert made.grid.pixels_per_unit > 0
    assert np.isfinite(made.grid.origin_px).all()
    assert all((c.row, c.col) < (layout.rows, layout.cols) for c in found.cells)
    _check_settings(result.settings)
    repr(result)
    inspection = resume(result, reopen(result))
    assert len(inspection.need(Registration).used) == len(inspection.frames)
    assert inspection.tiles is not None
    assert len(inspection.tiles.places) == layout.rows * layout.cols


def _session(folder: Path, _: Args) -> None:
    from pv_inspect.results.session import read_session

    session = read_session(folder)
    assert session.frame >= 0
    numbers = [*(session.cell or ()), *(session.centre or ()), session.zoom or 1.0]
    assert np.isfinite(np.array(numbers, np.float64)).all()


def _trials(folder: Path, _: Args) -> None:
    from pv_inspect.results.trials import read_trials

    for trial in read_trials(folder):
        assert np.isfinite(trial.image).all()
        _check_settings(trial.settings)


def _review(folder: Path, _: Args) -> None:
    from pv_inspect.review import ReviewStore, Verdict, VerdictKind
    from pv_inspect.review.tables import agreed, raters_of

    with ReviewStore(folder, busy_s=0.1) as store:
        verdicts = store.current()
        raters_of(verdicts)
        agreed(verdicts)
        for entry in store.history():
            assert min(entry.cell) >= 0
        for mask in store.masks().values():
            assert mask.ndim == 2
            assert mask.dtype == np.bool_
        for rater in ("ann", *store.raters()[:3]):
            store.waiting_notes(rater)
            store.mask((0, 1), rater)
            store.remembered(rater)
        store.module_data()
        store.remembered()
        said = Verdict(1, 1, VerdictKind.CRACK_C, "eve", note="new")
        store.give(said)
        assert said in store.current(), "said to be stored, and is not"


def _model(folder: Path, _: Args) -> None:
    from pv_inspect.cracks.network import NetworkDetector

    detector = NetworkDetector(folder / "model.onnx")
    tile = seeds.picture(1, 1.0, np.float32)[:48, :32]
    probability = detector.probability(tile)
    assert probability.shape == tile.shape
    assert np.isfinite(probability).all()
    assert 0 <= probability.min() <= probability.max() <= 1


def _own_model() -> dict[str, bytes]:
    network, about = seeds.model()
    return {"model.onnx": network, "model.json": about.encode()}


def _command(_: Path, args: Args) -> None:
    from typer.testing import CliRunner

    from pv_inspect.cli.app import app

    _without_the_work()
    found = CliRunner().invoke(app, list(args))
    if found.exit_code in (0, 3):
        assert not found.stderr, found.stderr
        return
    assert found.exit_code in (1, 2), f"exit code {found.exit_code}"
    assert found.stderr.startswith("pv-inspect: "), found.stderr
    assert "failed unexpectedly" not in found.stderr, found.stderr
    raise InspectionError(found.stderr.removeprefix("pv-inspect: ").removesuffix("\n"))


@cache
def _without_the_work() -> None:
    """Let commands end where they have understood what they were given."""
    import typer

    from pv_inspect import pipeline, simulate

    def understood(*_: object, **__: object) -> None:
        raise typer.Exit

    pipeline.inspect_steps = understood  # type: ignore[assignment]
    simulate.simulate = understood  # type: ignore[assignment]


def _for_commands() -> dict[str, bytes]:
    return {
        **seeds.frames(),
        **seeds.result_files(),
        "cells/cell.png": seeds.pngs()[1],
        "settings.toml": seeds.settings_text().encode(),
        "camera.yaml": seeds.calibrations()[0][1].encode(),
    }


def _misbehaves(folder: Path, args: Args) -> None:
    """Do what no reader may do, to see that it is noticed."""
    how = args[0] if args else ""
    if how == "hangs":
        while True:
            pass
    if how == "waits":
        threading.Event().wait()
    if how == "crashes":
        os.kill(os.getpid(), signal.SIGSEGV)
    if how == "prints":
        os.write(2, b"libsomething warning: odd\n")
    if how == "grows":
        bytearray(b"x") * (1100 * 2**20)
    if how == "is slow":
        until = process_time() + 2.2
        while process_time() < until:
            pass
    if how == "raises":
        raise KeyError("camera")
    if how == "says much":
        raise InspectionError("This sentence has no end")


MISBEHAVIOUR = ("hangs", "waits", "crashes", "prints", "grows", "is slow", "raises", "says much")

READERS: dict[str, Kind] = {
    "misbehaves": Kind(_misbehaves),
    "frames": Kind(_frames, seeds.frames),
    "references": Kind(
        _references,
        lambda: {
            **seeds.frames(),
            "dark.tif": seeds.flat_picture(60),
            "flat.tif": seeds.flat_picture(40000),
        },
        ("dark_frame", "dark.tif", "flat_frame", "flat.tif"),
    ),
    "plain cell": Kind(_plain_cell, lambda: {"cells/cell.png": seeds.pngs()[1]}),
    "settings": Kind(_settings, lambda: {"settings.toml": seeds.settings_text().encode()}),
    "preset": Kind(
        _preset, lambda: {"presets/usual.toml": b"magnification = 3.0\nprior = 'btv'\n"}, ("mine",)
    ),
    "camera": Kind(
        _camera,
        lambda: {name: text.encode() for name, text in seeds.calibrations()},
        ("camera.yaml",),
    ),
    "result": Kind(_result, seeds.result_files),
    "session": Kind(_session, lambda: {"session.json": seeds.SESSION.encode()}),
    "trials": Kind(_trials, lambda: {"trials.npz": seeds.kept_trials()}),
    "review": Kind(_review, lambda: {"review.sqlite": seeds.stored_review()}),
    "model": Kind(_model, _own_model),
    "command": Kind(_command, _for_commands, ("review", "result", "--quiet")),
}


def matching(network: bytes, about: str) -> bytes:
    """Description of a network with the hash of these bytes."""
    described = json.loads(about)
    described["sha256"] = hashlib.sha256(network).hexdigest()
    return json.dumps(described).encode()
