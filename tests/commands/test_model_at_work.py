"""The commands that run a model on data, filter and validate, and what simulate says of the fit."""

import csv
import json
from pathlib import Path

import numpy as np
import pytest
from logs import oscillator, write
from test_free_run import oscillator_model

NOISE = 0.01


@pytest.fixture
def machine(odescope):
    """A model that knows its noise, and a log of it with gaps and irregular stamps."""
    log = oscillator(1200, noise=NOISE, seed=3)
    write("log.csv", log)
    known = oscillator_model(channels={"x": {"noise": NOISE, "cutoff_hz": 2.0}})
    known["domain"] = {"x": [-2.0, 2.0], "x_dot": [-4.0, 4.0], "u": [-9.0, 9.0]}
    Path("model.json").write_text(json.dumps(known))
    Path("unknown.json").write_text(json.dumps(oscillator_model()))
    return odescope


def table(text):
    header, *rows = csv.reader(text.splitlines())
    return {name: np.array(c) for name, c in zip(header, np.array(rows).T, strict=True)}


def test_filter_writes_states_with_standard_deviations_and_says_how_consistent_they_are(machine):
    ended = machine("filter", "model.json", "log.csv")
    assert ended.code == 0
    found = table(ended.out)
    assert list(found) == [
        "t",
        "x",
        "x_dot",
        "x_std",
        "x_dot_std",
        "x_innovation",
        "x_innovation_std",
        "innovations_squared",
    ]
    assert "normalised innovations squared" in ended.err
    to_file = machine("filter", "model.json", "log.csv", "--smooth", "--out", "states.csv")
    assert (to_file.code, to_file.err) == (0, "")
    assert "innovations of x" in to_file.out
    smooth = table(Path("states.csv").read_text())
    assert np.all(smooth["x_dot_std"].astype(float) <= found["x_dot_std"].astype(float) * (1 + 1e-9))
    exact = oscillator(1200, noise=0.0, seed=3)
    rate = np.gradient(exact["x"], exact["t"])
    off = smooth["x_dot"].astype(float) - rate
    assert np.sqrt(np.mean(off[5:-5] ** 2)) < 0.1 * NOISE / (exact["t"][1] - exact["t"][0])


def test_filter_goes_over_missing_cells_and_tells_recordings_apart(machine):
    log = {k: v[:400] for k, v in oscillator(1200, noise=NOISE, seed=3).items()}
    rows = [
        f"{run},{t!r},{'' if 100 <= k < 120 else repr(x)},{u!r}"
        for run in ("a", "b")
        for k, (t, x, u) in enumerate(zip(*(log[n].tolist() for n in ("t", "x", "u")), strict=True))
    ]
    Path("log.csv").write_text("\n".join(["run,t,x,u", *rows]) + "\n")
    found = table(machine("filter", "model.json", "log.csv", "--recording", "run", "--noise", "x=0.02").out)
    assert sorted(set(found["run"])) == ["a", "b"]
    assert len(found["t"]) == 800
    assert np.all(found["x_innovation"][100:120] == "")
    assert np.all(found["x_innovation"][:100] != "")
    std = found["x_std"].astype(float)
    assert std[119] > std[99]


def test_process_noise_is_given_or_fitted(machine):
    given = machine("filter", "model.json", "log.csv", "--process-noise", "x_ddot=0.5")
    assert "process noise, times the root of a second: x_ddot 0.5" in given.err
    assert "root of a second" in machine("filter", "model.json", "log.csv", "--process-noise", "fit").err


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (
            ("unknown.json", "log.csv"),
            "how noisy x is; give the standard deviation of a sample of each, as in --noise x",
        ),
        (("unknown.json", "log.csv", "--noise", "y=1"), "'y' is no coordinate of the model; there are: x"),
        (("model.json", "log.csv", "--noise", "x=0"), "noise of x must be a positive number"),
        (("model.json", "log.csv", "--process-noise", "x=1"), "'x' is no target of the model; there are: x_ddot"),
        (("model.json", "log.csv", "--process-noise", "x_ddot=-1"), "noise of x_ddot must be a number of at least 0"),
        (("model.json", "bare.csv"), "no column 'x', 'u' in bare.csv: 'x' is a coordinate and 'u' is an input"),
        (("model.json", "no_input.csv"), "no column 'u' in no_input.csv: 'u' is an input of the model"),
        (("model.json", "none.csv"), "none.csv"),
        (("model.json", "log.csv", "--out", "log.csv"), "overwrite"),
    ],
)
def test_filter_refuses_with_one_message_and_writes_nothing(machine, arguments, said):
    log = oscillator(200)
    write("bare.csv", {"t": log["t"], "position": log["x"]})
    write("no_input.csv", {"t": log["t"], "x": log["x"]})
    assert said in machine.refused("filter", *arguments, *(() if "--out" in arguments else ("--out", "states.csv")))


def test_simulate_says_how_well_it_fits(machine):
    ended = machine("simulate", "model.json", "log.csv", "--out", "run.csv")
    assert ended.out.startswith("x: fit 9")
    assert float(ended.out.split("RMSE")[1]) == pytest.approx(NOISE, rel=0.05)
    given = machine("simulate", "model.json", "log.csv", "--initial", "x=1", "--initial", "x_dot=0.5")
    assert "x: fit 9" in given.err
    log = oscillator(200)
    write("input.csv", {"t": log["t"], "u": log["u"]})
    blind = machine("simulate", "model.json", "input.csv", "--initial", "x=1", "--initial", "x_dot=0.5")
    assert (blind.code, blind.err) == (0, "")


DATED = {
    "dates": ("2024-01-31 23:59:{:09.6f}", "2024-02-01 00:00:{:09.6f}"),
    "dates of a zone": ("2024-01-31 23:59:{:09.6f}Z", "2024-02-01 00:00:{:09.6f}Z"),
    "clocks": ("11:59:{:09.6f}", "12:00:{:09.6f}"),
    "days first": ("31.01.2024 23:59:{:09.6f}", "01.02.2024 00:00:{:09.6f}"),
}


@pytest.mark.parametrize("command", ["simulate", "filter"])
@pytest.mark.parametrize("form", DATED)
def test_times_that_were_dates_are_written_as_dates(machine, command, form):
    t, x, u = oscillator(1000, noise=NOISE, seed=3).values()
    before, after = DATED[form]
    texts = [before.format(40.0 + v) if v < 20.0 else after.format(v - 20.0) for v in t.tolist()]
    rows = [f"{stamp},{a!r},{b!r}" for stamp, a, b in zip(texts, x.tolist(), u.tolist(), strict=True)]
    Path("dated.csv").write_text("\n".join(["t,x,u", *rows]) + "\n")
    ended = machine(command, "model.json", "dated.csv", "--out", "out.csv")
    assert "columns: t as dates" in ended.out
    written = table(Path("out.csv").read_text())["t"].tolist()
    begin = texts[0].replace("31.01.2024", "2024-01-31").rstrip("Z").rstrip("0")
    assert written[0].rstrip("Z").rstrip("0") == begin
    assert written[0].endswith("Z") == (form == "dates of a zone")
    assert len({len(cell) for cell in written}) == 1
    day = "1970-01-01 " if form == "clocks" else ""
    spent = [
        np.datetime64(day + v.rstrip("Z"), "us") - np.datetime64(day + written[0].rstrip("Z"), "us") for v in written
    ]
    assert np.array(spent).astype(float) * 1e-6 == pytest.approx(t - t[0], abs=2e-6)


def test_what_simulate_and_filter_write_is_said_with_its_units(machine):
    known = json.loads(Path("model.json").read_text())
    known["coordinates"][0]["unit"] = "m"
    Path("model.json").write_text(json.dumps(known))
    t, x, u = oscillator(400, noise=NOISE, seed=3).values()
    write("ms.csv", {"time (ms)": 1e3 * t, "x": x, "u": u})
    for command in ("simulate", "filter"):
        said = machine(command, "model.json", "ms.csv", "--out", "out.csv").out
        assert "columns: time (ms) in ms, x in m, x_dot in m" in said


def test_simulate_asks_for_all_states_that_are_missing_at_once(machine):
    log = oscillator(200)
    write("input.csv", {"t": log["t"], "u": log["u"]})
    message = machine.refused("simulate", "model.json", "input.csv")
    assert "--initial x=... --initial x_dot=..." in message
    message = machine.refused("simulate", "model.json", "input.csv", "--initial", "x=1", "--out", "run.csv")
    assert "--initial x_dot=..." in message
    assert "--initial x=..." not in message


def test_validate_prints_a_table_and_writes_it_with_a_figure(machine):
    ended = machine("validate", "model.json", "unknown.json", "log.csv", "--out", "judged")
    assert ended.code == 0
    header, *lines = ended.out.splitlines()
    assert header.split() == ["model", "prediction", "coordinate", "fit,", "%", "RMSE", "valid", "time,", "s"]
    assert [line.split()[0] for line in lines] == ["model"] * 3 + ["unknown"] * 2
    assert "unknown: no one-step predictions" in ended.err
    found = table(Path("judged/validation.csv").read_text())
    assert list(found["prediction"]) == ["free run", "many starts", "one step", "free run", "many starts"]
    np.testing.assert_allclose(found["rmse"].astype(float), NOISE, rtol=0.15)
    assert Path("judged/free-runs.svg").read_text().count("<path") > 3
    assert Path("judged/free-runs.png").read_bytes()[:4] == b"\x89PNG"


def test_validate_takes_data_by_option_and_warns_outside_the_domain(machine):
    log = oscillator(600, noise=NOISE)
    write("wild.csv", log | {"u": log["u"] * 30.0})
    ended = machine("validate", "model.json", "--data", "wild.csv", "log.csv")
    assert ended.code == 0
    assert "model: u is from" in ended.err
    assert len(ended.out.splitlines()) == 4


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("log.csv",), "at least one model"),
        (("model.json",), "at least one data file"),
        (("model.json", "log.csv", "--noise", "y=1"), "'y' is no coordinate"),
        (("model.json", "model.json", "log.csv"), "named twice"),
        (("model.json", "other.json", "log.csv"), "same coordinates: model is about x, other about y"),
        (("model.json", "bare.csv"), "no column 'x', 'u' in bare.csv"),
        (("results", "log.csv"), "no such file or folder: results"),
        (("empty", "log.csv"), "empty holds no model.json"),
    ],
)
def test_validate_refuses_with_one_message_and_writes_nothing(machine, arguments, said):
    log = oscillator(200)
    write("bare.csv", {"t": log["t"], "position": log["x"]})
    Path("empty").mkdir()
    other = Path("model.json").read_text().replace('"x', '"y').replace('"name": "x"', '"name": "y"')
    Path("other.json").write_text(other)
    assert said in machine.refused("validate", *arguments, "--out", "judged")
