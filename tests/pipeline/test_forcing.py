"""A forcing that was not recorded, and what repeats along a position, are found by the residual that they leave."""

import msgspec
import numpy as np
import pytest
from scipy.integrate import solve_ivp

from odescope import Candidates, Data, Driven, Measured, NoModelError, Study, identify
from odescope.events import Note, Progress
from odescope.pipeline.forcing import _positions, _waves
from odescope.pipeline.identification import NothingFound
from odescope.recordings.record import Record, Records

DURATION, PERIOD, NOISE = 30.0, 0.05, 0.01
RATE, STRENGTH, INFLOW, OUTFLOW = 1.9, 0.7, 1.0, 0.8
STUDY = Study(coordinates={"x": Measured(order=1)}, data=Data(time="clock"))
STUDY_OF_ROWS = msgspec.structs.replace(STUDY, data=Data(sample_period=PERIOD))


def log(strength, phase, seed):
    t = np.arange(0.0, DURATION, PERIOD) + 5.0

    def rate(now, x):
        return INFLOW - OUTFLOW * x + strength * np.cos(RATE * now + phase)

    x = solve_ivp(rate, (t[0], t[-1]), [4.0], t_eval=t, rtol=1e-9, atol=1e-11).y[0]
    return {"clock": t, "x": x + NOISE * x.std() * np.random.default_rng(seed).standard_normal(len(t))}


@pytest.mark.slow
@pytest.mark.parametrize(
    ("phase", "seed"),
    [pytest.param(0.4, 0, id="where no law is found"), pytest.param(2.5, 1, id="beside a rough law")],
)
def test_a_forcing_that_was_not_recorded_is_found(phase, seed):
    told = []
    result = identify(STUDY, log(STRENGTH, phase, seed), watch=told.append)
    assert not [event for event in told if isinstance(event, NothingFound)]
    truth = {
        "1": INFLOW,
        "x": -OUTFLOW,
        "cos(rate_t*t)": STRENGTH * np.cos(phase),
        "sin(rate_t*t)": -STRENGTH * np.sin(phase),
    }
    found = {row.term: row for row in result.coefficients if row.equation == "x_dot"}
    assert set(found) == set(truth)
    assert all(abs(found[term].coefficient - value) < 4.0 * found[term].std_error for term, value in truth.items())
    (rate,) = [p for p in result.model.parameters if p.name == "rate_t"]
    assert abs(rate.value - RATE) < 4.0 * rate.std_error
    (said,) = [s for s in result.model.scores.suspicions if s.reason == "periodic"]
    assert said.low < RATE < said.high
    assert set(said.found) == {"cos(rate_t*t)", "sin(rate_t*t)"}
    assert any("a forcing that was not recorded" in note for note in result.notes)
    assert not any("a forcing that was not recorded" in note for note in result.warnings)


def test_where_no_law_is_found_and_no_forcing_is_to_be_suspected_that_is_told_once():
    told = []
    with pytest.raises(NoModelError):
        identify(
            msgspec.structs.replace(STUDY, library=Candidates(suspect=False)), log(STRENGTH, 0.4, 0), watch=told.append
        )
    assert [type(event) for event in told].count(NothingFound) == 1


@pytest.mark.slow
def test_where_no_law_is_found_the_lack_of_a_time_is_told_all_the_same():
    told = []
    with pytest.raises(NoModelError):
        identify(STUDY_OF_ROWS, {"x": log(STRENGTH, 0.4, 0)["x"]}, watch=told.append)
    (note,) = [event for event in told if isinstance(event, Note)]
    assert note.warns
    assert "[data] time names a column of numbers, in seconds" in note.text


def test_what_is_followed_without_a_forcing_is_left_alone():
    told = []
    result = identify(STUDY, log(0.0, 0.0, 0), watch=told.append)
    assert {row.term for row in result.coefficients} == {"1", "x"}
    assert result.model.scores.suspicions == ()
    assert not [e for e in told if isinstance(e, Progress) and "forcing" in e.part]


@pytest.mark.parametrize(
    ("data", "columns"),
    [
        (Data(sample_period=PERIOD), ["x"]),
        pytest.param(Data(time="clock", time_unit="ms"), ["clock", "x"], marks=pytest.mark.slow),
    ],
)
def test_where_the_time_has_no_column_in_seconds_it_is_said_what_to_name(data, columns):
    recorded = log(STRENGTH, 2.5, 1)
    recorded["clock"] = 1e3 * recorded["clock"]
    result = identify(msgspec.structs.replace(STUDY, data=data), {name: recorded[name] for name in columns})
    (said,) = [s for s in result.model.scores.suspicions if s.reason == "periodic"]
    assert (said.tried, said.found) == ((), ())
    assert any("[data] time names a column of numbers, in seconds" in warning for warning in result.warnings)


def test_nothing_is_tried_where_functions_are_not_to_be_suspected():
    result = identify(msgspec.structs.replace(STUDY, library=Candidates(suspect=False)), log(STRENGTH, 2.5, 1))
    assert result.model.scores.suspicions == ()
    assert not result.refinement.exact


@pytest.mark.slow
def test_stamps_that_count_from_1970_do_as_well():
    """So far from its origin a sine's rate and its phase are one to a fit: it counts from the middle of the record."""
    recorded = log(STRENGTH, 2.5, 1)
    result = identify(STUDY, {**recorded, "clock": recorded["clock"] + 1.7e9})
    found = {row.term.split("(")[0]: row for row in result.coefficients if row.equation == "x_dot"}
    assert set(found) == {"1", "x", "sin", "cos"}
    assert np.hypot(found["sin"].coefficient, found["cos"].coefficient) == pytest.approx(STRENGTH, rel=0.02)
    (rate,) = [p for p in result.model.parameters if p.name == "rate_t"]
    assert abs(rate.value - RATE) < 4.0 * rate.std_error
    (run,) = result.free_runs
    assert np.sqrt(np.mean((run.run.column("x") - recorded["x"]) ** 2)) < 2.0 * NOISE * recorded["x"].std()


@pytest.mark.slow
def test_dates_are_no_seconds_and_a_model_comes_of_them_all_the_same(tmp_path):
    recorded = log(STRENGTH, 2.5, 1)
    stamps = np.datetime64("2024-05-01T00:00:00") + (1e3 * recorded["clock"]).round().astype("timedelta64[ms]")
    lines = (f"{stamp},{x}\n" for stamp, x in zip(stamps, recorded["x"], strict=True))
    (tmp_path / "log.csv").write_text("clock,x\n" + "".join(lines))
    result = identify(STUDY, tmp_path / "log.csv")
    (said,) = [s for s in result.model.scores.suspicions if s.reason == "periodic"]
    assert (said.tried, said.found) == ((), ())
    assert any("[data] time names a column of numbers, in seconds" in warning for warning in result.warnings)


COG, PITCH, DRAG = 3.0, 0.5, 1.2


@pytest.mark.slow
def test_the_cogging_of_a_stage_is_found_along_its_position():
    t = np.arange(0.0, 12.0, 0.01)
    force = 6.0 * np.sin(1.3 * t) + 4.0 * np.sin(2.9 * t + 1.0)

    def rate(now, s):
        u = np.interp(now, t, force)
        return [s[1], u - DRAG * s[1] - 2.0 * s[0] - COG * np.sin(2.0 * np.pi / PITCH * s[0])]

    x = solve_ivp(rate, (0.0, t[-1]), [0.0, 0.0], t_eval=t, rtol=1e-8, atol=1e-10, max_step=0.01).y[0]
    study = Study(coordinates={"x": Measured(order=2)}, inputs={"u": Driven()}, data=Data(time="t"))
    read = x + 5e-4 * np.random.default_rng(0).standard_normal(len(t))
    result = identify(study, {"t": t, "x": read, "u": force})
    found = {row.term: row for row in result.coefficients if row.equation == "x_ddot"}
    truth = {"u": 1.0, "x_dot": -DRAG, "x": -2.0, "sin(rate_x*x)": -COG}
    assert set(found) == set(truth)
    assert all(abs(found[term].coefficient - value) < 4.0 * found[term].std_error for term, value in truth.items())
    (constant,) = [p for p in result.model.parameters if p.name == "rate_x"]
    assert abs(constant.value - 2.0 * np.pi / PITCH) < 4.0 * constant.std_error
    (said,) = [s for s in result.model.scores.suspicions if s.reason == "recurring"]
    assert said.low < constant.value < said.high
    assert any("repeats along x" in note for note in result.notes)


@pytest.mark.parametrize(
    ("origin", "wave"), [(0.0, "sin(k*x)"), (-40.0, "sin(k*(x + 39.89))"), (3e5, "sin(k*(x - 300000.10))")]
)
def test_a_sine_of_what_keeps_far_from_zero_counts_from_its_middle(origin, wave):
    t = np.arange(9.0)
    run = Record(t, origin + 0.1 * np.linspace(0.0, 2.1, 9)[:, None], ("x",), (None,))
    assert _waves(Records.of(run), "x", "k")[0] == wave


@pytest.mark.parametrize(("form", "positions"), [("auto", ("q", "w")), ("relations", ("q", "w")), ("lagrangian", ())])
def test_a_sine_of_a_position_is_looked_for_where_it_may_be_a_candidate(form, positions):
    coordinates = {"q": Measured(order=2), "x": Measured(order=2, cyclic=True), "i": Measured(), "w": Measured(order=2)}
    study = Study(coordinates=coordinates, data=Data(time="t"), library=Candidates(form=form))
    assert _positions(study) == positions


@pytest.mark.slow
def test_a_swing_that_is_pumped_has_a_stiffness_that_goes_to_and_fro():
    t = np.arange(0.0, 40.0, 0.02)
    x = solve_ivp(
        lambda now, s: [s[1], -(2.0 + 1.1 * np.cos(3.3 * now + 0.4)) * s[0] - 0.1 * s[1]],
        (0.0, t[-1]),
        [1.0, 0.0],
        t_eval=t,
        rtol=1e-9,
        atol=1e-11,
    ).y[0]
    read = x + NOISE * x.std() * np.random.default_rng(0).standard_normal(len(t))
    result = identify(Study(coordinates={"x": Measured(order=2)}, data=Data(time="t")), {"t": t, "x": read})
    found = {row.term: row for row in result.coefficients if row.equation == "x_ddot"}
    truth = {
        "x": -2.0,
        "x_dot": -0.1,
        "x*cos(rate_t*t)": -1.1 * np.cos(0.4),
        "x*sin(rate_t*t)": 1.1 * np.sin(0.4),
    }
    assert set(found) == set(truth)
    assert all(abs(found[term].coefficient - value) < 4.0 * found[term].std_error for term, value in truth.items())
    (constant,) = [p for p in result.model.parameters if p.name == "rate_t"]
    assert abs(constant.value - 3.3) < 4.0 * constant.std_error
    assert any("goes to and fro" in note for note in result.notes)
