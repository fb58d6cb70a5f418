"""A study of a long log is drafted from parts of it, and says what one from the whole would."""

from pathlib import Path

import numpy as np
import pyarrow as pa
import pytest
from pyarrow import csv, parquet

from odescope.study import looked_at
from odescope.study.draft import draft
from odescope.study.toml import parse_study

ROWS, PART = 120_000, 5000
T = np.round(0.01 * np.arange(ROWS), 2)


@pytest.fixture
def long(monkeypatch):
    """A log is long from 60 000 rows on."""
    monkeypatch.setattr(looked_at, "MOST_ROWS", 60_000)
    monkeypatch.setattr(looked_at, "PART_ROWS", PART)


def written(path, columns):
    table = pa.table(columns)
    if path.suffix == ".parquet":
        parquet.write_table(table, path, row_group_size=20_000)
    else:
        csv.write_csv(table, path)
    return path


def drafted(path):
    return draft([path], [path], path.parent)


def without_rows(found):
    """The text of a draft but for the line that says how much there is."""
    return [line for line in found.text.splitlines() if "samples" not in line]


@pytest.mark.parametrize("name", [pytest.param("a.csv", marks=pytest.mark.slow), "a.parquet"])
def test_the_draft_of_parts_is_that_of_the_whole(tmp_path, monkeypatch, name):
    rng = np.random.default_rng(0)
    x = np.sin(T) + 0.3 * np.sin(2.9 * T) + 1e-4 * rng.standard_normal(ROWS)
    columns = {
        "time (ms)": 1000.0 * T,
        "x [mm]": x,
        "pos_rate": np.gradient(x, 0.01),
        "u": np.repeat(rng.standard_normal(ROWS // 100), 100),
        "note": ["fine"] * ROWS,
        "lap": np.repeat(["a", "b", "c"], ROWS // 3),
        "zero": np.zeros(ROWS),
        "heading": np.mod(0.3 * T + 0.2 * np.sin(T), 2.0 * np.pi),
    }
    path = written(tmp_path / name, columns)
    whole = drafted(path)
    monkeypatch.setattr(looked_at, "MOST_ROWS", 60_000)
    monkeypatch.setattr(looked_at, "PART_ROWS", PART)
    parts = drafted(path)
    assert without_rows(parts) == without_rows(whole)
    assert whole.sampled.startswith(f"{ROWS} samples in 3 recordings, one every 0.01 s")
    assert (
        parts.sampled
        == f"{ROWS} samples, one every 0.01 s, about 1200 s in all; 40000 of them, in 8 parts, were looked at"
    )
    study = parse_study(parts.text)
    assert (set(study.coordinates), set(study.inputs), study.data.recording) == ({"x", "heading"}, {"u"}, "lap")


def test_a_command_that_rests_in_all_parts_is_an_input(tmp_path, long):
    columns = {"t": T, "y": np.sin(T), "brake": np.zeros(ROWS), "ok": np.ones(ROWS)}
    columns["brake"][20_000:21_000] = 1.0  # between the second part and the third
    found = drafted(written(tmp_path / "a.csv", columns))
    assert [(s.name, s.role) for s in found.seen] == [("y", "coordinate"), ("brake", "input"), ("ok", "neither")]
    assert 'brake = { hold = "zero" }' in found.text


def test_what_tells_recordings_apart_is_what_they_were_made_at_but_no_number_of_theirs(tmp_path, long):
    lap = np.arange(ROWS) // (ROWS // 3)
    columns = {"t": T % (ROWS / 300), "y": np.sin(T), "lap": lap, "mass": 1.0 + 0.5 * (lap == 1), "n": lap + 1}
    found = drafted(written(tmp_path / "a.csv", columns))
    assert parse_study(found.text).data.recording == "lap"
    assert [(s.name, s.role) for s in found.seen] == [("y", "coordinate"), ("mass", "input"), ("n", "neither")]


def test_a_clock_that_nobody_calls_one_is_known_by_its_even_steps(tmp_path, long):
    found = drafted(written(tmp_path / "a.csv", {"k": T, "y": np.sin(T)}))
    assert parse_study(found.text).data.time == "k"


def test_a_compressed_log_is_looked_at_whole(tmp_path, long):
    import gzip

    path = Path(tmp_path / "a.csv.gz")
    path.write_bytes(gzip.compress(written(tmp_path / "b.csv", {"t": T, "y": np.sin(T)}).read_bytes(), 1))
    assert drafted(path).sampled.startswith(f"{ROWS} samples in 1 recording")


@pytest.mark.parametrize("length", [1, 2])
def test_faults_among_numbers_are_missing_cells_in_a_part_and_in_the_whole(tmp_path, long, length):
    rows = ROWS // length if length == 1 else 20_000
    columns = {"t": T[:rows], "y": np.sin(T[:rows]).astype(str), "brake": np.zeros(rows).astype(str)}
    columns["y"][3000] = columns["brake"][3000] = "err"
    columns["brake"][rows // 4 : rows // 4 + 1000] = "1.0"
    found = drafted(written(tmp_path / "a.csv", columns))
    assert [(s.name, s.role) for s in found.seen] == [("y", "coordinate"), ("brake", "input")]
    assert "#   y: has cells that are not numbers (line 3002: 'err'); empty" in found.text


def test_another_file_with_faults_is_not_looked_at(tmp_path):
    for name, cell in (("a.csv", "0.5"), ("b.csv", "0.5"), ("c.csv", "err")):
        cells = np.sin(T[:2000]).astype(str)
        cells[7] = cell
        written(tmp_path / name, {"t": T[:2000], "y": cells})
    files = [tmp_path / name for name in ("a.csv", "b.csv", "c.csv")]
    found = draft(files, files, tmp_path)
    assert found.sampled.startswith("a.csv, b.csv: 4000 samples")
    assert "CHANGE" not in found.text
    found = draft(files[::-1], files[::-1], tmp_path)
    assert found.sampled.startswith("5999 samples in 3 recordings")
    assert "#   y: has cells that are not numbers (line 9: 'err')" in found.text
