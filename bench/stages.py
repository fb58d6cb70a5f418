"""Time of each stage of the demo, warm, and of whole commands, as medians.

    ./run python bench/stages.py --repeats 7

The stages are timed in this process after one warming run; the demo is timed as a process of its own: what a user
waits for on the second run.
"""

from __future__ import annotations

import argparse
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from odescope import identify, read_study
from odescope.commands.demo import write_demo


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--repeats", type=int, default=7)
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        study = read_study(write_demo(Path(folder), 0, 1, 0.01))
        data = study.layout()
        from odescope.recordings.readers import read_records

        records = read_records([Path(folder) / "log.csv"], data)
        identify(study, records)
        runs = [identify(study, records).seconds for _ in range(options.repeats)]
        print("stage        seconds (median of", options.repeats, "warm runs)")
        for stage in runs[0]:
            print(f"{stage:<12} {statistics.median(r[stage] for r in runs):.3f}")
        whole = statistics.median(sum(r.values()) - r["records"] for r in runs)
        print(f"{'together':<12} {whole:.3f}   from signals to the symbolic model")
        for command in (["--help"], ["demo", "--out", str(Path(folder) / "demo")]):
            times = []
            for _ in range(max(3, options.repeats // 2) + 1):
                begin = time.perf_counter()
                subprocess.run([sys.executable, "-m", "odescope", *command], check=True, capture_output=True)
                times.append(time.perf_counter() - begin)
            print(f"odescope {command[0]:<8} {statistics.median(times[1:]):.2f} s a process (first {times[0]:.2f} s)")


if __name__ == "__main__":
    main()
