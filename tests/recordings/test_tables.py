"""Records of one's own making come out as files do."""

from dataclasses import replace

import numpy as np
import pytest

from odescope.errors import InputError
from odescope.recordings.layout import Layout
from odescope.recordings.readers import records_from
from odescope.recordings.record import Record, Records
from odescope.recordings.tables import on_uniform_time

LAYOUT = Layout(time="t", columns=(("x", "x"), ("phi", "phi")), angles=frozenset({"phi"}))
STEADY = 0.01 * np.arange(4000)


def recorded(t):
    phi = np.angle(np.exp(1j * (3.0 + 1.2 * np.sin(1.3 * t))))
    return {"t": t, "x": np.sin(2.0 * t), "phi": phi}


@pytest.mark.parametrize(
    "t",
    [STEADY + 0.003 * np.sin(1e2 * STEADY), np.concatenate([STEADY, 45.0 + STEADY]), STEADY],
    ids=["uneven", "gap", "even"],
)
def test_records_become_what_the_same_columns_become(t):
    table = recorded(t)
    record = Record(t, np.column_stack([table["x"], table["phi"]]), ("x", "phi"))
    own, read = on_uniform_time(Records.of(record), LAYOUT), records_from(table, LAYOUT)
    assert len(own) == len(read)
    for a, b in zip(own, read, strict=True):
        assert np.array_equal(a.t, b.t)
        assert np.array_equal(a.values, b.values)
    assert max(np.abs(np.diff(run.column("phi"))).max() for run in own) < 0.1


def test_what_is_uniform_stays_as_it_is():
    record = Record(STEADY, np.column_stack([np.sin(STEADY), np.cos(STEADY)]), ("x", "phi"), ("m", "rad"), "mine")
    (found,) = on_uniform_time(Records.of(record), LAYOUT)
    assert np.array_equal(found.values, record.values)
    assert (found.units, found.source, found.counts) == (record.units, "mine", None)


def test_gaps_are_refused_where_the_study_says_so():
    t = np.concatenate([STEADY, 45.0 + STEADY])
    record = Record(t, np.column_stack([np.sin(t), np.cos(t)]), ("x", "phi"))
    with pytest.raises(InputError, match="time has 1 gap"):
        on_uniform_time(Records.of(record), replace(LAYOUT, gaps="refuse"))
