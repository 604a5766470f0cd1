"""``python -m pv_inspect`` is the command ``pv-inspect``."""

from __future__ import annotations

from pv_inspect.common import starting

if starting.is_the_command():  # before the other imports: a Ctrl-C may come at once
    starting.exit_at_once()

from pv_inspect.common import signals

__all__ = ["main"]


def main() -> None:
    """Entry point of the command ``pv-inspect``."""
    signals.exit_at_once()  # before the imports, which take a second
    from pv_inspect.cli import app

    app.main()


if __name__ == "__main__":
    main()
