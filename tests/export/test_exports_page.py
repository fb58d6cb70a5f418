"""The C of docs/exports.md, compiled and run."""

import re
import subprocess
from pathlib import Path

import numpy as np
from exported_models import TIMES, driven_cart, free_run
from test_c import COMPILER, STRICT, needs_compiler

from odescope.commands.cli import EXPORTS
from odescope.export.programs.c import to_c

PAGE = (Path(__file__).parents[2] / "docs/exports.md").read_text(encoding="utf-8")
PROGRAM, CYCLE = re.findall(r"^```c\n(.*?)^```", PAGE, re.MULTILINE | re.DOTALL)


@needs_compiler
def test_the_programs_of_the_page_run(tmp_path):
    for name, text in to_c(driven_cart()).files.items():
        (tmp_path / name).write_text(text)
    (tmp_path / "main.c").write_text(PROGRAM)
    (tmp_path / "cycle.c").write_text(CYCLE)
    sources = [str(p) for p in tmp_path.glob("*.c")]
    command = [COMPILER, *STRICT, "-o", str(tmp_path / "program"), *sources, "-lm"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    told = subprocess.run([str(tmp_path / "program")], capture_output=True, text=True, check=True).stdout
    exact = free_run(driven_cart(), np.full((len(TIMES), 1), 2.0), [0.1, 0.4, 0.0, -0.2])
    assert np.allclose([float(line) for line in told.split()], exact[-1], rtol=1e-6, atol=1e-7)


def test_the_page_names_every_export():
    assert set(EXPORTS) == set(re.findall(r"`(\w+)`", "".join(re.findall(r"^\| (`.*?) \|", PAGE, re.MULTILINE)))) - {
        "to"
    }
