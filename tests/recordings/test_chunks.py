"""Files read in chunks: put together, they are the file read at once."""

import gzip
import pickle
import re
from dataclasses import replace

import numpy as np
import pyarrow as pa
import pyarrow.csv
import pytest
from chunk_cases import (
    LAPS,
    LAYOUT,
    TABLE,
    TEXTS,
    N,
    own,
    refused,
    samples,
    stretches,
    text_of,
    write,
    write_parquet,
)
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st
from scipy.io import savemat

from odescope.errors import InputError
from odescope.recordings import text_files
from odescope.recordings.chunks import cut
from odescope.recordings.layout import Layout
from odescope.recordings.readers import read_chunk, read_records, survey

pytestmark = pytest.mark.usefixtures("_small_steps")


PROPERTY = settings(deadline=None, max_examples=15, suppress_health_check=[HealthCheck.function_scoped_fixture])


@pytest.mark.parametrize("name", TEXTS)
@PROPERTY
@given(rows=st.integers(2, N + 9), overlap=st.integers(0, 40))
@example(rows=8, overlap=0)
@example(rows=150, overlap=8)
def test_chunks_of_a_text_file_are_the_file(tmp_path, name, rows, overlap):
    path = write(tmp_path, TEXTS[name])
    parts = stretches(path, LAYOUT, rows, overlap)
    assert len(parts) == -(-N // rows)
    assert own(parts).tobytes() == samples(path, LAYOUT).tobytes()


@PROPERTY
@given(rows=st.integers(2, N + 9), overlap=st.integers(0, 40), group=st.sampled_from([1, 7, 64, 150, N]))
def test_chunks_of_a_parquet_file_are_the_file(tmp_path, rows, overlap, group):
    path = write_parquet(tmp_path, TABLE, group)
    parts = stretches(path, LAYOUT, rows, overlap)
    assert len(parts) == -(-N // rows)
    assert own(parts).tobytes() == samples(path, LAYOUT).tobytes()


def test_marks_and_blocks_of_their_true_size(tmp_path, monkeypatch):
    monkeypatch.undo()
    t = 0.25 * np.arange(200_000)
    path = write(tmp_path, text_of({"t": t, "x": np.sin(t), "force": np.cos(t)}))
    assert path.stat().st_size > 2 * text_files.BLOCK_BYTES
    assert own(stretches(path, LAYOUT, 30_000, 50)).tobytes() == samples(path, LAYOUT).tobytes()


@pytest.mark.parametrize(("rows", "overlap"), [(50, 0), (50, 20), (33, 16), (N, 5)])
def test_the_cuts_and_the_overlap_are_told_from_true_ends(tmp_path, rows, overlap):
    for path in (write(tmp_path, TEXTS["plain"]), write_parquet(tmp_path, TABLE)):
        parts = stretches(path, LAYOUT, rows, overlap)
        last = len(parts) - 1
        assert [part.begins for part in parts] == [k == 0 for k in range(len(parts))]
        assert [part.ends for part in parts] == [k == last for k in range(len(parts))]
        assert [part.first for part in parts] == [overlap * (k > 0) for k in range(len(parts))]
        assert [len(part.record) - part.stop for part in parts] == [overlap * (k < last) for k in range(len(parts))]


def test_a_file_of_one_chunk_is_read_as_ever(tmp_path):
    lap = np.repeat(["b", "a", "b"], N // 3)  # grouped, where a part would tell three runs
    path = write(tmp_path, text_of({**TABLE, "lap": lap}))
    layout = Layout(sample_period=0.5, columns=LAYOUT.columns, recording="lap")
    (chunk,) = cut(survey(path, layout), N, 10)
    assert chunk.whole
    for part, run in zip(read_chunk(chunk, layout), read_records([path], layout), strict=True):
        assert (part.first, part.stop, part.begins, part.ends) == (0, len(run), True, True)
        assert (part.record.source, part.record.units) == (run.source, run.units)
        assert np.array_equal(part.record.t, run.t)
        assert np.array_equal(part.record.values, run.values)


@pytest.mark.parametrize("name", ["run.csv.gz", "run.mat", "run.txt"])
def test_files_that_can_only_be_read_whole_are_one_chunk(tmp_path, name):
    path = tmp_path / name
    if name == "run.mat":
        savemat(path, TABLE)
    elif name == "run.txt":
        write(tmp_path, TEXTS["blank lines"].replace("\n", "\r"), name)
    else:
        write(tmp_path, gzip.compress(TEXTS["blank lines"].encode()), name)
    file = survey(path, LAYOUT)
    assert file.rows == N
    (chunk,) = cut(file, 20)
    assert chunk.whole
    (part,) = read_chunk(chunk, LAYOUT)
    assert np.array_equal(part.record.values, np.column_stack([TABLE["x"], TABLE["force"]]))


def test_chunks_and_stretches_go_to_other_processes(tmp_path):
    chunk = cut(survey(write(tmp_path, TEXTS["plain"]), LAYOUT), 100, 20)[1]
    there = pickle.loads(pickle.dumps(chunk))  # noqa: S301
    assert there == chunk
    (back,) = pickle.loads(pickle.dumps(read_chunk(there, LAYOUT)))  # noqa: S301
    assert np.array_equal(own([back])[:, 0], TABLE["t"][100:200])


def test_a_sample_period_counts_through_the_file(tmp_path):
    layout = Layout(sample_period=0.25, columns=LAYOUT.columns)
    for path in (write(tmp_path, TEXTS["plain"]), write_parquet(tmp_path, TABLE, 64)):
        assert own(stretches(path, layout, 90, 20)).tobytes() == samples(path, layout).tobytes()


def test_a_wrapped_angle_runs_on_over_the_cut(tmp_path):
    angle = 0.3 * np.arange(N)
    path = write(tmp_path, text_of({**TABLE, "x": np.angle(np.exp(1j * angle))}))
    layout = Layout(time="t", columns=(("phi", "x"),), angles=frozenset({"phi"}))
    parts = stretches(path, layout, 70, 20)
    for part in parts:
        assert np.allclose(np.diff(part.record.column("phi")), 0.3)
    turns = (own(parts)[:, 1] - angle) / (2 * np.pi)
    assert np.allclose(turns, np.rint(turns))


def test_jitter_is_resampled_on_as_many_samples(tmp_path):
    t = 0.25 * (np.arange(N) + np.random.default_rng(1).uniform(-0.03, 0.03, N))
    path = write_parquet(tmp_path, {**TABLE, "t": t, "x": np.sin(0.2 * t)})
    parts = own(stretches(path, LAYOUT, 70, 30))
    assert len(parts) == N
    assert np.abs(parts[:, 0] - TABLE["t"]).max() < 0.25 * 0.04
    assert np.abs(parts[:, 1] - np.sin(0.2 * parts[:, 0]))[2:-2].max() < 1e-5


@PROPERTY
@given(
    missing=st.sets(st.integers(0, N - 1), max_size=12),
    jump=st.integers(1, N - 1),
    rows=st.integers(2, N),
    overlap=st.integers(16, 40),
)
@example(missing={99, 100}, jump=200, rows=100, overlap=16)
@example(missing={84, 116, 183, 216}, jump=150, rows=100, overlap=16)
@example(missing=set(range(90, 230)), jump=1, rows=100, overlap=16)
def test_chunks_lose_the_rows_that_reading_at_once_loses(tmp_path, missing, jump, rows, overlap):
    t, x = TABLE["t"].copy(), TABLE["x"].copy()
    t[jump:] += 10.0
    x[list(missing)] = np.nan
    path = write_parquet(tmp_path, {**TABLE, "t": t, "x": x}, 64)
    layout = Layout("t", columns=LAYOUT.columns, gaps="split")
    parts = stretches(path, layout, rows, overlap)
    assert own(parts).tobytes() == samples(path, layout).tobytes()
    begins, ends = zip(*((run.t[0], run.t[-1]) for run in read_records([path], layout)), strict=True)
    for part in parts:
        assert part.record.t[0] in begins if part.begins else part.first == overlap
        assert part.record.t[-1] in ends if part.ends else part.stop == len(part.record) - overlap


@settings(deadline=None, max_examples=30, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    missing=st.sets(st.integers(1, N - 2), max_size=40),
    jump=st.integers(1, N - 1),
    rows=st.integers(60, 140),
    overlap=st.integers(16, 40),
)
@example(missing={99, 100, 101, 199}, jump=200, rows=100, overlap=16)
def test_bridged_chunks_have_the_measured_cells_of_reading_at_once(tmp_path, missing, jump, rows, overlap):
    t, x = TABLE["t"].copy(), TABLE["x"].copy()
    t[jump:] += 4 * (t[1] - t[0])
    x[list(missing)] = np.nan
    path = write_parquet(tmp_path, {**TABLE, "t": t, "x": x}, 64)
    (whole,) = read_records([path], LAYOUT)
    parts = stretches(path, LAYOUT, rows, overlap)
    assert sum(part.stop - part.first for part in parts) == len(whole) == N + 4
    at = np.concatenate([part.record.t[part.first : part.stop] for part in parts])
    counts = np.concatenate([part.record.counted("x")[part.first : part.stop] for part in parts])
    values = np.concatenate([part.record.column("x")[part.first : part.stop] for part in parts])
    assert at == pytest.approx(whole.t, abs=1e-9)
    assert np.array_equal(counts, whole.counted("x"))
    assert np.array_equal(values[counts > 0], whole.column("x")[counts > 0])


def test_a_chunk_that_is_all_gap_holds_nothing(tmp_path):
    x = TABLE["x"].copy()
    x[90:215] = np.nan
    path = write(tmp_path, text_of({**TABLE, "x": x}))
    layout = Layout("t", columns=LAYOUT.columns, gaps="split")
    chunks = cut(survey(path, layout), 100, 10)
    assert [len(read_chunk(chunk, layout)) for chunk in chunks] == [1, 0, 1]
    (first,), (last,) = read_chunk(chunks[0], layout), read_chunk(chunks[2], layout)
    assert (first.begins, first.ends, last.begins, last.ends) == (True, True, True, True)


@pytest.mark.parametrize("row", [105, 130, 193, 205])
def test_gaps_are_refused_by_their_row_in_the_file(tmp_path, row):
    x = TABLE["x"].copy()
    x[row - 1] = np.nan
    path = write(tmp_path, text_of({**TABLE, "x": x}))
    layout = replace(LAYOUT, gaps="refuse")
    refused(path, layout, rf"'x' has 1 gap \(data row {row}\)", overlap=20)
    refused(path, layout, rf"'x' has 1 gap \(data row {row}\)")


def test_time_that_goes_back_is_refused_by_its_row_in_the_file(tmp_path):
    t = TABLE["t"].copy()
    t[250:] -= t[200]
    refused(write_parquet(tmp_path, {**TABLE, "t": t}), LAYOUT, "time goes back at data row 251", overlap=20)


@pytest.mark.parametrize("overlap", [16, 40])
@pytest.mark.parametrize("edges", [(100, 200), (99, 201), (84, 216), (95, 295), (16, 101)])
def test_labels_cross_chunks(tmp_path, edges, overlap):
    lap = np.searchsorted(edges, np.arange(N), side="right")
    for path in (write(tmp_path, text_of({**TABLE, "lap": lap})), write_parquet(tmp_path, {**TABLE, "lap": lap}, 64)):
        layout = Layout("t", columns=LAYOUT.columns, recording="lap")
        parts = stretches(path, layout, 100, overlap)
        assert own(parts).tobytes() == samples(path, layout).tobytes()
        for label, first, last in zip("012", (0, *edges), (*edges, N), strict=True):
            mine = [part for part in parts if part.record.source == f"{path.name} (lap {label})"]
            assert sum(part.stop - part.first for part in mine) == last - first
            assert mine[0].begins
            assert mine[-1].ends


@pytest.mark.parametrize("row", [0, 50, 120, 299])
@pytest.mark.parametrize("gaps", ["refuse", "split"])
def test_a_recording_of_one_row_is_refused_as_at_once(tmp_path, row, gaps):
    lap = (np.arange(N) >= row) + 1 * (np.arange(N) > row)
    path = write(tmp_path, text_of({**TABLE, "lap": lap}))
    layout = Layout("t", columns=LAYOUT.columns, recording="lap", gaps=gaps)
    with pytest.raises(InputError) as caught:
        read_records([path], layout)
    refused(path, layout, re.escape(str(caught.value)), overlap=20)


def test_a_row_cut_off_from_its_recording_is_not_a_fault(tmp_path):
    lap = np.arange(N) >= 99
    path = write_parquet(tmp_path, {**TABLE, "lap": lap})
    for gaps in ("refuse", "split"):
        layout = Layout("t", columns=LAYOUT.columns, recording="lap", gaps=gaps)
        assert len(own(stretches(path, layout, 100))) == N - 1  # without an overlap the row stands alone
        assert len(own(stretches(path, layout, 100, 16))) == N
    x = TABLE["x"].copy()
    x[99] = np.nan
    layout = Layout("t", columns=LAYOUT.columns, recording="lap", gaps="refuse")
    refused(write_parquet(tmp_path, {**TABLE, "lap": lap, "x": x}), layout, "0 of 1 rows are complete")


def test_a_label_that_comes_back_is_another_recording(tmp_path):
    path = write(tmp_path, text_of({**TABLE, "lap": np.repeat(list("abab"), 75)}))
    parts = stretches(path, LAPS, 150, 16)
    assert [(part.record.source[-2], part.first, part.stop) for part in parts] == [
        ("a", 0, 75),
        ("b", 0, 75),
        ("a", 0, 75),
        ("b", 0, 75),
    ]
    assert [(part.begins, part.ends) for part in parts] == [(True, True)] * 4


@pytest.mark.parametrize("gaps", ["refuse", "split"])
def test_mixed_recordings_are_refused(tmp_path, gaps):
    path = write(tmp_path, text_of({**TABLE, "lap": np.where(np.arange(N) % 2, "a", "b")}))
    layout = Layout("t", columns=LAYOUT.columns, recording="lap", gaps=gaps)
    assert len(read_records([path], layout)) == 2
    refused(
        path, layout, "'a' in run1.csv is in several places, .* from data row 2 on: .* sort it by 'lap', then by time"
    )


def test_an_empty_label_is_refused(tmp_path):
    lap = np.where(np.arange(N) == 250, "", "a")
    refused(write(tmp_path, text_of({**TABLE, "lap": lap})), LAPS, "'lap' in run1.csv has empty cells")


def test_categories_label_recordings(tmp_path):
    labels = pa.array(np.repeat(["a", "b"], N // 2)).dictionary_encode()
    path = write_parquet(tmp_path, {**TABLE, "lap": labels}, 64)
    sources = [part.record.source for part in stretches(path, LAPS, 100)]
    assert sources == [f"run.parquet (lap {lap})" for lap in "aabb"]
