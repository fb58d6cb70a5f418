import time
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from odescope.report.downsample import DIGITS, line_of, min_max

VALUES = st.floats(-1e6, 1e6, allow_nan=False)


@st.composite
def lines(draw):
    count = draw(st.integers(1, 300))
    steps = draw(arrays(np.float64, count, elements=st.floats(1e-3, 10.0)))
    return np.cumsum(steps), draw(arrays(np.float64, count, elements=VALUES)), draw(st.integers(1, 40))


@given(lines())
def test_of_every_pixel_the_lowest_and_the_highest_point_stay_and_both_ends(line):
    x, y, pixels = line
    kept = min_max(x, y, pixels)
    assert np.all(np.diff(kept) > 0)
    assert {0, len(x) - 1} <= set(kept.tolist())
    edges = np.linspace(x[0], x[-1], pixels + 1)
    edges[-1] = np.inf
    for low, high in pairwise(edges):
        inside, left = (x >= low) & (x < high), (x[kept] >= low) & (x[kept] < high)
        if inside.any():
            assert y[inside].min() == y[kept][left].min()
            assert y[inside].max() == y[kept][left].max()
    assert len(kept) <= max(2 * pixels + 2, min(len(x), 2 * pixels))


def test_ten_million_samples_with_one_spike():
    rng = np.random.default_rng(0)
    y = rng.standard_normal(10_000_000)
    y[7_654_321] = 50.0
    x = 0.001 * np.arange(len(y))
    begin = time.process_time()
    line = line_of("y", "recorded", [x], [y], 960)
    assert time.process_time() - begin < 5.0
    assert len(line.x) <= 2 * 960 + 2
    assert max(line.y) == pytest.approx(50.0, rel=1e-4)
    assert line.x[line.y.index(max(line.y))] == pytest.approx(7654.321, abs=0.1)


def test_recordings_are_interrupted_and_numbers_are_short():
    xs = [np.arange(0.0, 1.0, 0.1), np.arange(2.0, 3.0, 0.1)]
    ys = [np.sin(x) / 3 for x in xs]
    line = line_of("y", "recorded", xs, ys, 100)
    assert line.x.count(None) == line.y.count(None) == 1
    assert line.x.index(None) == line.y.index(None) == 10
    shown = np.array([v for v in line.y if v is not None])
    assert np.abs(shown - np.concatenate(ys)).max() < 10.0**-DIGITS
    assert max(len(repr(v)) for v in shown.tolist()) <= 9


def test_a_line_of_nothing_and_a_constant_line():
    assert line_of("y", "recorded", [np.array([])], [np.array([])], 10).x == ()
    line = line_of("y", "recorded", [np.arange(5.0)], [np.zeros(5)], 10)
    assert line.y == (0.0,) * 5
    assert line_of("y", "recorded", [np.arange(3.0)], [np.full(3, 1234.5)], 10).y == (1234.5,) * 3
