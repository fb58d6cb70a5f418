"""Studies drafted from a look at columns, for the tests of what is seen in them and of the command."""

from pathlib import Path

import numpy as np
from logs import smooth, write

from odescope.study.draft import draft
from odescope.study.toml import parse_study

T = 0.01 * np.arange(1500)


def drafted(columns, name="log.csv"):
    write(name, {label: np.asarray(values, dtype=float) for label, values in columns.items()})
    found = draft([Path(name)], [Path(name)], Path())
    return parse_study(found.text), found.text


def motion(seed, size=1.0):
    return smooth(np.random.default_rng(seed), len(T), 0.01, 1.5, size)
