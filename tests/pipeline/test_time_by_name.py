"""The time as a variable of a library: a forcing of unknown frequency and phase, from the record to a free run."""

import csv

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from odescope import InputError, simulate
from odescope.commands.free_run import free_runs
from odescope.export.model_file import from_json, to_json
from odescope.pipeline.identification import identify
from odescope.study.clock import with_time
from odescope.study.library_options import Candidates
from odescope.study.options import Data, Driven, Measured, Study

RATE, PHASE, SIZE = 1.37, 0.6, 1.5
BASIS = ("x", "x_dot", "sin(w*t)", "cos(w*t)")


def forced(begin, seed, count=1500):
    """Return a log of x'' = 1.5 sin(1.37 t + 0.6) - 4 x - 0.3 x' whose stamps begin at some time."""
    t = begin + 0.02 * np.arange(count)

    def rate(now, x):
        return x[1], SIZE * np.sin(RATE * now + PHASE) - 4.0 * x[0] - 0.3 * x[1]

    x = solve_ivp(rate, (t[0], t[-1]), (0.5, 0.0), t_eval=t, rtol=1e-9, atol=1e-11).y[0]
    return {"seconds": t, "x": x + 0.01 * x.std() * np.random.default_rng(seed).standard_normal(count)}


def study(basis=BASIS, inputs=None, **data):
    return Study(
        data=Data(**(data or {"time": "seconds"})),
        coordinates={"x": Measured(order=2)},
        inputs=inputs or {},
        library=Candidates(basis=basis, degree=2, parameters={"w": (0.5, 5.0)}),
    )


@pytest.fixture(scope="module")
def found():
    return identify(study(), [forced(0.0, 1), forced(7.3, 2)])


@pytest.mark.slow
def test_frequency_and_phase_of_a_forcing_are_found_in_recordings_that_begin_at_different_times(found):
    model = found.model
    (rate,) = model.parameters
    assert abs(rate.value - RATE) < 4.0 * rate.std_error
    written = dict(zip(rate.terms, rate.written, strict=True))
    terms = {written.get(t.text, t.text): t for t in model.relations[0].terms}
    assert set(terms) == {"x_ddot", "x", "x_dot", "sin(t*w)", "cos(t*w)"}
    for name, value in {"sin(t*w)": SIZE * np.cos(PHASE), "cos(t*w)": SIZE * np.sin(PHASE)}.items():
        assert abs(terms[name].coefficient + value) < 4.0 * terms[name].std_error


@pytest.mark.slow
def test_the_time_is_an_input_of_the_model_that_runs_take_from_the_column_of_time(found, tmp_path):
    model = from_json(to_json(found.model))
    assert [(i.name, i.delay, i.hold) for i in model.inputs] == [("t", 0.0, "linear")]
    log = forced(20.0, 3)
    run = simulate(model, log["seconds"], log["seconds"][:, None], np.array([0.5, 0.0]))
    assert np.sqrt(np.mean((run.states[:, 0] - log["x"]) ** 2)) < 0.02 * log["x"].std()
    rows = rows_of(found, tmp_path, log)
    assert np.abs(rows[:, 1] - run.states[:, 0]).max() < 1e-6


def rows_of(found, folder, log, time=None):
    """Return the rows of a free run over a log from (0.5, 0), by the command."""
    (folder / "model.json").write_text(to_json(found.model), encoding="utf-8")
    with (folder / "log.csv").open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(log)
        writer.writerows(zip(*log.values(), strict=True))
    told = free_runs(folder / "model.json", folder / "log.csv", time, None, None, ["x=0.5", "x_dot=0.0"])
    return np.array([line.split(",") for line in told.text.splitlines()[1:]], dtype=float)


@pytest.mark.parametrize(("heading", "time"), [("stamp", "stamp"), ("time", None)])
def test_in_a_log_with_another_column_of_time_the_time_is_that(found, tmp_path, heading, time):
    log = forced(20.0, 3)
    expected = rows_of(found, tmp_path, log)
    np.testing.assert_array_equal(rows_of(found, tmp_path, {heading: log["seconds"], "x": log["x"]}, time), expected)


def test_times_in_another_unit_are_refused_where_the_model_holds_the_time(found, tmp_path):
    log = forced(20.0, 3)
    with pytest.raises(InputError, match=r"the model holds the time, t, in seconds, .* in ms"):
        rows_of(found, tmp_path, {"stamp (ms)": 1e3 * log["seconds"], "x": log["x"]}, "stamp (ms)")


def test_what_else_is_called_t_is_not_the_time():
    assert with_time(study()).inputs["t"].column == "seconds"
    own = study(inputs={"t": Driven(column="temperature")})
    assert with_time(own) is own
    plain = study(("x", "x_dot", "tanh(x_dot/w)"))
    assert with_time(plain) is plain


def test_the_time_without_a_column_is_refused():
    with pytest.raises(InputError, match="names the time, t: name the column"):
        identify(study(sample_period=0.02), {"x": forced(0.0, 1)["x"]})
