"""Logs that do not fit in memory: read in chunks, reduced to factors, resumed; and the same on a cluster."""

from __future__ import annotations

import json
import subprocess
import sys
import threading
import time
from dataclasses import dataclass, field

import msgspec
import numpy as np
import pyarrow as pa
import pytest
from logs import oscillator, write
from machines import until
from pyarrow import parquet

from odescope import Derivatives
from odescope.errors import InputError, Stopped
from odescope.events import Monitor, Progress
from odescope.likelihood.search import LikelihoodSearch
from odescope.model.scores import Streamed
from odescope.parallel.workers import Threads
from odescope.pipeline.identification import identify
from odescope.pipeline.reduce import reduce_all
from odescope.pipeline.sample import LEAST_ROWS, SAMPLED, rows_in_memory
from odescope.pipeline.store import Reduced, Store
from odescope.study.options import Data, Driven, Filtering, Measured, Study

LITTLE = 570.0  # MB: just above what is refused, so that 50 000 rows are too many
ROWS = 120_000
CHUNKS = -(-ROWS // (rows_in_memory(LITTLE, 3) // SAMPLED))
SCHEMA = [("t", pa.float64()), ("x", pa.float64()), ("u", pa.float64()), ("run", pa.int64())]
REGRESSED = LikelihoodSearch(enabled=False)


@pytest.fixture(scope="module")
def log():
    """x'' = -4 x - 0.3 x' + u over forty minutes."""
    return oscillator(ROWS, noise=0.01)


@pytest.fixture(scope="module")
def folder(tmp_path_factory, log):
    """The log as one Parquet file of one row group, as CSV, and as a Parquet dataset of twelve files."""
    where = tmp_path_factory.mktemp("log")
    parquet.write_table(pa.table(log), where / "log.parquet")
    write(str(where / "log.csv"), log)
    (where / "parts").mkdir()
    for k in range(12):
        part = {name: column[k * 10_000 : (k + 1) * 10_000] for name, column in log.items()}
        parquet.write_table(pa.table(part), where / "parts" / f"part-{k:02}.parquet")
    return where


def study_of(*files, memory=LITTLE, **options):
    data = Data(files=tuple(map(str, files)), time="t", memory=memory)
    given = {"coordinates": {"x": Measured(order=2)}, "inputs": {"u": Driven()}, "likelihood": REGRESSED}
    return Study(data=data, **{**given, **options})


def coefficients(result):
    return {t.text: t.coefficient for relation in result.model.relations for t in relation.terms}


@dataclass(frozen=True)
class Counted:
    """Threads that note what they are asked to do."""

    asked: list = field(default_factory=list)
    count: int = 2
    remote: bool = False

    def at_most(self, count):
        return self

    def map(self, function, items, *shared, **options):
        items = list(items)
        self.asked.append((function.__name__, len(items)))
        yield from Threads().map(function, items, *shared, **options)

    @property
    def chunks(self):
        return sum(count for name, count in self.asked if name == "reduce")


@pytest.fixture
def counted(monkeypatch):
    from contextlib import contextmanager

    workers = Counted()

    @contextmanager
    def opened(cluster):
        yield workers

    monkeypatch.setattr("odescope.pipeline.identification.open_workers", opened)
    return workers


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


def test_clipping_and_delays_reach_every_chunk(tmp_path, log):
    rng = np.random.default_rng(3)
    struck = log["x"].copy()
    hit = rng.random(ROWS) < 0.01
    struck[hit] += rng.choice([-3.0, 3.0], hit.sum())
    late = np.concatenate([np.zeros(5), log["u"][:-5]])  # recorded 0.1 s late: it acts 0.1 s before
    parquet.write_table(pa.table({**log, "x": struck, "u": late}), tmp_path / "log.parquet")
    options = {"inputs": {"u": Driven(delay=-0.1)}, "signals": Filtering(outliers="clip")}
    found = coefficients(identify(study_of(tmp_path / "log.parquet", **options)))
    assert found.keys() == {"x_ddot", "x", "x_dot", "u"}
    assert [found[k] for k in ("x", "x_dot", "u")] == pytest.approx([4.0, 0.3, -1.0], rel=0.02)


@pytest.mark.parametrize("gaps", ["split", "bridge"])
def test_gaps_between_and_within_chunks(tmp_path, log, gaps):
    table = pa.table(log).take(np.delete(np.arange(ROWS), [*range(6000, 6004), 30_000, *range(70_000, 77_000)]))
    parquet.write_table(table, tmp_path / "log.parquet")
    study = study_of(tmp_path / "log.parquet")
    with pytest.raises(InputError, match="gap"):
        identify(msgspec.structs.replace(study, data=msgspec.structs.replace(study.data, gaps="refuse")))
    found = coefficients(identify(msgspec.structs.replace(study, data=msgspec.structs.replace(study.data, gaps=gaps))))
    assert found.keys() == {"x_ddot", "x", "x_dot", "u"}
    assert [found[k] for k in ("x", "x_dot", "u")] == pytest.approx([4.0, 0.3, -1.0], rel=0.01)


def test_a_log_of_two_periods_that_lacks_rows_and_was_read_with_jitter(tmp_path, log):
    rng = np.random.default_rng(5)
    there = rng.random(ROWS) > 0.02
    read = {**log, "t": log["t"] + 0.1 * 0.02 * rng.standard_normal(ROWS)}
    fine = np.flatnonzero(there[:90_000])
    parquet.write_table(pa.table({n: c[fine] for n, c in read.items()}), tmp_path / "fine.parquet")
    parquet.write_table(pa.table({n: c[90_000::2] for n, c in read.items()}), tmp_path / "coarse.parquet")
    found = identify(study_of(tmp_path / "fine.parquet", tmp_path / "coarse.parquet"))
    assert found.signals.samples < 0.7 * ROWS  # only a sample stands in memory
    assert [run.sample_period for run in found.records] == pytest.approx([0.02] * len(found.records), rel=1e-4)
    assert coefficients(found).keys() == {"x_ddot", "x", "x_dot", "u"}
    assert [coefficients(found)[k] for k in ("x", "x_dot", "u")] == pytest.approx([4.0, 0.3, -1.0], rel=0.01)


def test_a_recording_that_is_no_number_somewhere_is_refused_by_name(tmp_path, log):
    x = log["x"].copy()
    x[61_234] = np.inf
    parquet.write_table(pa.table({**log, "x": x}), tmp_path / "log.parquet")
    with pytest.raises(InputError, match=r"'x' is not a finite number in data row 61235 in log\.parquet"):
        identify(study_of(tmp_path / "log.parquet"))


# resuming


class Interrupted(Exception):
    pass


def stop_after(chunks):
    def watch(event):
        if isinstance(event, Progress) and event.part == "chunk" and event.done == chunks:
            raise Interrupted

    return watch


def test_an_interrupted_run_goes_on_where_it_stopped(tmp_path, folder, counted):
    study, store = study_of(folder / "log.parquet"), tmp_path / "factors"
    expected = identify(study)
    assert counted.chunks == CHUNKS
    with pytest.raises(Interrupted):
        identify(study, watch=stop_after(8), store=store)
    counted.asked.clear()
    kept = len(list(store.rglob("*.npz")))
    assert 7 <= kept <= 8
    told = []
    result = identify(study, watch=told.append, store=store)
    assert counted.chunks == CHUNKS - kept
    assert coefficients(result) == pytest.approx(coefficients(expected), rel=1e-12)
    assert Progress("recordings", "chunk", CHUNKS, CHUNKS, 0.0) in told
    counted.asked.clear()
    assert coefficients(identify(study, store=store)) == pytest.approx(coefficients(expected), rel=1e-12)
    assert counted.chunks == 0


def test_an_added_recording_costs_only_itself(tmp_path, folder, counted):
    parts = sorted((folder / "parts").iterdir())
    store = tmp_path / "factors"
    first = identify(study_of(*parts[:11]), store=store)
    before = counted.chunks
    counted.asked.clear()
    result = identify(study_of(*parts), store=store)
    assert counted.chunks == 2  # the file of 10 000 rows is two chunks
    assert before == 22
    problems = [r.searches[0].problem for r in (first, result)]
    assert problems[1].factor.rows > 1.08 * problems[0].factor.rows
    assert coefficients(result)["x"] == pytest.approx(4.0, rel=0.01)


def test_what_no_longer_fits_is_computed_anew(tmp_path, folder, counted):
    study, store = study_of(folder / "log.parquet"), tmp_path / "factors"
    expected = coefficients(identify(study, store=store))
    counted.asked.clear()
    files = sorted(store.rglob("*.npz"))
    files[3].write_bytes(files[3].read_bytes()[:1000])  # cut short
    files[5].write_bytes(b"")
    assert coefficients(identify(study, store=store)) == pytest.approx(expected, rel=1e-12)
    other = msgspec.structs.replace(study, signals=Filtering(margin=1.0))
    identify(other, store=store)
    assert counted.chunks == CHUNKS
    assert [len(list(own.glob("*.npz"))) for own in store.iterdir()] == [CHUNKS] * 2  # one folder a study
    for kept in store.rglob("sample.json"):
        kept.write_text("[]")
    identify(other, store=store)
    assert any("chunks" in json.loads(kept.read_text()) for kept in store.rglob("sample.json"))


class Gaussian:
    """A differentiator of one's own, as docs/extending.md teaches it."""

    def __init__(self, width, held=None):
        self.width, self.held = width, held

    def derivatives(self, channel, period, order):
        from scipy.ndimage import gaussian_filter1d

        width = self.width / period
        values = tuple(
            np.array([gaussian_filter1d(s, width, order=k, mode="nearest") / period**k for k in range(order + 1)])
            for s in channel
        )
        noise = float(np.std(np.concatenate([s - v[0] for s, v in zip(channel, values, strict=True)])))
        return Derivatives(values, noise, cutoff=1.0 / (2 * np.pi * self.width))


def test_a_differentiator_of_ones_own_is_kept_and_told_from_another(tmp_path, folder, counted):
    study, store = study_of(folder / "log.parquet"), tmp_path / "factors"
    narrow, wide = (msgspec.structs.replace(study, signals=Filtering(differentiator=Gaussian(w))) for w in (0.2, 0.25))
    expected = coefficients(identify(narrow, store=store))
    assert [expected[k] for k in ("x", "x_dot", "u")] == pytest.approx([4.0, 0.3, -1.0], rel=0.1)
    counted.asked.clear()
    again = msgspec.structs.replace(study, signals=Filtering(differentiator=Gaussian(0.2)))
    assert coefficients(identify(again, store=store)) == pytest.approx(expected, rel=1e-12)
    assert counted.chunks == 0
    assert coefficients(identify(wide, store=store)) != pytest.approx(expected, rel=1e-6)
    assert counted.chunks == CHUNKS
    with pytest.raises(InputError, match=r"store: an object of class _thread\.lock cannot be compared"):
        identify(
            msgspec.structs.replace(study, signals=Filtering(differentiator=Gaussian(0.2, threading.Lock()))),
            store=store,
        )


def test_a_differentiator_of_ones_own_gives_in_chunks_what_it_gives_at_once(folder):
    options = {"signals": Filtering(differentiator=Gaussian(0.2))}
    at_once = coefficients(identify(study_of(folder / "log.parquet", memory=1000.0, **options)))
    in_chunks = coefficients(identify(study_of(folder / "log.parquet", **options)))
    assert at_once.keys() == in_chunks.keys()
    for term, value in at_once.items():
        assert in_chunks[term] == pytest.approx(value, rel=5e-3)


def test_a_stop_ends_the_pass_within_a_second_and_keeps_what_is_done(tmp_path, folder):
    """Nothing runs on behind it either."""
    study = study_of(folder / "log.parquet")
    settled = _settled(study, tmp_path / "factors")
    stopped_at = []

    def stop():
        done = len(list(tmp_path.rglob("*.npz")))
        if done >= 5 and not stopped_at:
            stopped_at.append((done, time.monotonic()))
        return bool(stopped_at)

    with pytest.raises(Stopped):
        reduce_all(*settled, Threads(2), Monitor(stop=stop))
    (done, at) = stopped_at[0]
    assert time.monotonic() - at < 1.0
    until(lambda: threading.active_count() == 1 or not any("ThreadPool" in t.name for t in threading.enumerate()), 1.0)
    assert done <= len(list(tmp_path.rglob("*.npz"))) <= done + 1


def _settled(study, folder):
    """Return the sample, the plan and the problems of a study, as `identify` settles them."""
    caught = []

    def catch(*arguments):
        caught.append(arguments[:3])
        raise Interrupted

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("odescope.pipeline.stages.reduce_all", catch)
        with pytest.raises(Interrupted):
            identify(study, store=folder)
    return caught[0]


def test_factors_kept_are_those_computed(tmp_path, folder):
    kept: list[Reduced] = []

    class Spy(Threads):
        def map(self, function, items, *shared, **options):
            for item in items:
                kept.append(function(item, *shared))
                yield kept[-1]

    from contextlib import contextmanager

    @contextmanager
    def opened(cluster):
        yield Spy()

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("odescope.pipeline.identification.open_workers", opened)
        identify(study_of(folder / "log.parquet"))
    reduced = next(k for k in kept if isinstance(k, Reduced))
    store = Store(tmp_path / "factors", "study")
    assert store.read("a.npz") is None
    store.write("a.npz", reduced)
    again = store.read("a.npz")
    assert (again.rows, again.recordings) == (reduced.rows, reduced.recordings)
    for (fold, factor), (same_fold, same) in zip(reduced.factors[0], again.factors[0], strict=True):
        assert (fold, factor.rows) == (same_fold, same.rows)
        np.testing.assert_array_equal(factor.r, same.r)
        np.testing.assert_array_equal(factor.scale, same.scale)


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


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="peaks of a process alone are told by Linux")
def test_memory_is_bounded_by_the_setting_however_long_the_log(tmp_path, log):
    peaks, memory = [], LITTLE + 10.0  # a column more
    for recordings in (1, 8):
        with parquet.ParquetWriter(tmp_path / "log.parquet", pa.schema(SCHEMA)) as writer:
            for k in range(recordings):  # all in one row group each, far larger than a chunk
                noisy = log["x"] + 0.01 * np.random.default_rng(k).standard_normal(ROWS)
                writer.write_table(pa.table({**log, "x": noisy, "run": np.full(ROWS, k)}, schema=pa.schema(SCHEMA)))
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
    assert peaks[1] - peaks[0] < 100.0  # with all in memory, 8 times as many rows would take 400 more
