"""The one exception that a user is meant to read."""

from __future__ import annotations

__all__ = ["InspectionError"]


class InspectionError(Exception):
    """Something in the input, the settings or the environment keeps a stage from its result.

    The text is one sentence for the user: what is wrong, what was found, what was expected,
    and what to do. The command line prints it as it is, the workbench shows it as a notice.
    """
