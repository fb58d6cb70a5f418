"""How far lines over gaps are off, beside closed forms."""

import tracemalloc

import numpy as np
import pytest

from odescope.recordings.bridges import bridged
from odescope.recordings.record import Record, Records

T = 0.01 * np.arange(4000)


def lacking(values, *gaps):
    counts = np.ones((len(values), 1))
    for first, stop in gaps:
        counts[first:stop] = 0.0
    return Record(T[: len(values)], values[:, None], ("u",), counts=counts)


def test_the_error_of_a_line_is_that_of_a_parabola_between_its_ends():
    gap, frequency = 10, 2.0 * np.pi * 0.5
    longest, off = bridged(Records((lacking(np.sin(frequency * T), (500, 503), (1000, 1000 + gap)),)), "u")
    part = np.arange(1, gap + 1) / (gap + 1)
    # times u, whose second derivative it has
    parabola = 0.5 * (frequency * (gap + 1) * 0.01) ** 2 * part * (1.0 - part)
    assert longest == gap
    assert off == pytest.approx(np.sqrt(np.mean(parabola**2)), rel=0.01)


def test_a_line_is_bridged_without_error_and_a_whole_record_has_no_gap():
    assert bridged(Records((lacking(3.0 * T, (100, 130)),)), "u") == (30, pytest.approx(0.0, abs=1e-12))
    assert bridged(Records((lacking(np.sin(T)),)), "u") == (0, 0.0)
    assert bridged(Records((lacking(np.sin(T[:60]), (10, 50)),)), "u") == (40, 0.0)  # nothing is long enough to tell


def test_the_longest_gap_of_all_records_counts():
    noise = np.random.default_rng(0).standard_normal(4000)
    longest, off = bridged(Records((lacking(noise, (7, 9)), lacking(noise, (40, 43)))), "u")
    part = np.arange(1, 4) / 4
    assert longest == 3
    assert off == pytest.approx(np.sqrt(np.mean(1.0 + part**2 + (1.0 - part) ** 2)), rel=0.05)


def test_a_column_that_was_never_measured_is_off_by_nothing_that_could_be_told():
    assert bridged(Records((lacking(np.sin(T[:50]), (0, 50)),)), "u") == (50, 0.0)


def test_of_many_stretches_no_more_windows_are_looked_at_than_of_one():
    """A long log with a gap a second has thousands of stretches: windows of each of them would not fit in memory."""
    count, gap = 200_000, 20
    counts = np.ones((count, 1))
    for k in range(100, count, 100):
        counts[k : k + gap] = 0.0
    noise = np.random.default_rng(1).standard_normal((count, 1))
    records = Records((Record(0.01 * np.arange(count), noise, ("u",), counts=counts),))
    tracemalloc.start()
    longest, off = bridged(records, "u")
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    part = np.arange(1, gap + 1) / (gap + 1)
    assert longest == gap
    assert off == pytest.approx(np.sqrt(np.mean(1.0 + part**2 + (1.0 - part) ** 2)), rel=0.05)
    assert peak < 3 * noise.nbytes


def test_a_command_that_holds_its_value_over_a_gap_is_known():
    steps = np.repeat(np.arange(40.0) % 7.0, 100)
    assert bridged(Records((lacking(steps, (110, 150)),)), "u") == (0, 0.0)
    longest, off = bridged(Records((lacking(steps, (110, 150), (195, 205)),)), "u")
    assert longest == 10
    assert off > 0.0
