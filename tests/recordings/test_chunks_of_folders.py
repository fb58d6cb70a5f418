"""Chunks of folders, files that are refused, and the memory that reading takes."""

import gzip
import subprocess
import sys

import numpy as np
import pyarrow as pa
import pyarrow.csv
import pytest
from chunk_cases import (
    FORCE,
    LAPS,
    LAYOUT,
    TABLE,
    TEXTS,
    N,
    own,
    refused,
    samples,
    stretches,
    write,
    write_parquet,
)
from pyarrow import parquet
from scipy.io import savemat

from odescope.errors import InputError
from odescope.recordings.chunks import cut
from odescope.recordings.layout import Layout
from odescope.recordings.readers import column_names, find_files, read_chunk, read_records, survey

pytestmark = pytest.mark.usefixtures("_small_steps")


def test_folders_stand_for_their_parquet_files(tmp_path):
    names = (
        "b/lap=2/part-0.parquet",
        "b/lap=1/part-1.PQ",
        "b/lap=1/part-0.parquet",
        "b/_notes/c.parquet",
        "b/.a.parquet",
    )
    for name in names:
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        write_parquet(tmp_path, TABLE, name=name)
    (tmp_path / "b/readme.txt").write_text("what this is")
    (tmp_path / "b/_notes/none").mkdir()
    single = write_parquet(tmp_path, TABLE)
    found = find_files([tmp_path / "b", single])
    assert found == (*(tmp_path / name for name in (names[2], names[1], names[0])), single)
    layout = Layout("t", columns=LAYOUT.columns, recording="lap")
    sources = [run.source for run in read_records([tmp_path / "b"], layout)]
    assert sources == [
        f"lap={n}/{file} (lap {n})" for n, file in ((1, "part-0.parquet"), (1, "part-1.PQ"), (2, "part-0.parquet"))
    ]
    assert column_names(tmp_path / "b") == ("t", "x", "note", "force")
    with pytest.raises(InputError, match=r"is a directory without data files \(\.csv, .*\.parquet, "):
        find_files([single, tmp_path / "b/_notes/none"])


def test_a_folder_without_parquet_stands_for_the_first_kind_of_data_files_in_itself(tmp_path):
    for name in ("run2.csv", "run1.CSV", "notes.txt", "_old.csv", "run1/candidates.csv"):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_text("t,x\n0,1\n")
    assert [f.name for f in find_files(tmp_path)] == ["run1.CSV", "run2.csv"]
    assert find_files(str(tmp_path)) == find_files([tmp_path])
    for name in ("run2.csv", "run1.CSV"):
        (tmp_path / name).unlink()
    assert [f.name for f in find_files(tmp_path)] == ["notes.txt"]
    with pytest.raises(InputError, match=r"a data file is named by its path, as text or pathlib.Path; an int came"):
        find_files([3])


def test_a_pattern_stands_for_the_files_that_match_in_order(tmp_path):
    for name in ("run10.csv", "run02.csv", "run1.csv", "other.csv"):
        (tmp_path / name).touch()
    assert [f.name for f in find_files([tmp_path / "run*.csv"])] == ["run02.csv", "run1.csv", "run10.csv"]
    assert [f.name for f in find_files([tmp_path / "run**.csv"])] == ["run02.csv", "run1.csv", "run10.csv"]
    assert [f.name for f in find_files([tmp_path / "run?.csv", tmp_path / "other.csv"])] == ["run1.csv", "other.csv"]
    (tmp_path / "run*.csv").touch()  # a file of that very name is meant itself
    assert find_files([tmp_path / "run*.csv"]) == (tmp_path / "run*.csv",)
    with pytest.raises(InputError, match=r"no file matches 'walk\*\.csv' in "):
        find_files([tmp_path / "walk*.csv"])
    with pytest.raises(InputError, match=r"a data file cannot be called 'run\\x00\.csv'"):
        find_files(["run\0.csv"])


def test_a_folder_names_the_recording_of_a_whole_file(tmp_path):
    for folder, label in (("lap=a%20b", "a b"), ("lap=7/half=1", "7"), ("lap=8/lap=4", "4"), ("lap=x=1", "x=1")):
        (tmp_path / folder).mkdir(parents=True)
        path = write_parquet(tmp_path, TABLE, name=f"{folder}/run.parquet")
        parts = stretches(path, LAPS, 100, 20)
        assert {part.record.source for part in parts} == {f"run.parquet (lap {label})"}
        assert own(parts).tobytes() == samples(path, LAPS).tobytes()
    own_column = write_parquet(tmp_path, {**TABLE, "lap": ["in"] * N}, name="lap=7/run.parquet")
    assert next(iter(read_records([own_column], LAPS))).source == "run.parquet (lap in)"
    refused(write_parquet(tmp_path, TABLE), LAPS, "no column 'lap' in run.parquet")
    (tmp_path / "lap=__HIVE_DEFAULT_PARTITION__").mkdir()
    nameless = write_parquet(tmp_path, TABLE, name="lap=__HIVE_DEFAULT_PARTITION__/run.parquet")
    refused(nameless, LAPS, "'lap' in run.parquet has empty cells")


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda lines: [*lines[:280], "70,x1,ok,1", *lines[281:]], r"'x' .* not numbers \(line 281: 'x1'\); empty"),
        (lambda lines: [*lines[:201], "s,m,,N", *lines[202:]], r"'t' .* not numbers \(line 202: 's'\); empty"),
        (lambda lines: [lines[0], "s,m,,N", *lines[1:]], r"'t' .* not numbers \(line 2: 's'\); delete that line"),
        (
            lambda lines: [*lines[:280], "70,1,2", *lines[281:]],
            r"line 281 of run1.csv has 3 cells where the header has 4",
        ),
        (lambda lines: [*lines[:280], "", "70,1,2", *lines[281:]], "line 282 of run1.csv has 3 cells"),
        (lambda lines: ["", *lines[:280], "70,inf,ok,1", *lines[281:]], "'x' is not a finite number in data row 280"),
        (lambda lines: ["a,b", "1,2"], "no column 't' in run1.csv"),
        (lambda lines: [lines[0], "", ""], "column names but no rows"),
        (lambda lines: [""], "is empty"),
    ],
)
def test_faults_of_text_are_told_by_their_line_in_the_file(tmp_path, change, message):
    refused(write(tmp_path, "\n".join(change(TEXTS["plain"].splitlines()))), LAYOUT, message)


def test_a_cell_over_several_lines_is_refused(tmp_path):
    lines = TEXTS["plain"].splitlines()
    lines[250] = lines[250].replace("ok", '"o\nk"')
    refused(write(tmp_path, "\n".join(lines)), LAYOUT, "rows where .* were counted, .* goes over several lines")


def test_one_decimal_mark_serves_the_whole_file(tmp_path):
    whole = ["t;x;force", *(f"{k};{k};{k}" for k in range(200))]  # says nothing of the mark
    for mark, other in (".,", ",."):
        numbers = [f"{k};1{mark if k < 320 else other}500;1" for k in range(200, 400)]
        path = write(tmp_path, "\n".join([*whole, *numbers]))
        with pytest.raises(InputError, match="not numbers"):
            read_records([path], LAYOUT)
        refused(path, LAYOUT, rf"'x' .* not numbers \(line 322: '1\{other}500'", rows=80)
    path = write(tmp_path, "\n".join(whole))
    assert own(stretches(path, LAYOUT, 50)).tobytes() == samples(path, LAYOUT).tobytes()


@pytest.mark.parametrize("end", ["\n", "\r\n", "\r"])
def test_a_blank_line_without_a_time_column_is_a_lost_sample(tmp_path, end):
    layout = Layout(sample_period=1.0, columns=LAYOUT.columns)
    lines = TEXTS["plain"].splitlines()
    refused(write(tmp_path, end.join([*lines[:200], "", *lines[200:]])), layout, "line 201 of run1.csv is blank")
    assert survey(write(tmp_path, end.join([*lines, "", "", ""])), layout).rows == N


def test_spaces_alone_are_a_row_as_they_are_to_arrow(tmp_path):
    path = write(tmp_path, "x\n" + "\n".join(["1", " "] * 40))
    layout = Layout(sample_period=1.0, columns=(("x", "x"),), gaps="refuse")
    assert survey(path, layout).rows == 80
    refused(path, layout, r"'x' has 10 gaps \(data rows 2, 4, ", rows=20)


def test_files_that_change_meanwhile_are_refused(tmp_path):
    path = write_parquet(tmp_path, TABLE)
    late = cut(survey(path, LAYOUT), 100)[2]
    write_parquet(tmp_path, {name: column[:150] for name, column in TABLE.items()})
    with pytest.raises(InputError, match=r"run.parquet has 150 rows where 300 were counted"):
        read_chunk(late, LAYOUT)
    path = write(tmp_path, TEXTS["plain"])
    late = cut(survey(path, LAYOUT), 100)[2]
    write(tmp_path, "\n".join(TEXTS["plain"].splitlines()[:250]))
    with pytest.raises(InputError, match=r"run1.csv has \d+ rows where \d+ were counted, after data row 200"):
        read_chunk(late, LAYOUT)


def test_damaged_and_missing_files_are_refused(tmp_path):
    refused(tmp_path / "gone.csv", LAYOUT, "no such file")
    refused(write(tmp_path, b"PAR1 nothing", "run.pq"), LAYOUT, "cannot be read")
    refused(write(tmp_path, gzip.compress(TEXTS["plain"].encode())[:-30], "cut.csv.gz"), LAYOUT, "cannot be read")
    refused(write_parquet(tmp_path, {**TABLE, "x": TABLE["note"]}), LAYOUT, "'x' in run.parquet holds string")
    path = write_parquet(tmp_path, TABLE, 64)
    whole = path.read_bytes()
    path.write_bytes(whole[:400] + bytes(200) + whole[600:])
    refused(path, LAYOUT, "cannot be read")
    savemat(tmp_path / "run.mat", {"t": TABLE["t"], "x": np.eye(3), "force": FORCE})
    refused(tmp_path / "run.mat", LAYOUT, "in run.mat, 'x' is a 3x3 double")


@pytest.mark.parametrize(("rows", "overlap"), [(0, 0), (10, -1)])
def test_chunks_without_rows_are_refused(tmp_path, rows, overlap):
    with pytest.raises(InputError, match=f"at least 1 row and an overlap of at least 0, got {rows} and {overlap}"):
        cut(survey(write(tmp_path, TEXTS["plain"]), LAYOUT), rows, overlap)


READ = """
import sys
from pathlib import Path
from odescope.recordings.chunks import cut
from odescope.recordings.layout import Layout
from odescope.recordings.readers import read_chunk, survey

def peak():
    # getrusage would start from the peak of the process that started this one
    return int(Path("/proc/self/status").read_text().split("VmHWM:")[1].split()[0])

layout = Layout("t", columns=(("x", "x"), ("u", "u"), ("v", "v")))
small, large = map(Path, sys.argv[1:])
for k in (0, 1):
    read_chunk(cut(survey(small, layout), 50_000)[k], layout)
before = peak()
chunks = cut(survey(large, layout), 50_000, 100)
for chunk in (chunks[0], chunks[-1]):
    assert len(read_chunk(chunk, layout)[0].record) == 50_100
print((peak() - before) / 2**10)
"""


@pytest.mark.skipif(sys.platform != "linux", reason="/proc tells the peak")
@pytest.mark.parametrize("kind", ["parquet", "csv"])
def test_memory_is_that_of_a_chunk(tmp_path, kind):
    files = []
    for rows in (100_000, 4_000_000 if kind == "parquet" else 1_000_000):
        noise = np.random.default_rng(0).standard_normal(rows)
        table = pa.table({"t": 0.25 * np.arange(rows), "x": noise, "u": noise, "v": noise})
        files.append(tmp_path / f"run{rows}.{kind}")
        if kind == "parquet":
            parquet.write_table(table, files[-1], row_group_size=rows)  # one single row group
        else:
            pa.csv.write_csv(table, files[-1])
        table = None
    assert files[1].stat().st_size > 60e6
    command = [sys.executable, "-c", READ, *map(str, files)]
    runs = (subprocess.run(command, capture_output=True, text=True, check=True) for _ in range(3))
    grown = min(float(run.stdout) for run in runs)  # what arenas of threads add by chance is 3 to 30
    assert grown < 30  # MiB; read at once they take 1000 and 300
