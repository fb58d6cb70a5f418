"""Inputs that step between two samples: where they step, when, and the law of a circuit that is driven so."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from odescope.likelihood.sampled_inputs import SampledInputs
from odescope.likelihood.step_times import StepTimes
from odescope.pipeline.identification import identify
from odescope.recordings.between_samples import steps_of
from odescope.recordings.coordinate import Input
from odescope.recordings.record import Record, Records
from odescope.study.options import Data, Driven, Measured, Study

COUNT, PERIOD, HELD = 600, 0.04, 37.3  # the last in samples


def staircase(rng, count=COUNT):
    """Return steps at times that are no whole numbers of samples, and the levels between them."""
    times = np.cumsum(HELD * rng.uniform(0.7, 1.3, int(count / HELD / 0.7)))
    return times[times < count - 1.0], rng.uniform(0.2, 0.6, len(times) + 1)


def at(times, levels, sample):
    """Return the level at a time in samples."""
    return levels[np.searchsorted(times, sample, side="right")]


@pytest.mark.parametrize("noise", [0.0, 0.005])
def test_steps_are_seen_also_in_a_noisy_input(noise):
    rng = np.random.default_rng(0)
    times, levels = staircase(rng)
    u = at(times, levels, np.arange(COUNT)) + noise * rng.standard_normal(COUNT)
    large = np.abs(np.diff(levels[: len(times) + 1])) > 0.1
    assert set(np.floor(times[large]).astype(int)) <= set(steps_of(u).tolist()) <= set(np.floor(times).astype(int))


@pytest.mark.parametrize(
    "u",
    [
        np.sin(0.05 * np.arange(COUNT)),
        np.random.default_rng(0).standard_normal(COUNT),
        np.repeat(np.random.default_rng(0).choice([-1.0, 1.0], COUNT // 3), 3),
        np.zeros(COUNT),
        np.floor(np.arange(COUNT) / 2.0) % 7,
    ],
    ids=["smooth", "noise", "often", "constant", "ramps"],
)
def test_what_is_no_staircase_has_no_steps(u):
    assert steps_of(u).tolist() == []


@pytest.mark.parametrize("late", [0.0, 0.3, 1.8, -0.6])
def test_inputs_that_step_between_samples_are_where_they_step_however_late(late):
    rng = np.random.default_rng(1)
    times, levels = staircase(rng)
    t = np.arange(COUNT)
    records = Records((Record(PERIOD * t, np.column_stack([np.zeros(COUNT), at(times, levels, t)]), ("x", "u")),))
    steps = StepTimes.of(records, [Input("w"), Input("u")], ["u"])
    assert steps is not None
    assert steps.inputs.sum(axis=0).tolist() == [0, len(steps.sample)]
    early = 1.0 + steps.sample - times[np.searchsorted(times, steps.sample)]
    placed = replace(steps, early=early)
    (run,) = records
    columns, whole = np.column_stack([run.column("x"), run.column("u")]), np.zeros(COUNT, dtype=np.int64)
    there = SampledInputs(columns, ("zero", "zero"), t, whole, whole + COUNT - 1, 1, PERIOD, placed.on_samples(records))
    begin, middle, end = there.nodes([late, late])[:, :, 1].T
    cuts, known = there.cuts([late, late]), np.isin(t, np.concatenate([steps.sample + k for k in (-1, 0, 1, 2)]))
    fine = (np.arange(100) + 0.5) / 100.0
    true = at(times, levels, t[:, None] + fine - late)
    stays, follows = ~np.isnan(middle), np.where(fine < cuts[:, None], begin[:, None], end[:, None])
    np.testing.assert_allclose(follows[known], true[known])
    np.testing.assert_array_equal(begin[stays], end[stays])
    gain = there.nodes_and_gain([late, late])[:, :, 3]
    np.testing.assert_allclose(gain[:, 1], (begin - end) / PERIOD)
    assert placed.placed(["w", "u"]) == {"u": len(steps.sample)}


def boost(seed, whole):
    """Return two recordings of a boost converter whose duty cycle steps anywhere, or at samples alone, and when."""
    rng, t = np.random.default_rng(seed), PERIOD * np.arange(COUNT)
    logs, when = [], []
    for _ in range(2):
        times, levels = staircase(rng)
        times = np.round(times) if whole else times
        edges = PERIOD * np.array([0.0, *times, COUNT])
        x, runs = np.array([1.0, 8.0]), []
        for begin, end, d in zip(edges[:-1], edges[1:], levels, strict=False):
            inside = t[(t >= begin) & (t < end)]

            def slope(_, x, d=d):
                return [(6.0 - (1.0 - d) * x[1]) / 2.0, ((1.0 - d) * x[0] - x[1] / 5.0) / 0.5]

            run = solve_ivp(slope, (begin, end), x, t_eval=[*inside, end], rtol=1e-9, atol=1e-11).y
            runs.append(run[:, :-1])
            x = run[:, -1]
        both = np.concatenate(runs, axis=1)
        both += 0.01 * both.std(axis=1)[:, None] * rng.standard_normal(both.shape)
        logs.append({"t": t, "i": both[0], "v": both[1], "d": at(times, levels, np.arange(COUNT))})
        when.append(times)
    return logs, when


STUDY = Study(data=Data(time="t"), coordinates={"i": Measured(order=1), "v": Measured(order=1)}, inputs={"d": Driven()})
LAW = [{"1", "v", "v*d"}, {"i", "v", "i*d"}]


def exact(result):
    """Say whether each relation has the terms of the law and no others."""
    names = zip(result.model.relations, ("i_dot", "v_dot"), strict=True)
    found = [{"*".join(sorted(t.text.split("*"))) for t in r.terms} - {n} for r, n in names]
    return found == [{"*".join(sorted(t.split("*"))) for t in terms} for terms in LAW]


@pytest.mark.parametrize("seeds", [1, pytest.param(6, marks=pytest.mark.slow)])
def test_the_law_is_found_where_an_input_steps_between_samples(seeds):
    right = 0
    for seed in range(seeds):
        result = identify(STUDY, boost(seed, whole=False)[0])
        right += exact(result)
        assert result.model.scores.holds["d"].steps > 0
        assert any("of its steps fall between two samples" in note for note in result.notes)
    assert right >= 0.8 * seeds


def test_steps_at_samples_stay_there():
    result = identify(STUDY, boost(0, whole=True)[0])
    assert exact(result)
    assert "d" not in result.model.scores.holds or result.model.scores.holds["d"].steps == 0


def two_tanks(seed, late):
    """Return a log of two tanks whose inflow steps at samples and acts so many samples later."""
    rng, period, count = np.random.default_rng(seed), 0.4, 751
    begins = np.arange(0, count, 30)
    levels = rng.uniform(0.5, 3.5, len(begins))
    edges = period * np.r_[0.0, begins[1:] + late, count]
    t, x, parts = period * np.arange(count), np.array([1.0, 2.0]), []
    for begin, end, q in zip(edges[:-1], edges[1:], levels, strict=True):
        inside = t[(t >= begin - 1e-9) & (t < end - 1e-9)]

        def slope(_, x, q=q):
            return [0.3 * q - 0.5 * np.sqrt(x[0]), 0.5 * np.sqrt(x[0]) - 0.4 * np.sqrt(x[1])]

        run = solve_ivp(slope, (begin, end), x, t_eval=np.r_[np.maximum(inside, begin), end], rtol=1e-9, atol=1e-11).y
        parts.append(run[:, :-1])
        x = run[:, -1]
    levels = levels[np.searchsorted(begins, np.arange(count), side="right") - 1]
    h1, h2 = np.concatenate(parts, axis=1) + 0.01 * rng.standard_normal((2, count))
    return {"t": t, "h1": h1, "h2": h2, "q": levels}


LATE = {20: 2.5, 12: 1.5, 21: 2.5, 22: 2.5, 25: 2.5, 27: 2.5, 11: 2.75, 15: 2.25}  # samples, by seed


@pytest.mark.parametrize("seed", [20, 12, *(pytest.param(k, marks=pytest.mark.slow) for k in list(LATE)[2:])])
def test_a_delay_between_samples_moves_no_single_steps_and_makes_no_lines_of_them(seed):
    late = LATE[seed]
    study = Study(data=Data(time="t"), coordinates={"h1": Measured(), "h2": Measured()}, inputs={"q": Driven()})
    model = identify(study, two_tanks(seed, late)).model
    laws = [{t.text: t for t in r.terms[1:]} for r in model.relations]
    assert [set(law) for law in laws] == [{"q", "sqrt(h1)"}, {"sqrt(h1)", "sqrt(h2)"}]
    for law, truth in zip(laws, ({"q": -0.3, "sqrt(h1)": 0.5}, {"sqrt(h1)": -0.5, "sqrt(h2)": 0.4}), strict=True):
        for name, value in truth.items():
            assert abs(law[name].coefficient - value) < 4.0 * law[name].std_error < 0.04 * abs(value)
    assert model.scores.holds["q"].steps == 0
    assert model.inputs[0].hold == "zero"
    assert model.inputs[0].delay == pytest.approx(0.4 * late, abs=0.01)


@pytest.mark.parametrize("seeds", [3, pytest.param(10, marks=pytest.mark.slow)])
def test_times_that_a_model_without_its_drag_asked_for_go_with_the_drag(seeds):
    """A vehicle under water whose thrust steps at samples: without its quadratic drag, steps seem to come early."""
    for seed in range(seeds):
        rng, t = np.random.default_rng(seed), 0.05 * np.arange(1800)
        logs = []
        for _ in range(2):
            thrust = np.repeat(rng.uniform(-40.0, 40.0, 16), 120)[: len(t)]
            z, v, run = 0.0, 0.0, []
            for u in thrust.tolist():
                run.append(z)
                for _ in range(10):  # the drag is slow beside a tenth of a period
                    half = v + 0.0025 * (u - 6.0 * v - 30.0 * abs(v) * v - 2.5) / 45.0
                    z, v = z + 0.005 * half, v + 0.005 * (u - 6.0 * half - 30.0 * abs(half) * half - 2.5) / 45.0
            logs.append({"t": t, "z": np.array(run), "tau": thrust})
        size = 0.01 * np.concatenate([log["z"] for log in logs]).std()
        for log in logs:
            log["z"] += size * rng.standard_normal(len(t))
        study = Study(data=Data(time="t"), coordinates={"z": Measured(order=2)}, inputs={"tau": Driven()})
        model = identify(study, logs).model
        assert {t.text for t in model.relations[0].terms} == {"z_ddot", "1", "z_dot", "z_dot*abs(z_dot)", "tau"}
        assert model.inputs[0].delay == 0.0
        assert "tau" not in model.scores.holds or model.scores.holds["tau"].steps == 0
