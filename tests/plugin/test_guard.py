"""Whatever goes wrong in the background becomes one sentence."""

from __future__ import annotations

import logging

import pytest

from napari_pv_inspect.tasks.guard import attempt
from pv_inspect.errors import InspectionError


def test_what_the_work_returns_comes_back() -> None:
    assert attempt(lambda: 7, "It was not counted") == 7


def test_an_inspection_error_comes_back_as_it_is_and_is_not_logged(
    caplog: pytest.LogCaptureFixture,
) -> None:
    error = InspectionError("The folder is empty: choose another one.")

    def work() -> None:
        raise error

    assert attempt(work, "It was not read") is error
    assert not caplog.records


def test_any_other_error_becomes_a_sentence_and_its_traceback_is_logged(
    caplog: pytest.LogCaptureFixture,
) -> None:
    def work() -> None:
        raise RuntimeError("no such lens")

    with caplog.at_level(logging.ERROR):
        failure = attempt(work, "It was not fitted")
    assert isinstance(failure, InspectionError)
    assert str(failure) == "It was not fitted (RuntimeError: no such lens)."
    assert caplog.records[0].exc_info is not None


def test_a_request_to_stop_the_program_is_no_failure() -> None:
    def work() -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        attempt(work, "It was not fitted")
