"""Angles in degrees: converted where a study says so, pointed out where the log looks like it."""

import csv
import json
from pathlib import Path

import numpy as np
import pytest
from logs import oscillator, pendulum, write

from odescope.recordings.checks import degrees_hints, order_hints
from odescope.recordings.coordinate import Coordinate
from odescope.recordings.record import Record, Records, in_radians
from odescope.study.options import Data, Driven, LikelihoodSearch, Measured, Study

STUDY = """[data]
files = ["pend.csv"]
time = "t"
[likelihood]
enabled = false
[coordinates.theta]
order = 2
angle = true
unit = "deg"
[inputs.u]
"""


def log():
    t, theta, u = pendulum().values()
    return {"t": t, "theta": np.mod(np.rad2deg(theta), 360.0), "u": u}


def test_an_angle_in_degrees_is_converted_and_simulated_in_degrees(odescope):
    write("pend.csv", log())
    Path("s.toml").write_text(STUDY)
    ended = odescope("identify", "s.toml")
    assert ended.code == 0
    assert "theta was recorded in degrees: here it is in radians" in ended.err
    model = json.loads(Path("s/model.json").read_text())
    assert model["coordinates"][0]["unit"] == "rad"
    found = {t["term"]: t["coefficient"] for t in model["relations"][0]["terms"]}
    assert found["sin(theta)"] == pytest.approx(9.81, rel=0.02)
    assert found["u"] == pytest.approx(-1.0, rel=0.02)
    start = np.rad2deg([3.0, 2.0]).tolist()
    initial = [f"--initial=theta={start[0]!r}", f"--initial=theta_dot={start[1]!r}"]
    assert odescope("simulate", "s/model.json", "pend.csv", "--out", "run.csv", *initial).code == 0
    header, *rows = csv.reader(Path("run.csv").read_text().splitlines())
    assert header == ["t", "theta", "theta_dot"]
    run = np.array(rows, dtype=float)
    assert run[0, 1:] == pytest.approx(start)
    off = np.mod(run[:200, 1] - log()["theta"][:200] + 180.0, 360.0) - 180.0
    assert np.abs(off).max() < 1.0
    assert odescope("simulate", "s/model.json", "pend.csv", "--out", "own.csv").code == 0  # a start of its own
    own = np.loadtxt("own.csv", delimiter=",", skiprows=1)
    assert own[0, 1:] == pytest.approx(start, abs=3.0)


def test_degrees_by_a_heading_are_converted_and_others_pointed_out_before_a_search(odescope):
    t, theta, u = pendulum().values()
    swing = np.rad2deg(theta - theta.mean()) * 60.0 / np.rad2deg(np.ptp(theta))
    write("named.csv", {"t": t, "theta_deg": np.rad2deg(theta), "u": u})
    write("bare.csv", {"t": t, "theta": swing, "u": u})
    library = '[library]\nbasis = ["sin(theta)", "theta_dot", "u"]\ndegree = 1\n'
    for name in ("named", "bare"):
        said = STUDY.replace('unit = "deg"\n', "").replace("pend.csv", f"{name}.csv")
        Path(f"{name}.toml").write_text(said + library)
    named = odescope("identify", "named.toml")
    assert named.code == 0
    assert "theta was recorded in degrees: here it is in radians" in named.err
    bare = odescope("identify", "bare.toml")
    assert bare.code == 3
    first = next(line for line in bare.err.splitlines() if line.startswith(("warning", "advice", "odescope")))
    assert first.startswith("warning: theta goes")
    assert 'give unit = "deg" in [coordinates.theta]' in first


def test_noise_is_given_and_told_in_the_unit_of_the_column(odescope):
    data, noise = log(), 0.5
    data["theta"] = data["theta"] + noise * np.random.default_rng(0).standard_normal(len(data["theta"]))
    write("pend.csv", data)
    Path("s.toml").write_text(STUDY)
    assert odescope("identify", "s.toml").code == 0
    ended = odescope(
        "filter", "s/model.json", "pend.csv", "--noise", f"theta={noise}", "--process-noise", "theta_ddot=2"
    )
    assert "measurement noise: theta 0.5 deg\n" in ended.err
    assert "theta_ddot 2 deg s⁻²\n" in ended.err
    assert "innovations of theta: 0.5" in ended.err
    squared = ended.err.partition("normalised innovations squared: ")[2].partition(" ")[0]
    assert float(squared) == pytest.approx(1.0, abs=0.2)
    checked = odescope("validate", "s/model.json", "--data", "pend.csv", "--noise", f"theta={noise}")
    assert checked.code == 0


def test_the_study_that_was_resolved_says_degrees_again(odescope):
    write("pend.csv", log())
    Path("s.toml").write_text(STUDY)
    assert odescope("identify", "s.toml").code == 0
    Path("again.toml").write_text(Path("s/study.toml").read_text().replace("../", ""))
    assert odescope("identify", "again.toml").code == 0
    assert (
        json.loads(Path("again/model.json").read_text())["relations"]
        == (json.loads(Path("s/model.json").read_text())["relations"])
    )


def test_records_in_memory_are_converted_once():
    t = 0.1 * np.arange(50)
    run = Record(t, np.column_stack([10.0 * t, t]), ("theta", "x"), ("deg", "m"))
    once = in_radians(run, {"theta"})
    assert once.units == ("rad", "m")
    np.testing.assert_allclose(once.column("theta"), np.deg2rad(10.0 * t))
    np.testing.assert_array_equal(once.column("x"), t)
    assert in_radians(once, {"theta"}) is once


def test_only_angles_are_converted():
    study = Study(
        data=Data(time="t"),
        coordinates={"a": Measured(unit="Deg", angle=True), "b": Measured(unit="deg")},
        inputs={"c": Driven(unit="deg")},
        likelihood=LikelihoodSearch(enabled=False),
    )
    assert study.layout().degrees == {"a"}
    assert [c.unit for c in study.measured()] == ["rad", "deg"]
    assert study.driven()[0].unit == "deg"


@pytest.mark.parametrize(
    ("angle", "unit", "hinted"),
    [
        (lambda t: 60.0 * np.sin(t), None, True),
        (lambda t: 60.0 * np.sin(t), "rad", False),
        (lambda t: 3.0 * np.sin(t), None, False),
        (lambda t: 20.0 * t, None, False),  # turns on and on
        (lambda t: 900.0 * np.sin(t), None, False),
    ],
)
def test_a_range_that_degrees_would_have_is_pointed_out(angle, unit, hinted):
    t = 0.01 * np.arange(1000)
    records = Records.of(Record(t, angle(t)[:, None], ("phi",)))
    said = degrees_hints(records, [Coordinate("phi", 2, angle=True, unit=unit)])
    assert bool(said) is hinted
    assert all('unit = "deg" in [coordinates.phi]' in line for line in said)


@pytest.mark.slow
def test_a_position_whose_equation_is_of_order_1_is_pointed_out(odescope):
    t, x, u = oscillator(600).values()
    write("run.csv", {"time (ms)": 1e3 * t, "x (mm)": x, "u": u})
    options = '[likelihood]\nbudget = 0.2\n[coordinates.x]\nunit = "m"\n[inputs.u]\nhold = "linear"\n'
    Path("s.toml").write_text(f'[data]\nfiles = ["run.csv"]\ntime = "time"\n{options}')
    ended = odescope("identify", "s.toml")
    assert "of order 1: if it is a position that forces move, give order = 2 in [coordinates.x]" in ended.err
    Path("s.toml").write_text(Path("s.toml").read_text().replace("[coordinates.x]", "[coordinates.x]\norder = 2"))
    ended = odescope("identify", "s.toml")
    assert ended.code == 0
    assert "of order 1" not in ended.err
    assert "'x (mm)' says mm, and the study m" in ended.err
    assert odescope("report", "s/report.html").code == 0
    ended = odescope("validate", "s", "run.csv")
    assert (ended.code, ended.out.count("free run")) == (0, 1)


def test_only_a_length_or_an_angle_of_order_1_may_be_a_position():
    assert order_hints([Coordinate("level", unit="bar"), Coordinate("x", 2, unit="mm")]) == ()
    (said,) = order_hints([Coordinate("x", unit="mm"), Coordinate("T", unit="K")])
    assert said.startswith("the equation of x, in mm, is of order 1")
