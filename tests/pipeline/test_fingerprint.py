"""Objects that do the same have one fingerprint in every run; what may do something else has another."""

from __future__ import annotations

import functools
import os
import subprocess
import sys
import threading
from dataclasses import dataclass

import msgspec
import numpy as np
import pytest

from odescope import FixedCutoff, LeastRisk, SavitzkyGolay, Spectral
from odescope.errors import InputError
from odescope.pipeline.fingerprint import fingerprint
from odescope.recordings.coordinate import Coordinate, Input


class Plain:
    def __init__(self, width, window=None):
        self.width, self.window = width, window


class Slots:
    __slots__ = ("width",)

    def __init__(self, width):
        self.width = width


@dataclass(frozen=True)
class Frozen:
    width: float


class Struct(msgspec.Struct, frozen=True):
    width: float


def scaled(values, by=2.0):
    return by * values


def closing_over(by):
    return lambda values: by * values


DIFFERENT = [
    *(kind(width) for kind in (Plain, Slots, Frozen, Struct) for width in (1.0, 2.0, 1, True, "1.0", None)),
    *(Plain(1.0, window) for window in (np.ones(3), np.ones((1, 3)), np.ones(3, np.float32), np.zeros(3))),
    *(Plain(1.0, window) for window in ([1, 2], (1, 2), {1, 2}, {1: 2}, {2: 1}, {"1": 2}, Plain(2.0), Plain)),
    *(Plain(1.0, function) for function in (scaled, closing_over(1.0), closing_over(2.0), np.sin, np.cos)),
    *(Plain(1.0, functools.partial(scaled, by=by)) for by in (2.0, 3.0)),
    *(Plain(1.0, window) for window in (np.float64(1.0), np.array([1, "a"], object), np.array([2, "a"], object))),
    *(Spectral(), Spectral(FixedCutoff(1.0)), Spectral(FixedCutoff(2.0)), LeastRisk(), SavitzkyGolay(11)),
    *(Coordinate("x"), Coordinate("x", 2), Coordinate("y"), Input("x"), Input("x", "zero"), Input("x", delay=0.1)),
    Plain(2.0).__init__,
    Plain(3.0).__init__,
]


def test_what_differs_is_told_apart():
    found = [fingerprint(value) for value in DIFFERENT]
    assert len(set(found)) == len(found)


def test_the_order_of_a_mapping_does_not_matter():
    names = [f"name{k}" for k in range(50)]
    assert fingerprint(dict.fromkeys(names)) == fingerprint(dict.fromkeys(reversed(names)))


OWN = """
from helper import gain

class Own:
    wanted = frozenset({"alpha", "beta", "gamma", "delta"})

    def __init__(self, width, names):
        self.width, self.names = width, names

    def derivatives(self, channel, period, order):
        return gain() if order in {1, 2, "three"} else self.width
"""
HELPER = "def gain():\n    return 1.0\n"
ASK = """
import sys
from own import Own
from odescope.pipeline.fingerprint import fingerprint

print(fingerprint(Own(float(sys.argv[1]), {"a", "b", "c"})))
"""


def asked(folder, width="1.0", own=OWN, helper=HELPER, seed="0"):
    """Return the fingerprint in a process of its own."""
    (folder / "own.py").write_text(own)
    (folder / "helper.py").write_text(helper)
    path = os.pathsep.join([str(folder), *sys.path])
    environment = {**os.environ, "PYTHONPATH": path, "PYTHONHASHSEED": seed, "PYTHONDONTWRITEBYTECODE": "1"}
    run = subprocess.run(
        [sys.executable, "-c", ASK, width], cwd=folder, env=environment, capture_output=True, text=True, check=True
    )
    return run.stdout


def test_another_run_knows_what_has_not_changed_and_sees_an_edit_of_the_source(tmp_path):
    first = asked(tmp_path)
    assert asked(tmp_path, seed="7") == first
    assert asked(tmp_path, width="2.0") != first
    assert asked(tmp_path, own=OWN.replace("else self.width", "else -self.width")) != first
    assert asked(tmp_path, helper=HELPER.replace("1.0", "2.0")) != first
    assert asked(tmp_path) == first


@pytest.mark.parametrize("state", [threading.Lock(), (k for k in range(3))])
def test_what_cannot_be_told_is_refused(state):
    with pytest.raises(InputError, match=r"cannot be compared with that of another run .*; keep its state in plain"):
        fingerprint(Plain(1.0, state))


def test_an_object_that_holds_itself_is_refused():
    own = Plain(1.0)
    own.window = {"own": [own]}
    with pytest.raises(InputError, match="holds itself"):
        fingerprint(own)
