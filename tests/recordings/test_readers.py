from dataclasses import replace

import numpy as np
import pandas as pd
import pyarrow as pa
import pytest
from pyarrow import parquet
from scipy.io import savemat

from odescope.errors import InputError
from odescope.recordings.layout import Layout
from odescope.recordings.readers import read_records, records_from

LAYOUT = Layout(time="t", columns=(("x", "x"), ("u", "force")))
N = 30
T, X, U = np.arange(N) * 0.5, np.sin(np.arange(N)), np.cos(np.arange(N))
TABLE = {"t": T, "x": X, "note": np.array(["ok"] * N), "force": U}


def write(folder, text, name="run1.csv"):
    path = folder / name
    path.write_bytes(text if isinstance(text, bytes) else "\n".join(text).encode())
    return path


def write_table(folder, rows=N):
    path = folder / f"run{rows}.csv"
    pd.DataFrame(TABLE).head(rows).to_csv(path, index=False)
    return path


def check(records):
    (run,) = records
    assert (run.names, len(run)) == (("x", "u"), N)
    assert np.allclose(run.t, T, rtol=0, atol=1e-12)
    assert np.array_equal(run.values, np.column_stack([X, U]))


def refused(folder, text, message, layout=LAYOUT, name="run1.csv"):
    with pytest.raises(InputError, match=message) as caught:
        read_records([write(folder, text, name)], layout)
    assert name in str(caught.value)


# files, recordings and samples


def test_several_files_are_several_recordings(tmp_path):
    files = [write_table(tmp_path, rows) for rows in (20, 30)]
    records = read_records(files, LAYOUT)
    assert [(len(run), run.source) for run in records] == [(20, "run20.csv"), (30, "run30.csv")]


def test_units_and_sample_period(tmp_path):
    layout = Layout(sample_period=0.25, columns=LAYOUT.columns, units=(("u", "N"),))
    (run,) = read_records([write_table(tmp_path)], layout)
    assert run.units == (None, "N")
    assert np.array_equal(run.t, 0.25 * np.arange(N))


def test_recordings_within_a_file_keep_their_first_order_and_row_order(tmp_path):
    text = ["lap,t,x", *(f"{'ba'[k % 3 % 2]},{k},{k * k}" for k in range(60))]
    first = np.array([k for k in range(60) if k % 3 != 1])
    layout = Layout(sample_period=1.0, columns=(("x", "x"),), recording="lap")
    runs = list(read_records([write(tmp_path, text)], layout))
    assert [run.source for run in runs] == ["run1.csv (lap b)", "run1.csv (lap a)"]
    assert np.array_equal(runs[0].column("x"), first**2)
    assert np.array_equal(runs[1].column("x"), np.arange(1, 60, 3) ** 2)


def test_an_empty_label_is_refused(tmp_path):
    text = ["lap,t,x", *(f"{'a' * (k != 4)},{k},{k * k}" for k in range(20))]
    refused(tmp_path, text, "'lap' in run1.csv has empty cells", Layout("t", columns=(("x", "x"),), recording="lap"))


def test_rows_of_gaps_count_through_the_whole_file(tmp_path):
    text = ["lap,t,x", *(f"{k // 20},{k},{'NA' if k in (25, 26) else k}" for k in range(40))]
    layout = Layout("t", columns=(("phi", "x"),), recording="lap", gaps="refuse")
    refused(tmp_path, text, r"column 'x' has 1 gap \(data rows 26-27\) in run1.csv \(lap 1\)", layout)


def test_angles_are_unwrapped_within_pieces_and_jitter_resampled(tmp_path):
    rng = np.random.default_rng(1)
    t = 0.01 * (np.arange(200) + rng.uniform(-0.03, 0.03, 200))
    angle = 9 * t + np.sin(8 * t)
    wrapped = np.angle(np.exp(1j * angle))
    wrapped[100] = np.nan
    pd.DataFrame({"t": t, "a": wrapped}).to_csv(tmp_path / "run.csv", index=False)
    layout = Layout("t", columns=(("phi", "a"),), angles=frozenset({"phi"}), gaps="split")
    runs = list(read_records([tmp_path / "run.csv"], layout))
    assert [len(run) for run in runs] == [100, 99]
    for run in runs:
        off = run.column("phi") - (9 * run.t + np.sin(8 * run.t))
        assert np.abs(off - 2 * np.pi * np.rint(off[0] / 2 / np.pi)).max() < 1e-5


def test_an_angle_in_degrees_is_refused(tmp_path):
    text = ["t,a", *(f"{k},{(20 * k) % 360}" for k in range(40))]
    layout = Layout("t", columns=(("phi", "a"),), angles=frozenset({"phi"}))
    refused(tmp_path, text, "'phi' jumps by about 360 in run1.csv .* looks like degrees", layout)


@pytest.mark.parametrize(
    ("rows", "message"),
    [
        (["1,inf,3", "2,1,4"], r"'x' is not a finite number in data row 1"),
        (["0,1,3", "1,1,4", "1,2,3"], r'time repeats at data row 3 \(1, then 1\) .*recording = "..."'),
        (["0,1,3"], "1 of 1 cells of 'x' hold numbers"),
        ([f"7,{k},2" for k in range(20)], "time is 7 in every row in run1.csv; name the column"),
        ([f"{k % 50},{k},2" for k in range(100)], "time goes back at data row 51 .*several runs share the file"),
    ],
)
def test_runs_that_do_not_serve_are_refused_by_the_name_of_their_file(tmp_path, rows, message):
    refused(tmp_path, ["t,x,force", *rows], message)


def test_gaps_and_jitter_are_refused_where_that_is_asked_for(tmp_path):
    layout = replace(LAYOUT, gaps="refuse")
    refused(tmp_path, ["t,x,force", *(f"{k * k},1,2" for k in range(20))], "time has .* gap", layout)
    rows = [f"{k + k % 2 / 3},{k},2" for k in range(20)]
    refused(tmp_path, ["t,x,force", *rows], "sampling is not uniform", replace(LAYOUT, jitter=0.05))


def test_bad_paths(tmp_path):
    with pytest.raises(InputError, match=r"no such file: .*gone\.csv"):
        read_records([tmp_path / "gone.csv"], LAYOUT)
    with pytest.raises(InputError, match="is a directory"):
        read_records([tmp_path], LAYOUT)
    with pytest.raises(InputError, match="no data file"):
        read_records([], LAYOUT)
    refused(tmp_path, b"1", r"no known kind; expected one of \.csv, .*\.mat", name="run.xlsx")


# other kinds of files


def test_parquet(tmp_path):
    parquet.write_table(pa.table(TABLE), tmp_path / "run.parquet")
    check(read_records([tmp_path / "run.parquet"], LAYOUT))


def test_bad_parquet(tmp_path):
    refused(tmp_path, b"PAR1 nothing", "cannot be read", name="run.parquet")
    parquet.write_table(pa.table({**TABLE, "x": TABLE["note"]}), tmp_path / "text.parquet")
    with pytest.raises(InputError, match=r"'x' in text\.parquet holds string, expected numbers"):
        read_records([tmp_path / "text.parquet"], LAYOUT)
    with pytest.raises(InputError, match=r"no column 'y' in text\.parquet"):
        read_records([tmp_path / "text.parquet"], Layout("t", columns=(("y", "y"),)))


@pytest.mark.parametrize("shape", ["row", "column"])
def test_matlab(tmp_path, shape):
    savemat(tmp_path / "run.mat", {**TABLE, "settings": {"gain": 3}}, oned_as=shape)
    check(read_records([tmp_path / "run.mat"], LAYOUT))


@pytest.mark.parametrize(
    ("variables", "message"),
    [
        ({"log": {"t": T, "x": X, "force": U}}, r"no variable 't' in run\.mat; 'log' is a 1x1 struct: .*-struct"),
        ({"t": T, "x": np.column_stack([X, X]), "force": U}, r"in run\.mat, 'x' is a 30x2 double: save each column"),
        ({"t": T, "x": X, "Force": U}, r"no column 'force' in run\.mat; did you mean 'Force'\?"),
        ({"t": T, "x": X[:-1], "force": U}, r"run\.mat differ in length: 't' 30, 'x' 29, 'force' 30"),
        ({"t": T, "x": X * 1j, "force": U}, r"'x' in run\.mat is not a column of numbers"),
        ({"t": T, "x": np.array(list(X), dtype=object), "force": U}, r"'x' is a 1x30 cell"),
    ],
)
def test_bad_matlab_variables(tmp_path, variables, message):
    savemat(tmp_path / "run.mat", variables)
    with pytest.raises(InputError, match=message):
        read_records([tmp_path / "run.mat"], LAYOUT)


def test_bad_matlab_files(tmp_path):
    refused(tmp_path, b"nothing of the kind" * 20, "cannot be read as a MATLAB file", name="run.mat")
    header = b"MATLAB 7.3 MAT-file".ljust(124) + b"\x00\x02IM" + bytes(512)
    refused(tmp_path, header, "MATLAB 7.3 file; save it with", name="new.mat")
    savemat(tmp_path / "whole.mat", TABLE)
    refused(tmp_path, (tmp_path / "whole.mat").read_bytes()[:300], "no column 'x' in cut.mat", name="cut.mat")


# data in memory


@pytest.mark.parametrize("wrap", [pd.DataFrame, pa.table, dict, lambda table: pd.DataFrame(table).set_index("t")])
def test_tables_in_memory(wrap):
    check(records_from(wrap(TABLE), LAYOUT))


def test_lists_of_tables_and_column_arrays():
    runs = list(records_from([pd.DataFrame(TABLE), {key: column[:20, None] for key, column in TABLE.items()}], LAYOUT))
    assert [(len(run), run.source) for run in runs] == [(30, "table 1"), (20, "table 2")]


def test_categories_and_numbers_label_recordings():
    lap = np.repeat([7, 3], 15)
    for labels in (lap, pd.Categorical(lap)):
        layout = Layout(sample_period=1.0, columns=LAYOUT.columns, recording="lap")
        runs = list(records_from(pd.DataFrame({**TABLE, "lap": labels}), layout))
        assert [run.source for run in runs] == ["the data (lap 7)", "the data (lap 3)"]
        assert np.array_equal(runs[1].column("x"), X[15:])


@pytest.mark.parametrize("unit", ["ms", "us", "ns"])
def test_dates_are_times(unit):
    dates = np.datetime64("2026-11-22T13:05:00", unit) + (1000 * T).astype("m8[ms]").astype(f"m8[{unit}]")
    for data in ({**TABLE, "t": dates}, pd.DataFrame({**TABLE, "t": dates}), pa.table({**TABLE, "t": dates})):
        (run,) = records_from(data, LAYOUT)
        assert run.t - run.t[0] == pytest.approx(T, abs=1e-6)
        assert run.t[0] == pytest.approx(1795352700.0)


def test_dates_in_a_table_may_be_text():
    seconds = np.arange(N)
    text = [f"31.01.2024 08:00:{k:02}" for k in seconds.tolist()]
    for data in (pd.DataFrame({**TABLE, "t": text}), pa.table({**TABLE, "t": text}), {**TABLE, "t": text}):
        (run,) = records_from(data, LAYOUT)
        assert run.t == pytest.approx(1706688000.0 + seconds, abs=1e-6)
    text[5] = "01/02/2024 08:00:05"
    with pytest.raises(InputError, match="'t' in the data holds text that is no time, such as '01/02/2024"):
        records_from(pd.DataFrame({**TABLE, "t": text}), LAYOUT)


def test_kinds_of_numbers_become_floats():
    data = {"t": np.arange(20, dtype=">i4"), "x": np.arange(20) % 2 == 0, "force": np.arange(20, dtype=np.float16)}
    (run,) = records_from(data, LAYOUT)
    assert np.array_equal(run.values, np.column_stack([np.arange(20) % 2 == 0, np.arange(20)]))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"x": np.ma.masked_all(N)}, r"0 of 30 cells of 'x' hold numbers in the data"),
        ({"x": np.arange(N) + 2**60}, "'x' in the data does not fit 64-bit floats"),
        ({"x": TABLE["note"]}, "'x' in the data holds string, expected numbers"),
        ({"x": [[1], [2, 3]]}, "'x' in the data is not a column of numbers"),
        ({"x": np.zeros((N, 2))}, r"'x' in the data is an array of shape \(30, 2\)"),
        ({"x": X[1:]}, "differ in length"),
        ({"x": np.arange(N).astype("M8[s]")}, r"'x' in the data holds timestamp\[s\]"),
    ],
)
def test_bad_mappings(change, message):
    with pytest.raises(InputError, match=message):
        records_from({**TABLE, **change}, LAYOUT)


@pytest.mark.parametrize(
    ("data", "message"),
    [
        ([], "expected at least one table"),
        ("run1.csv", "the data is a str; expected a dataframe"),
        (pd.DataFrame([[1, 2, 3, 4]], columns=["t", "x", "x", "force"]), "cannot be read as a table: Duplicate"),
        (pa.table([T, X, X, U], ["t", "x", "x", "force"]), "has 2 columns named 'x'"),
        (pd.DataFrame(TABLE).head(0), "no rows of data"),
        (pd.DataFrame({**TABLE, "x": [None] * N}), r"0 of 30 cells of 'x' hold numbers"),
        ({}, "no column 't' in the data; there are none"),
    ],
)
def test_bad_tables(data, message):
    with pytest.raises(InputError, match=message):
        records_from(data, LAYOUT)


# the layout


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({}, "exactly one of time .* and sample_period .*; neither came: .odescope init FILE. drafts"),
        ({"time": "t", "sample_period": 0.1}, "exactly one of time .*; both came"),
        ({"sample_period": 0.0}, "sample_period must be a positive number, got 0.0"),
        ({"sample_period": float("nan")}, "sample_period must be a positive number"),
        ({"time": "t", "columns": ()}, "no column to read"),
        ({"time": "t", "gaps": "fill"}, "'bridge', 'split' or 'refuse', got 'fill'"),
        ({"time": "t", "jitter": -0.5}, "jitter must be a number of sample periods, 0 or more, got -0.5"),
        ({"time": "t", "angles": frozenset({"X"})}, r"names 'X', which is not among its columns; did you mean 'x'\?"),
    ],
)
def test_layouts_that_contradict_themselves(fields, message):
    with pytest.raises(InputError, match=message):
        Layout(**{"columns": (("x", "x"),), **fields})
