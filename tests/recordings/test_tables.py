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


@pytest.mark.parametrize("seed", range(4))
def test_what_is_cut_where_a_command_stepped_unseen_keeps_the_clock_of_the_whole(seed):
    rng = np.random.default_rng(seed)
    t = STEADY + 0.001 * rng.standard_normal(4000)  # that is when the samples were taken
    u = np.repeat(rng.standard_normal(1100), rng.integers(4, 7, 1100))[:4000]
    kept = np.sort(rng.permutation(4000)[:3950])
    layout = Layout(time="t", columns=(("x", "x"), ("u", "u")), inputs=frozenset({"u"}))
    table = {"t": t, "x": np.sin(2.0 * t) + 1e-5 * rng.standard_normal(4000), "u": u}
    found = tuple(records_from({name: column[kept] for name, column in table.items()}, layout))
    assert len(found) > 4
    (told,) = (run.repairs for run in found if run.repairs.rows)
    assert (told.jitter, told.scatter) == (0.0, pytest.approx(0.1, rel=0.1))
    assert told.cut == told.unseen == len(found) - 1
    for run in found:
        assert run.sample_period == pytest.approx(found[0].sample_period, rel=1e-9)
        numbers = (run.t - found[0].t[0]) / run.sample_period
        assert np.abs(numbers - np.rint(numbers)).max() < 1e-6
        assert np.abs(run.column("x") - np.sin(2.0 * run.t)).max() < 1e-4


@pytest.mark.parametrize("seed", range(4))
def test_uneven_sampling_lacks_no_rows(seed):
    """Steps of up to 1.9 periods, in some of which a command steps."""
    rng = np.random.default_rng(seed)
    t = STEADY + 0.01 * rng.uniform(-0.45, 0.45, len(STEADY))
    table = {"t": t, "x": np.sin(2.0 * t), "u": np.repeat(rng.standard_normal(500), 8)}
    layout = Layout(time="t", columns=(("x", "x"), ("u", "u")), inputs=frozenset({"u"}))
    assert len(records_from(table, layout)) == 1
