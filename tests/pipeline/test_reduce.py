"""Logs that do not fit in memory: read in chunks and reduced to factors, and what that gives."""

from __future__ import annotations

import subprocess
import sys

import msgspec
import numpy as np
import pyarrow as pa
import pytest
from pyarrow import parquet
from reduce_cases import CHUNKS, LITTLE, ROWS, SCHEMA, coefficients, study_of

from odescope.errors import InputError
from odescope.likelihood.search import LikelihoodSearch
from odescope.model.scores import Streamed
from odescope.pipeline.identification import identify
from odescope.pipeline.sample import LEAST_ROWS, SAMPLED, rows_in_memory
from odescope.study.options import Driven, Filtering, Measured

# what comes out


@pytest.fixture(scope="module")
def in_memory(folder):
    return identify(study_of(folder / "log.parquet", memory=1000.0))


@pytest.mark.parametrize("name", ["log.parquet", "log.csv", "parts"])
def test_a_log_in_chunks_gives_the_equation_of_the_log_at_once(folder, in_memory, name):
    result = identify(study_of(folder / name))
    assert result.records.samples < 0.6 * ROWS  # only a sample stands in memory
    assert "120,000 rows were read in" in result.notes[-1]
    found, expected = coefficients(result), coefficients(in_memory)
    truth = {"x_ddot": 1.0, "x": 4.0, "x_dot": 0.3, "u": -1.0}
    assert found.keys() == expected.keys() == truth.keys()
    for term, value in truth.items():
        assert found[term] == pytest.approx(value, rel=0.01)
        assert found[term] == pytest.approx(expected[term], rel=2e-3)
    # Everything counts in the factor: as many rows, but for margins and the bins that blocks round off.
    rows = [r.searches[0].problem.factor.rows * r.signals.channels[0].cutoff ** -1 for r in (result, in_memory)]
    assert rows[0] == pytest.approx(rows[1], rel=0.02)
    for state, (low, high) in in_memory.model.domain.items():
        assert result.model.domain[state] == pytest.approx((low, high), abs=0.02 * (high - low))


def test_the_likelihood_follows_the_sample(folder):
    result = identify(study_of(folder / "log.parquet", likelihood=LikelihoodSearch()))
    (relation,) = result.model.relations
    truth = {"x_ddot": 1.0, "x": 4.0, "x_dot": 0.3, "u": -1.0}
    assert {t.text for t in relation.terms} == truth.keys()
    for t in relation.terms:
        if t.std_error is not None:
            assert abs(t.coefficient - truth[t.text]) < 4.0 * t.std_error
    assert result.model.scores.streamed == Streamed(rows=ROWS, portions=CHUNKS, sampled=SAMPLED)


def test_clipping_and_delays_reach_every_chunk(tmp_path, lengthy):
    rng = np.random.default_rng(3)
    struck = lengthy["x"].copy()
    hit = rng.random(ROWS) < 0.01
    struck[hit] += rng.choice([-3.0, 3.0], hit.sum())
    late = np.concatenate([np.zeros(5), lengthy["u"][:-5]])  # recorded 0.1 s late: it acts 0.1 s before
    parquet.write_table(pa.table({**lengthy, "x": struck, "u": late}), tmp_path / "log.parquet")
    options = {"inputs": {"u": Driven(delay=-0.1)}, "signals": Filtering(outliers="clip")}
    found = coefficients(identify(study_of(tmp_path / "log.parquet", **options)))
    assert found.keys() == {"x_ddot", "x", "x_dot", "u"}
    assert [found[k] for k in ("x", "x_dot", "u")] == pytest.approx([4.0, 0.3, -1.0], rel=0.02)


@pytest.mark.slow
def test_numbers_where_nothing_was_read_count_in_no_chunk(tmp_path, lengthy):
    lost = np.random.default_rng(4).random(ROWS) < 0.02
    parquet.write_table(pa.table({**lengthy, "x": np.where(lost, -999.0, lengthy["x"])}), tmp_path / "log.parquet")
    found = coefficients(identify(study_of(tmp_path / "log.parquet")))
    assert found.keys() == {"x_ddot", "x", "x_dot", "u"}
    assert [found[k] for k in ("x", "x_dot", "u")] == pytest.approx([4.0, 0.3, -1.0], rel=0.01)


@pytest.mark.parametrize("gaps", ["split", "bridge"])
def test_gaps_between_and_within_chunks(tmp_path, lengthy, gaps):
    table = pa.table(lengthy).take(np.delete(np.arange(ROWS), [*range(6000, 6004), 30_000, *range(70_000, 77_000)]))
    parquet.write_table(table, tmp_path / "log.parquet")
    study = study_of(tmp_path / "log.parquet")
    with pytest.raises(InputError, match="gap"):
        identify(msgspec.structs.replace(study, data=msgspec.structs.replace(study.data, gaps="refuse")))
    found = coefficients(identify(msgspec.structs.replace(study, data=msgspec.structs.replace(study.data, gaps=gaps))))
    assert found.keys() == {"x_ddot", "x", "x_dot", "u"}
    assert [found[k] for k in ("x", "x_dot", "u")] == pytest.approx([4.0, 0.3, -1.0], rel=0.01)


@pytest.mark.slow
def test_a_log_of_two_periods_that_lacks_rows_and_was_read_with_jitter(tmp_path, lengthy):
    rng = np.random.default_rng(5)
    there = rng.random(ROWS) > 0.02
    read = {**lengthy, "t": lengthy["t"] + 0.1 * 0.02 * rng.standard_normal(ROWS)}
    fine = np.flatnonzero(there[:90_000])
    parquet.write_table(pa.table({n: c[fine] for n, c in read.items()}), tmp_path / "fine.parquet")
    parquet.write_table(pa.table({n: c[90_000::2] for n, c in read.items()}), tmp_path / "coarse.parquet")
    found = identify(study_of(tmp_path / "fine.parquet", tmp_path / "coarse.parquet"))
    assert found.signals.samples < 0.7 * ROWS  # only a sample stands in memory
    assert [run.sample_period for run in found.records] == pytest.approx([0.02] * len(found.records), rel=1e-4)
    assert coefficients(found).keys() == {"x_ddot", "x", "x_dot", "u"}
    assert [coefficients(found)[k] for k in ("x", "x_dot", "u")] == pytest.approx([4.0, 0.3, -1.0], rel=0.01)


def test_a_recording_that_is_no_number_somewhere_is_refused_by_name(tmp_path, lengthy):
    x = lengthy["x"].copy()
    x[61_234] = np.inf
    parquet.write_table(pa.table({**lengthy, "x": x}), tmp_path / "log.parquet")
    with pytest.raises(InputError, match=r"'x' is not a finite number in data row 61235 in log\.parquet"):
        identify(study_of(tmp_path / "log.parquet"))


# what is refused


def test_too_little_memory_is_refused_with_what_would_do(folder):
    with pytest.raises(
        InputError, match=r"memory = 560 MB is too little for a long log of 3 columns: expected at least 56\d"
    ):
        identify(study_of(folder / "log.parquet", memory=560.0))
    assert rows_in_memory(LITTLE, 3) >= LEAST_ROWS


def test_a_packed_file_that_does_not_fit_is_refused(tmp_path, folder):
    import gzip

    (tmp_path / "log.csv.gz").write_bytes(gzip.compress((folder / "log.csv").read_bytes(), 1))
    with pytest.raises(InputError, match=r"log\.csv\.gz has 120000 rows and can only be read whole, but \d+ fit"):
        identify(study_of(tmp_path / "log.csv.gz"))


def test_a_slow_signal_in_small_files_needs_no_overlap(tmp_path):
    """Each file is filtered whole: how far a filter reaches does not matter."""
    t = 0.01 * np.arange(4000)
    rng = np.random.default_rng(0)
    for k in range(20):
        x = (1.0 + k) * np.exp(-0.05 * t) + 0.01 * rng.standard_normal(len(t))
        parquet.write_table(pa.table({"t": t, "x": x}), tmp_path / f"{k:02}.parquet")
    study = study_of(tmp_path, coordinates={"x": Measured()}, inputs={})
    found = coefficients(identify(study))
    assert found["x"] == pytest.approx(0.05, rel=0.01)


def test_a_filter_that_reaches_further_than_a_chunk_is_refused(tmp_path):
    rng = np.random.default_rng(0)
    t = 1e-4 * np.arange(100_000)
    columns = {"t": t, "x": np.sin(2 * t) + 1e-3 * rng.standard_normal(len(t)), "u": np.cos(3 * t)}
    parquet.write_table(pa.table(columns), tmp_path / "log.parquet")
    with pytest.raises(InputError, match=r"reaches over \d+ samples, too many for chunks of \d+: allow more memory"):
        identify(study_of(tmp_path / "log.parquet"))


# memory


PEAK = """
import sys
from odescope.pipeline.identification import identify
from odescope.parallel.memory import peak_bytes
from odescope.study.toml import read_study
from pathlib import Path

result = identify(read_study(Path(sys.argv[1])))
print(peak_bytes(), result.model.provenance["recordings"], *(t.text for t in result.model.relations[0].terms))
"""


@pytest.mark.slow
@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="peaks of a process alone are told by Linux")
def test_memory_is_bounded_by_the_setting_however_long_the_log(tmp_path, lengthy):
    peaks, memory = [], LITTLE + 10.0  # a column more
    for recordings in (1, 4):
        with parquet.ParquetWriter(tmp_path / "log.parquet", pa.schema(SCHEMA)) as writer:
            for k in range(recordings):  # all in one row group each, far larger than a chunk
                noisy = lengthy["x"] + 0.01 * np.random.default_rng(k).standard_normal(ROWS)
                writer.write_table(pa.table({**lengthy, "x": noisy, "run": np.full(ROWS, k)}, schema=pa.schema(SCHEMA)))
        (tmp_path / "study.toml").write_text(
            f'[data]\nfiles = ["{(tmp_path / "log.parquet").as_posix()}"]\ntime = "t"\nrecording = "run"\n'
            f"memory = {memory}\n[coordinates.x]\norder = 2\n[inputs.u]\n"
        )
        ended = subprocess.run(
            [sys.executable, "-c", PEAK, str(tmp_path / "study.toml")], capture_output=True, text=True, check=True
        )
        peak, begun, *terms = ended.stdout.split()
        assert int(begun) == recordings
        assert set(terms) == {"x_ddot", "x", "x_dot", "u"}
        peaks.append(int(peak) / 1e6)
    assert peaks[1] < memory
    assert peaks[1] - peaks[0] < 100.0  # with all in memory, 4 times as many rows would take 170 more
