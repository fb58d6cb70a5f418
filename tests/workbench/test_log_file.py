"""What is drawn of a file is what is in it, whatever kind it is of."""

import numpy as np
import pyarrow as pa
import pytest
from pyarrow import parquet

pytest.importorskip("nicegui")

from odescope.errors import InputError
from odescope.workbench.log_file import open_log

T = np.round(0.01 * np.arange(20_000), 2)
X, N = np.round(np.sin(T), 6), np.arange(20_000) % 7


def table(path):
    words = ["on" if k % 3 else "off" for k in range(len(T))]
    made = pa.table({"time (ms)": T, "x [m]": X, "n": N, "word": words})
    if path.suffix == ".parquet":
        parquet.write_table(made, path, row_group_size=3000)
    else:
        rows = zip(T.tolist(), X.tolist(), N.tolist(), words, strict=True)
        path.write_text("time (ms),x [m],n,word\n" + "".join(f"{a!r},{b!r},{c},{d}\n" for a, b, c, d in rows))
    return path


@pytest.mark.parametrize("name", ["a.csv", "a.parquet"])
def test_columns_of_numbers_are_lines_over_the_time(tmp_path, name):
    log = open_log(table(tmp_path / name))
    assert (log.labels, log.rows) == (("time (ms)", "x [m]", "n", "word"), 20_000)
    assert log.axis == "time (s)"
    assert list(log.lines) == ["x [m]", "n"]
    for label, values in (("x [m]", X), ("n", N)):
        line = log.lines[label]
        np.testing.assert_array_equal(np.concatenate(line.ts), T / 1e3)
        np.testing.assert_array_equal(np.concatenate(line.ys), values)


def test_where_time_goes_back_lines_are_over_rows(tmp_path):
    path = tmp_path / "a.csv"
    path.write_text("t,x\n" + "".join(f"{k % 50},{k}\n" for k in range(200)))
    log = open_log(path)
    assert log.axis == "row"
    np.testing.assert_array_equal(np.concatenate(log.lines["x"].ts), np.arange(200.0))


def test_dates_are_seconds_from_the_first(tmp_path):
    path = tmp_path / "a.csv"
    path.write_text("date,x\n" + "".join(f"2026-11-22 13:05:{k:02d}.5,{k}\n" for k in range(60)))
    log = open_log(path)
    assert log.axis == "time from the first row (s)"
    np.testing.assert_allclose(np.concatenate(log.lines["x"].ts), np.arange(60.0), atol=1e-6)


def test_a_clock_goes_on_past_midnight_with_the_day_beside_it(tmp_path):
    path = tmp_path / "a.csv"
    rows = [
        f"2026-11-{22 + k // 30},{(23 + k // 30) % 24:02d}:{59 * (k < 30):02d}:{30 * (k < 30) + k % 30:02d},{k}"
        for k in range(60)
    ]
    path.write_text("date,time,x\n" + "\n".join(rows) + "\n")
    log = open_log(path)
    assert log.axis == "time from the first row (s)"
    np.testing.assert_allclose(np.concatenate(log.lines["x"].ts), np.arange(60.0), atol=1e-6)


def test_missing_cells_are_gaps(tmp_path):
    path = tmp_path / "a.csv"
    path.write_text("t,x\n" + "".join(f"{k},{'' if k == 5 else k}\n" for k in range(20)))
    t, x = open_log(path).lines["x"].window(0.0, 19.0, 100)
    np.testing.assert_array_equal(t, np.delete(np.arange(20.0), 5))
    np.testing.assert_array_equal(x, t)


def test_a_file_without_numbers_is_told(tmp_path):
    path = tmp_path / "a.csv"
    path.write_text("t,word\n0,a\n1,b\n")
    with pytest.raises(InputError, match=r"holds no numbers to draw; its columns are t, word"):
        open_log(path)
    with pytest.raises(InputError, match="no such file"):
        open_log(tmp_path / "b.csv")
