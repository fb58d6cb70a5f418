from __future__ import annotations

import json

import msgspec
import numpy as np
import pytest
from identification_cases import (
    DEMO,
    REGRESSED,
    assert_recovers,
    band,
    noisy,
    runge_kutta,
    study_of,
)

from odescope.commands.demo import cart_pendulum, table_two
from odescope.errors import InputError
from odescope.events import Event, StageBegan
from odescope.export.model_file import from_json, to_json
from odescope.library.tape import evaluate, write_tape
from odescope.pipeline.identification import identify
from odescope.recordings.record import Record, Records
from odescope.study.library_options import Candidates
from odescope.study.options import Data, Driven, Measured


@pytest.fixture(scope="module")
def demo(log):
    events: list[Event] = []
    result = identify(DEMO, log, watch=events.append)
    return result, [event.stage for event in events if isinstance(event, StageBegan)]


def test_the_demo_is_recovered_with_joint_friction(demo):
    for row in table_two(cart_pendulum(), demo[0].model):
        assert row.truth is not None, f"{row.term} of {row.target} is too much"
        assert row.found == pytest.approx(row.truth, rel=0.02), f"{row.term} of {row.target}"


def test_the_chosen_are_the_first_of_their_target_and_made_the_model(demo):
    result = demo[0]
    for search, chosen, relation in zip(result.searches, result.chosen, result.model.relations, strict=True):
        assert chosen is search.ranked.candidates[0]
        assert relation.terms[0].text == chosen.target
        assert relation.terms[0].coefficient == 1.0
        mine = {t.text: t.coefficient for t in relation.terms}
        theirs = {search.problem.terms[j].text: chosen.xi[j] for j in chosen.support}
        assert mine == theirs


def test_scores_are_honest(demo):
    model = demo[0].model
    for target in model.targets:
        score = model.scores.targets[target]
        assert score.r2_held_out > 0.99
        # The truth's denominator, 1 - .3268 cos^2, is least at cos^2 = 1 and most at 0; the pendulum turns over.
        assert score.denominator.data == pytest.approx([1 - 0.3268, 1.0], abs=2e-3)
        low, high = score.denominator.box
        assert low <= score.denominator.data[0]
        assert high >= score.denominator.data[1]
    (free_run,) = model.scores.free_runs
    assert free_run.ended is None
    assert free_run.duration == pytest.approx(65.0, rel=0.001)  # all of the record, from its start
    assert 1.0 < free_run.valid_time <= free_run.duration
    assert free_run.valid_time == min(c.valid_time for c in free_run.coordinates.values())
    assert demo[0].notes == ()


def test_the_domain_is_where_the_data_were(demo, log):
    domain = demo[0].model.domain
    assert set(domain) == {"x", "phi", "x_dot", "phi_dot", "u"}
    assert domain["phi"][0] == pytest.approx(log["phi"].min(), abs=0.05)
    assert domain["phi"][1] == pytest.approx(log["phi"].max(), abs=0.05)
    assert domain["x"][0] == pytest.approx(log["x"].min(), abs=0.01)
    assert domain["u"][1] == pytest.approx(log["u"].max(), rel=0.03)


def test_provenance_says_what_was_found_in_the_signals(demo):
    provenance = demo[0].model.provenance
    assert provenance["recordings"] == 1
    assert provenance["channels"]["x"]["noise"] == pytest.approx(0.0005, rel=0.02)
    assert provenance["channels"]["phi"]["noise"] == pytest.approx(0.0025, rel=0.02)
    assert provenance["columns"] == {"x": "x", "phi": "phi", "u": "u"}


def test_every_stage_is_announced_before_it_runs(demo):
    result, stages = demo
    order = list(dict.fromkeys(stages))
    expected = ["records", "signals", "regression", "selection", "model", "bootstrap"]
    assert [s for s in order if s != "library"] == expected
    assert set(order) == {"library", *expected}
    assert list(result.seconds) == list(dict.fromkeys(stages))


def test_the_same_seed_gives_the_same_file(demo, log):
    again = identify(DEMO, log)
    assert to_json(again.model) == to_json(demo[0].model)
    assert [c.support for s in again.searches for c in s.ranked.candidates] == [
        c.support for s in demo[0].searches for c in s.ranked.candidates
    ]


def test_the_model_file_reads_back_as_the_model(demo):
    text = to_json(demo[0].model)
    read = from_json(text)
    assert read.relations == demo[0].model.relations
    assert to_json(read) == text
    written = json.loads(text)
    assert list(written) == [
        "format",
        "version",
        "coordinates",
        "inputs",
        "states",
        "targets",
        "relations",
        "explicit",
        "scores",
        "domain",
        "provenance",
    ]
    assert (written["format"], written["version"]) == ("odescope/model", 1)
    assert written["coordinates"][0] == {"name": "x", "order": 2, "angle": False, "cyclic": True, "unit": "m"}
    assert written["states"] == ["x", "phi", "x_dot", "phi_dot"]
    assert all(
        t.keys() == {"factor", "term", "coefficient", "std_error"} for r in written["relations"] for t in r["terms"]
    )


def test_a_wrapped_angle_is_the_same_angle(log, demo):
    wrapped = {**log, "phi": np.angle(np.exp(1j * log["phi"]))}
    assert np.ptp(log["phi"]) > 2 * np.pi  # it does turn over
    for mine, theirs in zip(identify(DEMO, wrapped).model.relations, demo[0].model.relations, strict=True):
        assert [t.text for t in mine.terms] == [t.text for t in theirs.terms]
        np.testing.assert_allclose(
            [t.coefficient for t in mine.terms], [t.coefficient for t in theirs.terms], rtol=1e-6
        )


def regressed(case):
    return msgspec.structs.replace(case.study, likelihood=REGRESSED)


TRUTHS = {
    # x' = .6 - 1.5 x/(.3 + x), times (.3 + x)/.3
    "michaelis-menten": {"x_dot": {"x_dot": 1.0, "x_dot*x": 1 / 0.3, "1": -0.6, "x": 0.9 / 0.3}},
    "lorenz": {
        "x_dot": {"x_dot": 1.0, "x": 10.0, "y": -10.0},
        "y_dot": {"y_dot": 1.0, "x": -28.0, "y": 1.0, "x*z": 1.0},
        "z_dot": {"z_dot": 1.0, "x*y": -1.0, "z": 8 / 3},
    },
    "predator-prey": {
        "x_dot": {"x_dot": 1.0, "x_dot*x": 0.5, "x": -1.0, "x**2": 1 / 3 - 0.5, "x**3": 1 / 6, "x*y": 1.0},
        "y_dot": {"y_dot": 1.0, "y_dot*x": 0.5, "x*y": -0.6 + 0.2, "y": 0.4},
    },
}


@pytest.mark.parametrize("name", TRUTHS)
def test_first_order_systems_are_recovered_from_states_alone(systems, name):
    case = systems.CASES[name]
    data = systems.noisy(case, 0.001, np.random.default_rng(0))
    assert_recovers(identify(regressed(case), data), TRUTHS[name], rel=0.02)


def test_a_driven_van_der_pol_oscillator_is_recovered(systems):
    case = systems.CASES["van der pol"]
    rng = np.random.default_rng(0)
    t = 0.01 * np.arange(6001)
    u = 1.5 * band(rng, 6001, 0.01, 0.5)
    states = runge_kutta(lambda s, u: np.array([s[1], 1.5 * (1 - s[0] ** 2) * s[1] - s[0] + u]), t, (1.0, 0.0), u)
    result = identify(regressed(case), {"t": t, "x": noisy(rng, states[:, 0], 0.001), "u": u})
    truth = {"x_ddot": 1.0, "x": 1.0, "x_dot": -1.5, "x**2*x_dot": 1.5, "u": -1.0}
    assert_recovers(result, {"x_ddot": truth}, rel=0.02)


def test_an_equation_of_third_order_is_recovered():
    rng = np.random.default_rng(5)
    t = 0.02 * np.arange(3000)
    u = band(rng, len(t), 0.02, 0.5)

    def jerk(s, u):
        return np.array([s[1], s[2], -2.0 * s[2] - 3.0 * s[1] - 0.8 * s[0] - 0.4 * s[0] ** 3 + 3.0 * u])

    x = runge_kutta(jerk, t, (0.5, 0.0, 0.0), u)[:, 0]
    study = study_of(
        coordinates={"x": Measured(order=3)},
        inputs={"u": Driven()},
        library=Candidates(basis=("x", "x_dot", "x_ddot", "u"), degree=3),
    )
    result = identify(study, {"t": t, "x": noisy(rng, x, 1e-4), "u": u})
    truth = {"x_dddot": 1.0, "x_ddot": 2.0, "x_dot": 3.0, "x": 0.8, "x**3": 0.4, "u": -3.0}
    assert_recovers(result, {"x_dddot": truth}, rel=0.02)
    assert result.model.states == ("x", "x_dot", "x_ddot")


def test_coordinates_of_different_order_are_recovered_together():
    """A mass that a first-order actuator pushes."""
    rng = np.random.default_rng(6)
    t = 0.01 * np.arange(5000)
    u = 2.0 * band(rng, len(t), 0.01, 0.6)

    def f(s, u):
        q, speed, p = s
        return np.array([speed, -0.6 * speed - 4.0 * q + 2.0 * p, -3.0 * p + 3.0 * u - 0.5 * speed])

    states = runge_kutta(f, t, (0.2, 0.0, 0.0), u)
    study = study_of(coordinates={"q": Measured(order=2), "p": Measured()}, inputs={"u": Driven()})
    data = {"t": t, "q": noisy(rng, states[:, 0], 0.001), "p": noisy(rng, states[:, 2], 0.001), "u": u}
    truth = {
        "q_ddot": {"q_ddot": 1.0, "q_dot": 0.6, "q": 4.0, "p": -2.0},
        "p_dot": {"p_dot": 1.0, "p": 3.0, "u": -3.0, "q_dot": 0.5},
    }
    result = identify(study, data)
    assert_recovers(result, truth, rel=0.02)
    assert result.model.states == ("q", "p", "q_dot")


LAGRANGE = ("1", "u", "x_dot", "phi_dot", "sin(phi)", "cos(phi)", "phi_dot**2*sin(phi)", "x_ddot", "phi_ddot")
LAGRANGE += ("x_ddot*cos(phi)", "phi_ddot*cos(phi)", "x_ddot*sin(phi)", "phi_ddot*sin(phi)")


@pytest.fixture(scope="module", params=[None, LAGRANGE], ids=["default", "terms"])
def coupled(request, log):
    library = Candidates(terms=request.param, coupled=True)
    data = {name: values[:40_000:5] for name, values in log.items()}
    return identify(msgspec.structs.replace(DEMO, library=library), data)


def test_coupled_relations_solved_together_are_the_rational_model(coupled):
    rng = np.random.default_rng(0)
    domain = coupled.model.domain
    points = np.array([rng.uniform(*domain[name], 500) for name in coupled.model.variables])
    mine, truth = (
        [evaluate(write_tape(m.variables, [q.numerator, q.denominator]), points) for q in m.quotients]
        for m in (coupled.model, cart_pendulum())
    )
    for (top, bottom), (true_top, true_bottom) in zip(mine, truth, strict=True):
        expected = true_top / true_bottom
        assert np.std(top / bottom - expected) < 0.01 * np.std(expected)
    score = coupled.model.scores.targets["x_ddot"].denominator.data
    assert score[0] > 0.0 or score[1] < 0.0


@pytest.mark.parametrize("coupled", [LAGRANGE], indirect=True)
def test_relations_that_share_targets_are_the_equations_of_lagrange(coupled):
    m1, mc, a1, bc, g = 1.0, 0.8, 0.18, 10.0, 9.81
    inertia, mass = 1.7 * m1 * a1**2, m1 + mc
    truth = {
        "x_ddot": {
            "x_ddot": 1.0,
            "phi_ddot*cos(phi)": m1 * a1 / mass,
            "u": -1 / mass,
            "x_dot": bc / mass,
            "phi_dot**2*sin(phi)": -m1 * a1 / mass,
        },
        "phi_ddot": {
            "phi_ddot": 1.0,
            "x_ddot*cos(phi)": m1 * a1 / inertia,
            "phi_dot": 0.01 / inertia,
            "sin(phi)": m1 * g * a1 / inertia,
        },
    }
    assert_recovers(coupled, truth, rel=0.02)


@pytest.mark.parametrize("held", [25, 5])
def test_an_input_held_between_samples_is_taken_as_held(held):
    rng = np.random.default_rng(0)
    t = 0.02 * np.arange(3000)
    u = np.repeat(rng.standard_normal(len(t) // held), held)
    x = runge_kutta(lambda s, u: np.array([s[1], -0.4 * s[1] - 2.0 * s[0] + 0.8 * u]), t, (0.5, 0.0), u, zero=True)
    study = study_of(coordinates={"x": Measured(order=2)}, inputs={"u": Driven(hold="zero")})
    result = identify(study, {"t": t, "x": noisy(rng, x[:, 0], 0.001), "u": u})
    assert_recovers(result, {"x_ddot": {"x_ddot": 1.0, "x_dot": 0.4, "x": 2.0, "u": -0.8}}, rel=0.02)
    assert result.model.inputs[0].hold == "zero"


@pytest.fixture(scope="module")
def decays():
    """Runs of x' = -.5 x - .2 x^3 from several starts: no one of them says much."""
    rng, t = np.random.default_rng(2), 0.02 * np.arange(300)
    runs = []
    for start in (0.6, -1.2, 2.0, 3.0, -3.5):
        x = runge_kutta(lambda s, _: -0.5 * s - 0.2 * s**3, t, (start,), 0.0 * t)[:, 0]
        runs.append({"t": t, "x": x + 2e-4 * rng.standard_normal(len(t))})
    return runs


DECAY = study_of(coordinates={"x": Measured()})


DECAY_TRUTH = {"x_dot": {"x_dot": 1.0, "x": 0.5, "x**3": 0.2}}


def test_several_recordings_make_one_model(decays):
    result = identify(DECAY, decays)
    assert_recovers(result, DECAY_TRUTH, rel=0.03)
    assert len(result.signals.columns) == 5
    assert {b.record for b in result.searches[0].problem.blocks} == set(range(5))


def test_records_tables_and_a_column_of_recordings_are_the_same_data(decays):
    from_tables = identify(DECAY, decays).model
    records = Records(tuple(Record(run["t"], run["x"][:, None], ("x",)) for run in decays))
    joined = {name: np.concatenate([run[name] for run in decays]) for name in ("t", "x")}
    joined["run"] = np.repeat(np.arange(len(decays)), [len(run["t"]) for run in decays])
    by_column = msgspec.structs.replace(DECAY, data=Data(time="t", recording="run"))
    assert identify(DECAY, records).model.relations == from_tables.relations
    assert identify(by_column, joined).model.relations == from_tables.relations


def test_the_files_of_a_study_are_read_from_the_working_directory(decays, tmp_path, monkeypatch):
    for k, run in enumerate(decays):
        rows = "\n".join(f"{a!r},{b!r}" for a, b in zip(run["t"].tolist(), run["x"].tolist(), strict=True))
        (tmp_path / f"run{k}.csv").write_text(f"t,x\n{rows}\n")
    monkeypatch.chdir(tmp_path)
    study = msgspec.structs.replace(DECAY, data=Data(time="t", files=tuple(f"run{k}.csv" for k in range(5))))
    assert identify(study).model.relations == identify(DECAY, decays).model.relations
    with pytest.raises(InputError, match="names no files"):
        identify(DECAY)


def test_what_was_not_measured_in_one_file_is_told_with_what_to_do(tmp_path, monkeypatch):
    for k, names in enumerate(("t,x,y", "t,x,y", "t,x")):
        rows = "\n".join(",".join([f"{0.1 * j}"] * (names.count(",") + 1)) for j in range(50))
        (tmp_path / f"run{k}.csv").write_text(f"{names}\n{rows}\n")
    monkeypatch.chdir(tmp_path)
    both = {"x": Measured(), "y": Measured()}
    study = msgspec.structs.replace(DECAY, coordinates=both, data=Data(time="t", files=("run*.csv",)))
    with pytest.raises(InputError, match=r"column 'y' lacks in run2.csv, .*leave run2.csv out of files, or 'y' out of"):
        identify(study)
    nowhere = msgspec.structs.replace(study, coordinates={**both, "z": Measured()})
    with pytest.raises(InputError, match=r"no column 'z' in run0.csv"):
        identify(msgspec.structs.replace(nowhere, data=Data(time="t", files=("run0.csv", "run1.csv"))))


@pytest.mark.slow
def test_the_order_of_coordinates_does_not_change_the_equations(systems):
    case = systems.CASES["lorenz"]
    (data,) = systems.noisy(case, 0.001, np.random.default_rng(1))
    turned = msgspec.structs.replace(regressed(case), coordinates={n: Measured() for n in "zxy"})
    assert_recovers(identify(turned, data), {t: TRUTHS["lorenz"][t] for t in ("z_dot", "x_dot", "y_dot")}, rel=0.02)
