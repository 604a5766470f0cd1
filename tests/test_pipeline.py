from __future__ import annotations

from collections.abc import Generator
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from pv_inspect import pipeline
from pv_inspect.cells import cut_cells
from pv_inspect.common.work import Progress, result_of
from pv_inspect.detection.layout_guess import LayoutGuess
from pv_inspect.errors import InspectionError
from pv_inspect.inspection.inspection import Inspection, Step
from pv_inspect.pipeline import inspect, inspect_steps
from pv_inspect.settings import Settings, Stage
from tests.handmade import (
    REASON,
    FakeSequence,
    made_calibration,
    made_crossings,
    made_inspection,
    made_reconstruction,
    made_registration,
)

SEQUENCE: Any = FakeSequence()


class Stages:
    """Fakes of the stages; remembers which ran and which were closed early."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.ran: list[str] = []
        self.closed: list[str] = []
        self.crossings: Any = made_crossings()
        self.registration: Any = made_registration()
        self.reconstruction: Any = made_reconstruction()
        for name in ("detect", "calibrate", "register", "reconstruct", "cut_cells", "read_cracks"):
            monkeypatch.setattr(pipeline, name, getattr(self, name))
        self.misfit = ""
        monkeypatch.setattr(pipeline, "need_memory", lambda *_: None)
        monkeypatch.setattr(pipeline, "check_plane", lambda *_: self.misfit)
        monkeypatch.setattr(FakeSequence, "frame", lambda *_: SEQUENCE, raising=False)
        monkeypatch.setattr(FakeSequence, "image", None, raising=False)
        monkeypatch.setattr(pipeline, "register_by_homography", self.register_by_homography)

    def fractions(self, name: str, result: Any) -> Generator[Any, None, Any]:
        self.ran.append(name)
        try:
            yield Progress(0.5, name)
            yield Progress(1.0, name)
        except GeneratorExit:
            self.closed.append(name)
            raise
        return result

    def detect(self, *_: Any) -> Generator[Progress, None, Any]:
        return self.fractions("detect", self.crossings)

    def calibrate(self, *_: Any) -> Any:
        self.ran.append("calibrate")
        return made_calibration(len(self.crossings.frames))

    def register(self, _: Any, __: Any, settings: Settings) -> Generator[Progress, None, Any]:
        self.registered_with = settings
        return self.fractions("register", self.registration)

    def register_by_homography(self, _: Any, crossings: Any, *__: Any) -> Any:
        assert crossings is self.crossings
        return self.fractions("by homography", self.registration)

    def reconstruct(self, *_: Any) -> Generator[Progress, None, Any]:
        self.ran.append("reconstruct")
        image = np.zeros((2, 2), np.float32)
        try:
            yield Progress(0.5, "iteration 3 of 60", image)
        except GeneratorExit:
            self.closed.append("reconstruct")
            raise
        return self.reconstruction

    def cut_cells(self, reconstruction: Any) -> Any:
        self.ran.append("cells")
        return cut_cells(reconstruction)

    def read_cracks(self, *_: Any) -> Generator[Progress, None, Any]:
        return self.fractions("cracks", made_inspection().cracks)


@pytest.fixture
def stages(monkeypatch: pytest.MonkeyPatch) -> Stages:
    return Stages(monkeypatch)


ALL = ["detect", "calibrate", "register", "reconstruct", "cells", "cracks"]


def test_a_run_passes_all_stages_and_is_complete(stages: Stages) -> None:
    steps = list(inspect_steps(SEQUENCE))
    assert stages.ran == ALL
    parts = {s.stage: s.partial for s in steps if s.fraction and s.partial is not None}
    assert [type(p).__name__ for p in parts.values()] == [
        "Crossings",
        "Calibration",
        "Registration",
        "Reconstruction",
        "CellTiles",
        "CrackMap",
    ]
    assert inspect(SEQUENCE).complete


def test_a_layout_that_does_not_fit_the_registered_frames_is_a_doubt(stages: Stages) -> None:
    stages.misfit = "The layout does not fit."
    assert inspect(SEQUENCE).doubts[:1] == ("The layout does not fit.",)
    # Without a lens the lines are bent in any case.
    assert inspect(SEQUENCE, Settings(registration_model="homography")).doubts == ()


def test_the_fraction_never_falls_and_ends_at_one(stages: Stages) -> None:
    fractions = [step.fraction for step in inspect_steps(SEQUENCE)]
    assert fractions[0] == 0.0
    assert fractions == sorted(fractions)
    assert fractions[-1] == pytest.approx(1.0)


def test_previews_of_the_reconstruction_come_through(stages: Stages) -> None:
    previews = [s for s in inspect_steps(SEQUENCE) if isinstance(s.partial, np.ndarray)]
    assert [(s.stage, s.message) for s in previews] == [(Stage.RECONSTRUCT, "iteration 3 of 60")]


def test_seconds_leave_out_the_time_in_which_the_caller_holds_the_generator(
    stages: Stages, monkeypatch: pytest.MonkeyPatch
) -> None:
    now = [0.0]

    def clock() -> float:
        now[0] += 1.0
        return now[0]

    def hold(_: object) -> None:
        now[0] += 1000.0

    monkeypatch.setattr("pv_inspect.pipeline.perf_counter", clock)
    seconds = result_of(inspect_steps(SEQUENCE), hold).seconds
    assert set(seconds) == {stage.value for stage in Stage}
    # Every stage took some looks at the clock and no stage one of the pauses.
    assert all(0 < spent < 100 for spent in seconds.values())


@pytest.mark.parametrize(
    ("change", "again"),
    [
        ({"prior_weight": 0.2}, ["reconstruct", "cells", "cracks"]),
        ({"crack_threshold": 0.3}, ["cracks"]),
        ({"kappa": -0.1}, ALL[1:]),
        ({}, []),
    ],
)
def test_only_what_a_changed_setting_makes_stale_runs_again(
    stages: Stages, change: dict[str, Any], again: list[str]
) -> None:
    first = inspect(SEQUENCE)
    stages.ran.clear()
    settings = Settings.create(**change)
    assert [s.value for s in Stage if s in first.stale(settings)] == again
    steps = inspect_steps(SEQUENCE, settings, first)
    fractions = [step.fraction for step in steps]
    second = inspect(SEQUENCE, settings, first)
    assert stages.ran == again * 2
    assert second.settings == settings
    assert second.complete
    assert fractions[-1] == pytest.approx(1.0) or not again
    assert set(second.seconds) == {stage.value for stage in Stage}


def test_the_ablation_replaces_the_registration_and_nothing_else(stages: Stages) -> None:
    first = inspect(SEQUENCE)
    stages.ran.clear()
    second = inspect(SEQUENCE, Settings(registration_model="homography"), first)
    assert stages.ran == ["by homography", *ALL[3:]]
    assert second.complete


def test_another_sequence_starts_afresh(stages: Stages) -> None:
    first = inspect(SEQUENCE)
    stages.ran.clear()
    inspect(FakeSequence(), start=first)  # type: ignore[arg-type]
    assert stages.ran == ALL


def test_what_a_cancelled_run_has_made_can_be_built_upon(stages: Stages) -> None:
    kept = Inspection(SEQUENCE, Settings(), SEQUENCE.layout(Settings()))
    steps = inspect_steps(SEQUENCE)
    for step in steps:
        if step.partial is not None:
            kept = kept.with_part(step.partial)  # type: ignore[arg-type]
        if step.stage is Stage.REGISTER and step.partial is not None:
            break
    steps.close()
    stages.ran.clear()
    assert inspect(SEQUENCE, start=kept).complete
    assert stages.ran == ["reconstruct", "cells", "cracks"]


def test_a_moved_crossing_point_makes_everything_after_the_detection_run_again(
    stages: Stages,
) -> None:
    moved = inspect(SEQUENCE).with_part(made_crossings())
    assert moved.registration is None
    assert moved.cracks is None
    stages.ran.clear()
    inspect(SEQUENCE, start=moved)
    assert stages.ran == ALL[1:]


@pytest.mark.parametrize("stage", ["detect", "register", "reconstruct", "cracks"])
def test_closing_the_run_closes_the_stage_at_work(stages: Stages, stage: str) -> None:
    steps = inspect_steps(SEQUENCE)
    for step in steps:
        if step.stage == stage and stage in stages.ran:
            break
    steps.close()
    assert stages.closed == [stage]


def test_rejected_frames_are_named_with_their_reason(stages: Stages) -> None:
    result = inspect(SEQUENCE)
    assert result.warnings[1:] == (f"frame_1 & <i>.tif is not used: {REASON}.",)


def test_frames_that_stand_still_are_called_no_super_resolution(stages: Stages) -> None:
    still = inspect(SEQUENCE).warnings[0]
    assert still.startswith("The 2 frames show the module in the same place: ")
    assert "not a super-resolution" in still
    two = made_registration()
    two.homographies[2, :2, 2] += 0.005  # half a pixel
    stages.registration = two
    few = inspect(SEQUENCE).warnings[0]
    assert few.startswith("The 2 frames stand in too few different places between the pixels: ")
    many = made_registration(30)
    many.homographies[:, :2, 2] += np.random.default_rng(0).uniform(0, 0.02, (30, 2))
    stages.crossings, stages.registration = made_crossings(30), many
    names = tuple(f"{k}.tif" for k in range(30))
    result = inspect(FakeSequence(names))  # type: ignore[arg-type]
    assert [text[:20] for text in result.warnings] == ["1.tif is not used: n"]


def test_frames_that_do_not_fit_together_put_the_result_in_doubt(stages: Stages) -> None:
    stages.reconstruction = replace(made_reconstruction(), residual_rms=(6.0, float("nan"), 8.0))
    told = inspect(SEQUENCE).doubts
    assert "contradict the module image by 7.0 times their noise" in told[0]


def test_one_frame_works_and_is_called_no_super_resolution(stages: Stages) -> None:
    stages.crossings, stages.registration = made_crossings(1), made_registration(1)
    result = inspect(FakeSequence(("one.tif",)))  # type: ignore[arg-type]
    assert result.warnings == (
        "1 frame: the result is a rectified single frame, not a super-resolution. Narrow or faint "
        "cracks that more frames would show may be missing.",
    )


def test_no_usable_frame_is_one_sentence(stages: Stages) -> None:
    frames = tuple(replace(f, why="too dark.") for f in made_crossings().frames)
    stages.crossings = replace(made_crossings(), frames=frames)
    with pytest.raises(InspectionError, match=r"any of the 3 frames \(frame_0.tif: too dark\)"):
        inspect(SEQUENCE)
    assert stages.ran == ["detect"]


def test_steps_are_events_that_can_not_be_changed() -> None:
    with pytest.raises(AttributeError):
        Step(Stage.LOAD, 0.0, "").fraction = 1.0  # type: ignore[misc]


def test_an_unknown_layout_is_guessed_once_and_the_result_says_so(
    stages: Stages, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[Settings] = []

    def guess(sequence: Any, settings: Settings, inside: Any) -> LayoutGuess:
        asked.append(settings)
        return LayoutGuess(made_crossings().layout, 0.9, ())

    monkeypatch.setattr(pipeline, "guess_layout", guess)
    sequence: Any = FakeSequence(layout_hint={})
    inspection = inspect(sequence)
    assert inspection.layout_guessed
    # After that its two frames, which stand in one place, are no super-resolution.
    assert "2 x 3 cells of aspect 1 guessed, please confirm" in inspection.warnings[1]
    again = inspect(sequence, Settings(crack_threshold=0.7), inspection)
    assert again.layout == inspection.layout
    assert again.layout_guessed
    assert len(asked) == 1
    given = inspect(sequence, Settings(rows=2, cols=3), inspection)
    assert not given.layout_guessed
    assert not any("guessed" in warning for warning in given.warnings)
