"""``python -m pv_inspect`` is the command ``pv-inspect``."""

from __future__ import annotations

from pv_inspect.cli import main

if __name__ == "__main__":
    main()
