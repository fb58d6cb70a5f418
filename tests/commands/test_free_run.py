import csv
import json
from pathlib import Path

import numpy as np
import pyarrow as pa
import pytest
from logs import linear, oscillator, pendulum, smooth, write
from pyarrow import parquet
from scipy.integrate import solve_ivp
from scipy.linalg import expm

from odescope.commands.free_run import free_runs
from odescope.errors import InputError

A, B = np.array([[0.0, 1.0], [-4.0, -0.3]]), np.array([0.0, 1.0])


def dotted(name, k):
    return f"{name}_{'d' * k}ot" if k else name


def model(coordinates, relations, inputs=(), provenance=None):
    """Return a model.json: coordinates (name, order), inputs (name, hold), relations of (factor, term, coefficient)."""
    keys = ("factor", "term", "coefficient")
    return {
        "format": "odescope/model",
        "version": 1,
        "coordinates": [
            {"name": name, "order": order, "angle": bool(angle), "cyclic": False, "unit": None}
            for name, order, *angle in coordinates
        ],
        "inputs": [{"name": name, "hold": hold, "unit": None} for name, hold in inputs],
        "states": [dotted(name, k) for k in range(3) for name, order, *_ in coordinates if order > k],
        "targets": [dotted(name, order) for name, order, *_ in coordinates],
        "relations": [{"terms": [dict(zip(keys, t, strict=True)) | {"std_error": None} for t in r]} for r in relations],
        "explicit": {},
        "scores": {},
        "domain": {},
        "provenance": provenance or {},
    }


def oscillator_model(hold="linear", **provenance):
    terms = [("x_ddot", "1", 1.0), (None, "x", 4.0), (None, "x_dot", 0.3), (None, "u", -1.0)]
    return model([("x", 2)], [terms], [("u", hold)], provenance)


@pytest.fixture
def simulated(tmp_path, monkeypatch):
    """Write a model and a log, run the one on the other, return the columns and the notes."""
    monkeypatch.chdir(tmp_path)

    def run(content, log=None, time=None, sample_period=None, recording=None, initial=()):
        Path("model.json").write_text(json.dumps(content))
        if log is not None:
            write("log.csv", log)
        made = free_runs(Path("model.json"), Path("log.csv"), time, sample_period, recording, list(initial))
        header, *rows = csv.reader(made.text.splitlines())
        return {name: np.array(c) for name, c in zip(header, np.array(rows).T, strict=True)}, list(made.notes)

    return run


def numbers(columns, *names):
    return np.column_stack([columns[n].astype(float) for n in names])


# against SciPy and closed forms


@pytest.mark.parametrize("hold", ["linear", "zero"])
def test_a_linear_system_follows_its_matrix_exponential(simulated, hold):
    log = oscillator(400, held=hold == "zero")
    found, notes = simulated(oscillator_model(hold), log, initial=["x=1", "x_dot = 0.5"])
    exact = linear(A, B, np.array([1.0, 0.5]), log["t"], log["u"], hold == "zero")
    assert list(found) == ["t", "x", "x_dot"]
    assert np.allclose(numbers(found, "x", "x_dot"), exact, rtol=0, atol=1e-7)
    assert np.array_equal(found["t"].astype(float), log["t"])
    assert notes == []
    other = linear(A, B, np.array([1.0, 0.5]), log["t"], log["u"], hold != "zero")
    assert np.abs(other - exact).max() > 1e-3  # the two holds differ by what the test would see


def test_a_rational_pendulum_follows_scipy(simulated):
    terms = [
        ("phi_ddot", "1", 1.0),
        ("phi_ddot", "cos(phi)**2", -0.3),
        (None, "sin(phi)", 9.81),
        (None, "phi_dot*abs(phi_dot)", 0.1),
        (None, "u*cos(phi)", -2.0),
    ]
    t = 0.02 * np.arange(500)
    u = smooth(np.random.default_rng(0), 500, 0.02, 1.0, 2.0)

    def right(time, y):
        force = 2.0 * np.interp(time, t, u) * np.cos(y[0])
        return [y[1], (force - 9.81 * np.sin(y[0]) - 0.1 * y[1] * abs(y[1])) / (1.0 - 0.3 * np.cos(y[0]) ** 2)]

    oracle = solve_ivp(right, (0, t[-1]), [0.5, -1.0], "DOP853", t, rtol=1e-10, atol=1e-12, max_step=0.02)
    content = model([("phi", 2, "angle")], [terms], [("u", "linear")])
    found, _ = simulated(content, {"t": t, "u": u}, initial=["phi=0.5", "phi_dot=-1"])  # phi itself is not needed
    assert np.allclose(numbers(found, "phi", "phi_dot"), oracle.y.T, rtol=0, atol=1e-5)


def test_relations_that_share_their_targets_are_solved_together(simulated):
    # x' + y' = -x, x' - y' = y: x' = (y - x)/2, y' = -(x + y)/2
    relations = [
        [("x_dot", "1", 1.0), ("y_dot", "1", 1.0), (None, "x", 1.0)],
        [("x_dot", "1", 1.0), ("y_dot", "1", -1.0), (None, "y", -1.0)],
    ]
    t = 0.1 * np.arange(100)
    found, _ = simulated(model([("x", 1), ("y", 1)], relations), {"t": t, "x": t}, initial=["x=1", "y=0"])
    # eigenvalues (-1 +- i)/2
    exact = np.exp(-t / 2)[:, None] * np.column_stack([np.cos(t / 2), -np.sin(t / 2)])
    assert np.allclose(numbers(found, "x", "y"), exact, rtol=0, atol=1e-7)


# the first state


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_the_initial_velocity_is_found_from_positions_within_noise(simulated, seed):
    log = oscillator(1500, noise=0.01, seed=seed)
    found, _ = simulated(oscillator_model(), log)
    # fitted over 1500 samples of noise 0.01: a standard error of some 1e-3 at most, of a velocity of 0.5
    assert abs(float(found["x"][0]) - 1.0) < 0.01
    assert abs(float(found["x_dot"][0]) - 0.5) < 0.03
    exact = linear(A, B, np.array([1.0, 0.5]), log["t"], log["u"], False)
    assert np.sqrt(np.mean((numbers(found, "x")[:, 0] - exact[:, 0]) ** 2)) < 0.005


def test_given_states_stay_and_the_rest_is_fitted(simulated):
    found, _ = simulated(oscillator_model(), oscillator(600), initial=["x=1.25"])
    assert float(found["x"][0]) == 1.25
    assert abs(float(found["x_dot"][0]) - 0.5) < 0.03


def test_a_wrapped_angle_is_followed_through_its_turns(simulated):
    log = pendulum(600)
    terms = [("a_ddot", "1", 1.0), (None, "sin(a)", 9.81), (None, "a_dot", 0.2), (None, "u", -1.0)]
    content = model([("a", 2, "angle")], [terms], [("u", "linear")])
    content["provenance"] = {"columns": {"a": "Winkel [rad]", "u": "F;N"}, "time": "Time (s)"}
    found, _ = simulated(content, log)
    assert list(found) == ["Time (s)", "a", "a_dot"]
    assert np.ptp(found["a"].astype(float)) > 2 * np.pi
    error = np.unwrap(log["Winkel [rad]"]) - found["a"].astype(float)
    assert np.sqrt(np.mean(error**2)) < 3e-3  # the noise is 1e-3
    assert abs(float(found["a_dot"][0]) - 2.0) < 0.02


# recordings, time, early ends


def test_recordings_run_from_their_own_first_samples_and_keep_their_labels(simulated):
    t = 0.05 * np.arange(60)
    log = {
        "lap": np.repeat(["warm up", "(b)", "7"], 60),
        "t": np.tile(t, 3),
        "c": np.concatenate([s * np.exp(-0.5 * t) for s in (1.0, 2.0, 5.0)]),
    }
    log["lap"] = np.array([str(x) for x in log["lap"]], dtype=object)
    Path("log.csv").write_text("lap,t,c\n" + "".join(f"{a},{b},{c}\n" for a, b, c in zip(*log.values(), strict=True)))
    decay = model([("c", 1)], [[("c_dot", "1", 1.0), (None, "c", 0.5)]])
    found, _ = simulated(decay, recording="lap")
    assert list(found) == ["lap", "t", "c"]
    assert list(found["lap"]) == list(log["lap"])
    assert np.allclose(found["c"].astype(float), log["c"], rtol=1e-6, atol=0)


def test_recordings_in_folders_keep_their_labels(simulated):
    t = 0.05 * np.arange(60)
    for lap in ("(b)", "7"):
        Path(f"log.csv/lap={lap}").mkdir(parents=True)  # the fixture's log: a folder may be called anything
        parquet.write_table(pa.table({"t": t, "c": np.exp(-0.5 * t)}), f"log.csv/lap={lap}/part-0.parquet")
    decay = model([("c", 1)], [[("c_dot", "1", 1.0), (None, "c", 0.5)]])
    for known, told in (({}, {"recording": "lap"}), ({"recording": "lap"}, {})):
        found, _ = simulated(decay | {"provenance": known}, **told)
        assert list(found["lap"]) == ["(b)"] * 60 + ["7"] * 60


def test_rows_of_files_of_one_name_are_told_apart(simulated):
    for day, count in (("mon", 60), ("tue", 40)):
        Path(f"log.csv/{day}").mkdir(parents=True)
        t = 0.05 * np.arange(count)
        parquet.write_table(pa.table({"t": t, "c": np.exp(-0.5 * t)}), f"log.csv/{day}/part-0.parquet")
    found, _ = simulated(model([("c", 1)], [[("c_dot", "1", 1.0), (None, "c", 0.5)]]))
    assert len(found["t"]) == 100


def test_the_time_is_the_column_as_identified_or_t_or_time_or_counted(simulated):
    t = 0.05 * np.arange(40)
    decay = model([("c", 1)], [[("c_dot", "1", 1.0), (None, "c", 0.5)]], provenance={"time": "clock"})
    for name in ("clock", "t", "time", "Time"):
        found, _ = simulated(decay, {name: 3.0 + t, "c": np.exp(-t), "other": t})
        assert list(found) == [name, "c"]
        assert np.allclose(found[name].astype(float), 3.0 + t)
    log = {"Zeit": t, "c": np.exp(-t)}
    with pytest.raises(InputError, match=r"log.csv has no column called t or time; .*--time.*Zeit, c"):
        simulated(decay, log)
    assert list(simulated(decay, log, time="Zeit")[0]) == ["Zeit", "c"]
    counted = simulated(decay, log, sample_period=0.05)[0]
    assert list(counted) == ["t", "c"]
    assert np.allclose(counted["t"].astype(float), t)


def test_a_run_without_bound_ends_with_a_note(simulated):
    t = 0.01 * np.arange(300)
    grows = model([("c", 1)], [[("c_dot", "1", 1.0), (None, "c**2", -1.0)]])  # c = 1/(1 - t)
    found, notes = simulated(grows, {"t": t, "c": t}, initial=["c=1"])
    assert 95 <= len(found["t"]) <= 101
    early = t[: len(found["t"])] < 0.9
    assert np.allclose(found["c"].astype(float)[early], 1 / (1 - t[: len(early)][early]), rtol=1e-6)
    (note,) = notes
    assert f"at {len(found['t'])} of 300 samples" in note


def test_rows_outside_of_what_was_recorded_are_counted(simulated):
    log = oscillator(600)
    log["x"][:5] = np.nan
    log["u"][-3:] = np.nan
    found, notes = simulated(oscillator_model(), log)
    assert np.array_equal(found["t"].astype(float), log["t"][5:-3])
    (note,) = notes
    assert note.startswith("8 of 600 rows in log.csv have no states: they lie before, behind or between what was")


def test_a_record_that_a_gap_cuts_starts_anew_with_a_note(simulated):
    log = oscillator(600)
    log = {name: np.delete(column, np.arange(200, 300)) for name, column in log.items()}
    found, notes = simulated(oscillator_model(), log)
    assert len(found["t"]) == 500
    (note,) = notes
    assert note.startswith("gaps cut the record in log.csv into 2 pieces: behind each gap the run starts anew")


def test_a_state_that_is_given_for_several_recordings_is_told(simulated):
    log = {name: np.tile(column, 2) for name, column in oscillator(100).items()} | {"run": np.repeat([1.0, 2.0], 100)}
    found, notes = simulated(oscillator_model(), log, recording="run", initial=["x=1"])
    assert found["x"][[0, 100]].tolist() == ["1.0", "1.0"]
    (note,) = notes
    assert note.startswith("what --initial says of x is taken for the state at the first sample of every recording")
    assert simulated(oscillator_model(), log, recording="run")[1] == []


# what is refused


@pytest.mark.parametrize(
    ("initial", "part"),
    [
        (["v=1"], "'v' is no state of the model; there are: x, x_dot"),
        (["x_dott=1"], "did you mean 'x_dot'?"),
        (["x"], "expected STATE=NUMBER"),
        (["x=one"], "expected STATE=NUMBER"),
        (["x=nan"], "must be finite"),
        (["x=1", "x=2"], "--initial x is given twice"),
    ],
)
def test_bad_initial_states(simulated, initial, part):
    with pytest.raises(InputError) as caught:
        simulated(oscillator_model(), oscillator(50), initial=initial)
    assert part in str(caught.value)


@pytest.mark.parametrize(
    ("log", "part"),
    [
        ({"t": np.arange(30.0), "u": np.zeros(30)}, "no column 'x' in log.csv"),
        ({"t": np.arange(30.0), "x": np.zeros(30)}, "no column 'u' in log.csv"),
        ({"t": np.arange(30.0)[::-1], "x": np.zeros(30), "u": np.zeros(30)}, "time goes back"),
        ({"t": np.zeros(30), "x": np.zeros(30), "u": np.zeros(30)}, "time is 0 in every row"),
        ({"t": np.arange(30.0), "x": np.zeros(30), "u": np.full(30, np.nan)}, "0 of 30 cells of 'u' hold numbers"),
    ],
)
def test_logs_that_cannot_drive_the_model(simulated, log, part):
    with pytest.raises(InputError) as caught:
        simulated(oscillator_model(), log)
    assert part in str(caught.value)


@pytest.mark.parametrize("spoilt", ["irregular", "lost", "doubled and swapped"])
def test_there_is_one_row_for_each_row_of_the_file(simulated, spoilt):
    log = oscillator(600)
    exact = linear(A, B, np.array([1.0, 0.5]), log["t"], log["u"], held=False)
    rows = np.arange(600)
    if spoilt == "irregular":
        stamps = log["t"] + 0.02 * np.random.default_rng(1).uniform(-0.3, 0.3, 600)
        log = {"t": stamps, "x": np.interp(stamps, log["t"], log["x"]), "u": np.interp(stamps, log["t"], log["u"])}
        exact = np.column_stack([np.interp(stamps, 0.02 * rows, state) for state in exact.T])
    else:
        rows = rows[np.r_[0:50, 60:600]] if spoilt == "lost" else np.insert(rows, [101, 201], [100, 200])
        if spoilt != "lost":
            rows[[300, 301]] = rows[[301, 300]]
        log, exact = {name: column[rows] for name, column in log.items()}, exact[rows]
    found, _ = simulated(oscillator_model(), log, initial=["x=1", "x_dot=0.5"])
    assert np.array_equal(found["t"].astype(float), log["t"])
    assert np.abs(numbers(found, "x", "x_dot") - exact).max() < 0.02 * np.ptp(exact)


@pytest.mark.parametrize("column", ["t", "time", "t [ms]"])
def test_a_model_that_nothing_drives_runs_at_the_times_alone(simulated, column):
    """As the file has them: uneven, in any order, and twice."""
    terms = [("x_ddot", "1", 1.0), (None, "x", 4.0), (None, "x_dot", 0.3)]
    t = np.array([0.0, 0.7, 0.9, 3.0, 2.5, 2.5])
    log = {column: t * 1000.0 if "ms" in column else t}
    found, notes = simulated(model([("x", 2)], [terms]), log, initial=["x=1", "x_dot=0.5"])
    exact = np.array([expm(A * at) @ [1.0, 0.5] for at in t])
    assert np.array_equal(found[column].astype(float), log[column])
    np.testing.assert_allclose(numbers(found, "x", "x_dot"), exact, rtol=0, atol=1e-7)
    assert notes == []


def test_a_model_that_nothing_drives_runs_with_a_sample_period(simulated):
    terms = [("x_dot", "1", 1.0), (None, "x", 1.0)]
    found, _ = simulated(model([("x", 1)], [terms]), {"q": np.arange(5.0) ** 2}, sample_period=0.5, initial=["x=2"])
    np.testing.assert_allclose(numbers(found, "t", "x")[:, 1], 2.0 * np.exp(-0.5 * np.arange(5)), rtol=1e-7)
