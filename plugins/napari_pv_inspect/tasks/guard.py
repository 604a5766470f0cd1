"""Turns whatever goes wrong in background work into one sentence for the user."""

from __future__ import annotations

import logging
from collections.abc import Callable
from typing import TypeVar

from pv_inspect.errors import InspectionError

__all__ = ["attempt", "explained"]

T = TypeVar("T")

log = logging.getLogger(__name__)


def attempt(work: Callable[[], T], failed: str) -> T | InspectionError:
    """Return what ``work`` returns, or why it could not, whatever it raises.

    Parameters
    ----------
    work : callable
    failed : str
        What to say of an unexpected error, without a full stop: "It was not saved".
    """
    try:
        return work()
    except Exception as error:
        return explained(error, failed)


def explained(error: Exception, failed: str) -> InspectionError:
    """Return an error with a sentence for the user; one that is unexpected goes to the log.

    Parameters
    ----------
    error : Exception
        An InspectionError comes back as it is.
    failed : str
        What to say of any other, without a full stop.
    """
    if isinstance(error, InspectionError):
        return error
    log.error(failed, exc_info=error)
    return InspectionError(f"{failed} ({type(error).__name__}: {error}).")
