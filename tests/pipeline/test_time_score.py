"""What a result says of the time of recordings."""

import numpy as np
import pytest

from odescope import Data, Driven, Measured, Study, identify
from odescope.model.notes import notes_of
from odescope.model.scores import ModelScores
from odescope.pipeline.evaluation import time_score
from odescope.recordings.coordinate import Coordinate, Input
from odescope.recordings.layout import Layout
from odescope.recordings.periods import at_one_period
from odescope.recordings.readers import records_from
from odescope.recordings.record import Record, Records

T = 0.01 * np.arange(2000)


@pytest.mark.parametrize(("hold", "told"), [("linear", True), ("zero", False)])
def test_a_gap_of_an_input_is_told_where_coordinates_lack_nothing_unless_it_was_held(hold, told):
    counts = np.ones((len(T), 2))
    counts[500:520, 1] = 0.0
    run = Record(T, np.column_stack([np.sin(T), np.sin(7.0 * T)]), ("x", "u"), counts=counts)
    found = time_score(Records((run,)), [Coordinate("x")], [Input("u", hold=hold)])
    assert (found is not None) is told
    if told:
        longest, off = found.bridged["u"]
        assert longest == 20
        assert off > 0.01
        assert found.missing == {}


def test_a_recording_on_the_grid_of_a_faster_one_lacks_nothing():
    fast = {"t": T, "x": np.sin(T), "u": np.cos(T)}
    slow = {name: column[::2] for name, column in fast.items()}
    layout = Layout(time="t", columns=(("x", "x"), ("u", "u")), inputs=frozenset("u"))
    records = at_one_period(records_from([fast, slow], layout), layout)
    assert [len(run) for run in records] == [2000, 1999]
    assert time_score(records, [Coordinate("x")], [Input("u", hold="zero")]) is None
    slow["x"] = np.where(np.arange(1000) == 500, np.nan, slow["x"])
    records = at_one_period(records_from([fast, slow], layout), layout)
    found = time_score(records, [Coordinate("x")], [Input("u", hold="zero")])
    assert (found.missing, found.rows, found.samples) == ({"x": (1, 1)}, 3000, 3000)


def test_how_far_samples_are_off_even_times_is_counted_once():
    layout = Layout(time="t", columns=(("x", "x"),))
    off = 0.01 * np.random.default_rng(3).uniform(-0.2, 0.2, len(T))
    taken, read = ({"t": T + off, "x": np.sin(20.0 * t)} for t in (T + off, T))
    sampling, clock = (time_score(records_from([log], layout), [Coordinate("x")], []) for log in (taken, read))
    assert (sampling.jitter, clock.scatter) == (0.0, 0.0)
    assert sampling.scatter == pytest.approx(np.std(off) / 0.01, rel=0.02)
    assert clock.jitter == pytest.approx(np.std(off) / 0.01, rel=0.02)


def test_rows_behind_a_long_gap_that_are_too_few_for_a_recording_are_counted():
    """A batch that is sampled ever more rarely: its last rows are in no record, and no range of the model is theirs."""
    layout = Layout(time="t", columns=(("x", "x"),))
    t = np.r_[T[:200], T[-1], 2.0 * T[-1]]
    logs = [{"t": t, "x": np.exp(-t)}, {"t": T, "x": np.exp(-T)}]
    records = records_from(logs, layout)
    assert [len(run) for run in records] == [200, 2000]
    found = time_score(records, [Coordinate("x")], [])
    assert (found.short, found.cut) == (2, 0)
    (note,) = notes_of(ModelScores(time=found), (), None)
    assert note == ("2 rows were left out, beside gaps at which recordings are cut, in pieces of fewer than 16 samples")
    logs[0] = {name: column[:200] for name, column in logs[0].items()}
    assert time_score(records_from(logs, layout), [Coordinate("x")], []) is None


def test_a_gap_that_is_too_long_is_told_from_one_in_which_an_input_moved():
    layout = Layout(time="t", columns=(("x", "x"), ("u", "u")), inputs=frozenset("u"))
    log = {"t": T, "x": np.exp(-T), "u": np.sin(20.0 * T)}
    cut = [np.delete(column, np.r_[900:1000, 1500:1520]) for column in log.values()]
    records = records_from(dict(zip(log, cut, strict=True)), layout)
    found = time_score(records, [Coordinate("x")], [], split=False)
    assert (found.cut, found.unseen, found.split) == (2, 1, False)
    assert time_score(records, [Coordinate("x")], [], split=True).split


def test_what_an_input_did_in_its_gaps_is_told_of_those_that_the_equations_hold():
    rng = np.random.default_rng(1)
    drive, aux = np.cumsum(rng.standard_normal((2, len(T))), axis=1)
    x = np.zeros(len(T))
    for k in range(len(T) - 1):  # x' = u - x, u in lines
        x[k + 1] = x[k] * np.exp(-0.01) + 0.005 * (drive[k] + drive[k + 1])
    log = {"t": T, "x": x + 1e-3 * rng.standard_normal(len(T)), "u": drive, "aux": aux}
    for name in ("u", "aux"):
        log[name] = np.where(np.arange(len(T)) % 500 == 250, np.nan, log[name])
    study = Study(data=Data(time="t"), coordinates={"x": Measured()}, inputs={"u": Driven(), "aux": Driven()})
    model = identify(study, log).model
    assert "aux" not in model.held
    assert set(model.scores.time.bridged) == {"u"}
