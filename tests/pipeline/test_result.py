"""A result in one's hands: its table, its methods, what it shows, and the same on the model read back."""

import os
import pickle

import numpy as np
import pandas as pd
import pytest
from logs import oscillator

import odescope
from odescope.errors import InputError
from odescope.study.library_options import Candidates
from odescope.study.options import Data, Driven, Measured, Study

LOG = oscillator()
HEADED = {"time (ms)": 1000.0 * LOG["t"], "x (mm)": LOG["x"], "u [V]": LOG["u"]}
STUDY = Study(
    data=Data(time="time"),
    coordinates={"x": Measured(order=2)},
    inputs={"u": Driven(hold="linear", delay=0.0)},
    library=Candidates(terms=("1", "x", "x_dot", "u", "x**2", "x_ddot")),
)


@pytest.fixture(scope="module")
def result():
    return odescope.identify(STUDY, pd.DataFrame(HEADED))


def test_the_table_says_what_was_simulated(result):
    table = pd.DataFrame(result.coefficients).set_index("term")
    truth = {"x": -4.0, "x_dot": -0.3, "u": 1.0}
    assert set(table.index) == set(truth)
    for term, value in truth.items():
        row = table.loc[term]
        assert abs(row.coefficient - value) < 4.0 * row.std_error
        assert row.lower < row.coefficient < row.upper
        assert row.z == row.coefficient / row.std_error


def test_milliseconds_and_units_in_headings_are_told(result):
    assert "time was recorded in ms: in files and notes it is in seconds" in result.notes
    assert (result.model.coordinates[0].unit, result.model.inputs[0].unit) == ("mm", "V")
    assert result.records.runs[0].duration == pytest.approx(LOG["t"][-1])


def test_a_result_shows_itself_on_a_screen(result):
    lines = repr(result).splitlines()
    assert len(lines) < 40
    assert lines[0].startswith("x_ddot = ")
    assert [line.split()[:3] for line in lines[1:4]] == [["#", "x_ddot", t] for t in ("x", "x_dot", "u")]
    assert lines[-1] == "time was recorded in ms: in files and notes it is in seconds"
    assert "<table><tr><th>equation</th>" in result._repr_html_()


def test_what_is_saved_is_read_back(result, tmp_path):
    result.save(str(tmp_path / "out"))
    assert sorted(os.listdir(tmp_path / "out")) == ["candidates.csv", "model.json", "path", "path.csv", "study.toml"]
    again = odescope.read_model(str(tmp_path / "out/model.json"))
    assert again.coefficients == result.coefficients
    assert repr(again) == repr(result.model)
    study = odescope.read_study(str(tmp_path / "out/study.toml"))
    assert study == result.study


def test_the_report_is_written_beside(result, tmp_path, monkeypatch):
    from logs import blank_painters

    monkeypatch.setattr("odescope.report.figures.processes.painters", blank_painters)
    result.write_report(str(tmp_path / "out"), "A mass")
    assert sorted(os.listdir(tmp_path / "out")) == ["figures", "report.html", "report.json"]
    assert "<title>A mass" in (tmp_path / "out/report.html").read_text(encoding="utf-8")
    result.save(tmp_path / "out")
    assert len(os.listdir(tmp_path / "out")) == 8


def test_new_data_may_be_records_frames_dicts_or_files(result, tmp_path):
    new = oscillator(seed=5)
    headed = {"time (ms)": 1000.0 * new["t"], "x (mm)": new["x"], "u [V]": new["u"]}
    plain = {"t": new["t"], "x": new["x"], "u": new["u"]}
    pd.DataFrame(headed).to_csv(tmp_path / "run.csv", index=False)
    layout = odescope.Layout(time="t", columns=(("x", "x"), ("u", "u")))
    records = odescope.records_from(plain, layout)
    model = odescope.from_json(odescope.to_json(result.model))
    judged = [model.validate(d) for d in (records, records.runs[0], list(records), headed, pd.DataFrame(headed), plain)]
    judged += [result.validate(d) for d in (str(tmp_path / "run.csv"), [tmp_path / "run.csv"])]
    fits = np.array([[row.fit for row in j.rows] for j in judged])
    assert fits.min() > 99.0
    assert np.ptp(fits, axis=0).max() < 1e-6
    states = [odescope.estimate_states(model, d).runs[0].states for d in (records, headed)]
    assert states[0] == pytest.approx(states[1], abs=1e-9)


def test_a_free_run_of_the_result(result):
    run = result.simulate(LOG["t"], {"u": LOG["u"]}, {"x": 1.0, "x_dot": 0.5})
    assert np.std(run.column("x") - LOG["x"]) < 1.5e-3


def test_files_may_be_given_in_place_of_those_of_the_study(tmp_path, result):
    pd.DataFrame(HEADED).to_csv(tmp_path / "run.csv", index=False)
    for given in (str(tmp_path / "run.csv"), [tmp_path / "run.csv"]):
        found = odescope.identify(STUDY, given)
        assert found.study.data.files == (str(tmp_path / "run.csv"),)
        assert odescope.to_text(found.model) == odescope.to_text(result.model)


@pytest.mark.parametrize(
    ("study", "data", "message"),
    [
        ("study.toml", None, "what is identified must be odescope.Study; a str came.*read_study"),
        ({"x": 2}, None, "what is identified must be odescope.Study; a dict came"),
        (STUDY, 3, "the data is an int; expected"),
        (STUDY, np.zeros((3, 2)), r"the data is an array of shape \(3, 2\); expected"),
        (STUDY, [HEADED, "run.csv"], "table 2 is a str; expected"),
        (STUDY, {"time": [0.0], "x": ["a"], "u": [1.0]}, "column 'x' in the data holds string, expected numbers"),
    ],
)
def test_what_is_of_the_wrong_kind_is_told_what_would_be_right(study, data, message):
    with pytest.raises(InputError, match=message):
        odescope.identify(study, data)


@pytest.mark.parametrize("data", [3, None, [3], "missing.csv", np.zeros(3)])
def test_validation_says_what_it_takes(result, data):
    missing = isinstance(data, str)
    message = "no such file" if missing else "data must be records, dataframes, dicts of columns, or paths of files"
    with pytest.raises(InputError, match=message):
        result.validate(data)


def test_a_result_goes_to_another_process_and_back_without_whom_it_told(result):
    heard = odescope.identify(STUDY, pd.DataFrame(HEADED), watch=lambda event: None)
    again = pickle.loads(pickle.dumps(heard))  # noqa: S301
    assert again.notes == heard.notes == result.notes
    assert odescope.to_text(again.model) == odescope.to_text(result.model)


@pytest.mark.parametrize("write", ["to_c", "to_latex", "to_mathml", "to_python", "to_text", "to_matlab", "to_julia"])
def test_what_writes_a_model_says_where_a_result_has_it(result, write):
    with pytest.raises(InputError, match=r"must be odescope.Model; an Identification came: pass its .model"):
        getattr(odescope, write)(result)
