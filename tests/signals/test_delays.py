"""Inputs that act later than recorded: shifting, estimating, keeping the delay with the model."""

import csv

import numpy as np
import pytest

from odescope import Candidates, Data, Driven, Measured, Study, from_json, identify, simulate, to_json
from odescope.commands.free_run import free_runs
from odescope.errors import InputError
from odescope.model.model import without_delays
from odescope.recordings.coordinate import Input
from odescope.recordings.record import Record, Records, Stretch
from odescope.report.at_work import at_work
from odescope.signals.delays import Delay, delayed, estimate_delays

PERIOD = 0.01


def record(samples, u):
    return Records.of(
        Record(PERIOD * np.arange(samples), np.column_stack([np.zeros(samples), u]), ("x", "u"))
    ).stretches


def test_a_linear_input_is_interpolated():
    t = PERIOD * np.arange(200)
    (late,) = delayed(record(200, 3.0 * t - 1.0), [Input("u", delay=0.0137)], lead=0.02)
    run = late.record
    assert (late.first, late.stop, late.cut) == (0, len(run), False)
    assert run.t[0] == pytest.approx(0.02)
    np.testing.assert_allclose(run.column("u"), 3.0 * (run.t - 0.0137) - 1.0, atol=1e-12)


@pytest.mark.parametrize(("delay", "samples"), [(0.03, 3), (0.034, 4), (-0.02, -2)])
def test_a_held_input_moves_by_whole_samples(delay, samples):
    u = np.random.default_rng(1).standard_normal(100)
    (late,) = delayed(record(100, u), [Input("u", hold="zero", delay=delay)], lead=0.05)
    run = late.record
    np.testing.assert_array_equal(run.column("u"), u[5 - samples : 95 - samples])


def test_without_a_delay_nothing_changes_and_too_long_a_one_is_refused():
    records = record(50, np.arange(50.0))
    assert delayed(records, [Input("u")]) == records
    with pytest.raises(InputError, match="leaves nothing"):
        delayed(records, [Input("u", delay=0.3)], lead=0.3)
    with pytest.raises(InputError, match="seconds"):
        Input("u", delay=float("nan"))
    with pytest.raises(InputError, match="estimate"):
        Driven(delay=float("inf"))


def test_a_record_that_is_cut_keeps_what_counts_and_goes_where_nothing_does():
    whole = record(100, np.arange(100.0))[0].record
    late = [Input("u", delay=0.1)]
    (kept,) = delayed([Stretch(whole, 5, 90, begins=False)], late, lead=0.1)
    assert (kept.first, kept.stop, kept.begins) == (0, 80, False)  # the samples 10 to 89
    np.testing.assert_allclose(kept.record.column("u"), np.arange(80.0), atol=1e-9)
    assert delayed([Stretch(whole, 0, 8, ends=False), Stretch(whole, 95, 100, begins=False)], late, lead=0.1) == ()


def test_the_least_of_a_quadratic_is_found_with_its_error():
    curvature = np.array([[4e6, 1e6], [1e6, 2e6]])
    truth = {"u": 0.0312, "v": -0.0171}

    def cost(delays):
        off = np.array([delays[n] - truth[n] for n in truth])
        return float(off @ curvature @ off)

    found = estimate_delays(cost, ["u", "v"], period=0.1)
    for k, name in enumerate(truth):
        assert found[name].seconds == pytest.approx(truth[name], abs=2e-3)
        assert found[name].std_error == pytest.approx(1.0 / np.sqrt(curvature[k, k]), rel=1e-3)


def test_where_nothing_fits_there_is_no_delay_and_beside_it_the_least_is_found():
    assert estimate_delays(lambda _: np.inf, ["u"], period=0.1)["u"] == Delay(0.0, None)

    def cost(delays):  # nothing fits within a period of none at all
        return np.inf if abs(delays["u"]) < 0.1 else 1e6 * (delays["u"] - 0.23) ** 2

    assert estimate_delays(cost, ["u"], period=0.1)["u"].seconds == pytest.approx(0.23, abs=2e-3)


def late_tank(seed, delay, noise=0.002):
    """Return a first-order lag x' = -2 x + 3 u(t - delay), exactly integrated on a grid ten times finer."""
    rng = np.random.default_rng(seed)
    fine = PERIOD / 10
    t = fine * np.arange(30_000)
    tones = rng.uniform(0.2, 3.0, 6)
    phases = rng.uniform(0.0, 2.0 * np.pi, 6)

    def u(at):
        return np.sin(2.0 * np.pi * np.outer(at, tones) + phases).sum(axis=1)

    acting, x = u(t - delay), np.zeros(len(t))
    decay = np.exp(-2.0 * fine)
    for k in range(len(t) - 1):
        x[k + 1] = decay * x[k] + 1.5 * (1.0 - decay) * 0.5 * (acting[k] + acting[k + 1])
    kept = slice(None, None, 10)
    return {"t": t[kept], "x": x[kept] + noise * rng.standard_normal(len(t[kept])), "u": u(t[kept])}


STUDY = {
    "data": Data(time="t"),
    "coordinates": {"x": Measured()},
    "library": Candidates(basis=("x", "u"), degree=2),
}


@pytest.mark.parametrize("seed", [0, pytest.param(1, marks=pytest.mark.slow)])
def test_a_delay_is_estimated_and_goes_with_the_model(seed):
    data = late_tank(seed, 0.0234)
    result = identify(Study(**STUDY, inputs={"u": Driven(delay="estimate")}), data)
    found = result.model.scores.delays["u"]
    assert abs(found.delay - 0.0234) < max(4.0 * found.std_error, 2e-4)
    assert {t.term.text for t in result.model.relations[0].terms} == {"1", "x", "u"}
    assert any("acts 0.0" in note for note in result.notes)
    again = from_json(to_json(result.model))
    assert again.inputs[0].delay == result.model.inputs[0].delay


def test_a_model_without_delay_says_nothing_of_it():
    model = identify(Study(**STUDY, inputs={"u": Driven()}), late_tank(0, 0.0)).model
    assert '"delay"' not in to_json(model)


def test_free_runs_shift_the_input(tmp_path):
    data = late_tank(0, 0.05, noise=0.0005)
    model = identify(Study(**STUDY, inputs={"u": Driven(hold="linear", delay=0.05)}), data).model
    (tmp_path / "model.json").write_text(to_json(model), encoding="utf-8")
    with open(tmp_path / "log.csv", "w", newline="", encoding="utf-8") as file:
        csv.writer(file).writerows([list(data), *zip(*(v.tolist() for v in data.values()), strict=True)])
    text = free_runs(tmp_path / "model.json", tmp_path / "log.csv", "t", None, None, ["x=0"]).text
    written = np.array([[float(v) for v in row] for row in list(csv.reader(text.splitlines()))[1:]])
    acting = np.interp(data["t"] - 0.05, data["t"], data["u"])
    expected = simulate(without_delays(model), data["t"], np.ascontiguousarray(acting[:, None]), np.array([0.0]))
    np.testing.assert_allclose(written[:, 1], expected.states[:, 0], atol=1e-9)
    assert np.sqrt(np.mean((written[:, 1] - data["x"]) ** 2)) < 0.01


def test_scores_and_report_do_not_take_the_delay_twice():
    data = late_tank(1, 0.3, noise=0.0005)
    result = identify(Study(**STUDY, inputs={"u": Driven(delay=0.3)}), data)
    (free_run,) = result.model.scores.free_runs
    assert free_run.stays
    (shown,) = at_work(result).free_runs.runs[0].panels
    lines = {line.role: np.array([line.x, line.y], dtype=float) for line in shown.wide}
    record, model = lines["recorded"], lines["model"]
    assert np.max(np.abs(np.interp(record[0], *model) - record[1])) < 0.02
