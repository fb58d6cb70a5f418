"""How long the workbench takes to open a log of ten million rows, and to draw what is moved or zoomed to.

    ./run python bench/workbench.py

Opened as a page opens it, each file by a process of its own: read whole, all columns. Times of the processor count all
threads; those of the clock depend on what else the machine does. What a browser adds per picture is the last column.
"""

from __future__ import annotations

import argparse
import os
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

WIDTHS = (1.0, 0.5, 0.1, 0.03, 0.001)  # of the log: what is looked at
PIXELS = 1200


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rows", type=int, default=10_000_000)
    parser.add_argument("--open", type=Path, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.open is not None:
        measured(options.open)
        return
    with tempfile.TemporaryDirectory() as folder:
        print("file                size  open: clock  processor   window: worst clock  bytes sent")
        for path in written(Path(folder), options.rows):
            command = [sys.executable, __file__, "--open", str(path)]
            print(subprocess.run(command, check=True, capture_output=True, text=True).stdout, end="")


def written(folder: Path, rows: int) -> list[Path]:
    """Write the same log as Parquet and as CSV."""
    import pyarrow as pa
    from pyarrow import csv, parquet

    t = np.arange(rows) * 1e-3
    rng = np.random.default_rng(0)
    x = np.sin(t) + 0.01 * rng.standard_normal(rows)
    table = pa.table({"t": t, "x": np.round(x, 5), "u": np.round(np.cos(0.3 * t), 5)})
    parquet.write_table(table, folder / "log.parquet")
    csv.write_csv(table.set_column(0, "t", pa.array(np.round(t, 3))), folder / "log.csv")
    return [folder / "log.parquet", folder / "log.csv"]


def measured(path: Path) -> None:
    """Open one file, look at windows of it, and print how long that took."""
    from odescope.workbench import charts
    from odescope.workbench.log_file import open_log

    with tempfile.TemporaryDirectory() as folder:
        for small in written(Path(folder), 100):  # a server that has shown a log has loaded what reads them
            open_log(small)
    clock, processor = time.perf_counter(), sum(os.times()[:2])
    log = open_log(path)
    opened, used = time.perf_counter() - clock, sum(os.times()[:2]) - processor
    worst, size = 0.0, 0
    for width in WIDTHS:
        taken = []
        for begin in np.linspace(0.0, 1.0 - width, 5):
            clock, size = time.perf_counter(), 0
            for line in log.lines.values():
                low, high = line.span
                ends = (low + part * (high - low) for part in (begin, begin + width))
                size += len(str(charts.points(*line.window(*ends, PIXELS))))
            taken.append(time.perf_counter() - clock)
        worst = max(worst, statistics.median(taken))
    print(
        f"{path.name:<14} {path.stat().st_size / 1e6:6.0f} MB {opened:10.2f} s {used:9.2f} s"
        f" {1e3 * worst:18.0f} ms {size / 1e3:9.0f} kB"
    )


if __name__ == "__main__":
    main()
