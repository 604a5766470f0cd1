"""Latencies of the workbench, measured on the real window; one part per file workbench_PART.py.

    xvfb-run -a -s "-screen 0 1600x1000x24" env QT_QPA_PLATFORM=xcb LIBGL_ALWAYS_SOFTWARE=1 \
        python benchmarks/workbench.py [geometry]

Without a name all latencies are measured, each part in a process of its own. Median and 95th
percentile in milliseconds; the machine should have nothing else to do.
"""

from __future__ import annotations

import subprocess
import sys
from importlib import import_module
from pathlib import Path

LATENCIES = ("geometry", "tuning", "review")


def main(arguments: list[str]) -> None:
    """Run one part with the rest of the arguments: its own ``main`` reads them."""
    names = [p.stem.removeprefix("workbench_") for p in Path(__file__).parent.glob("workbench_*")]
    parts = sorted(set(names) - {"window"})
    if not arguments:
        for part in LATENCIES:
            print(f"\n{part}", flush=True)
            subprocess.run([sys.executable, __file__, part], check=True)
        return
    if arguments[0] not in parts:
        sys.exit(f"usage: workbench.py {{{','.join(parts)}}} ...\n\n{__doc__}")
    import_module(f"workbench_{arguments[0]}").main(arguments[1:])


if __name__ == "__main__":
    main(sys.argv[1:])
