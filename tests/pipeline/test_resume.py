"""Factors of chunks are kept: runs are resumed, logs added to, and what no longer fits is computed anew."""

from __future__ import annotations

import json
import shutil
import threading
import time

import msgspec
import numpy as np
import pytest
from machines import until
from reduce_cases import CHUNKS, Counted, coefficients, study_of

from odescope import Derivatives
from odescope.errors import InputError, Stopped
from odescope.events import Monitor, Progress
from odescope.parallel.workers import Threads
from odescope.pipeline.identification import identify
from odescope.pipeline.reduce import reduce_all
from odescope.pipeline.store import Reduced, Store
from odescope.study.options import Filtering


@pytest.fixture
def counted(monkeypatch):
    from contextlib import contextmanager

    workers = Counted()

    @contextmanager
    def opened(cluster):
        yield workers

    monkeypatch.setattr("odescope.pipeline.identification.open_workers", opened)
    return workers


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


def test_an_added_recording_costs_only_itself_wherever_it_lies(tmp_path, folder, counted):
    *parts, added = sorted((folder / "parts").iterdir())
    elsewhere = tmp_path / "later" / added.name
    elsewhere.parent.mkdir()
    shutil.copyfile(added, elsewhere)
    store = tmp_path / "factors"
    first = identify(study_of(*parts), store=store)
    before = counted.chunks
    counted.asked.clear()
    result = identify(study_of(*parts, elsewhere), store=store)
    assert counted.chunks == 2  # the file of 10 000 rows is two chunks
    assert before == 22
    problems = [r.searches[0].problem for r in (first, result)]
    assert problems[1].factor.rows > 1.08 * problems[0].factor.rows
    assert coefficients(result)["x"] == pytest.approx(4.0, rel=0.01)


@pytest.mark.slow
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


@pytest.mark.slow
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


def test_what_served_a_run_stays_whichever_plan_it_was_of_and_nothing_else(tmp_path):
    """With constants within functions one run reads the log several times, each time with a plan."""
    empty = Reduced(((),), np.zeros(1), np.ones(1), 10, 1)
    old = Store(tmp_path, "study")
    for key in ("kept.npz", "gone.npz"):
        old.write(key, empty)
    store = Store(tmp_path, "study")
    assert store.read("kept.npz") is not None
    store.write("first plan.npz", empty)
    store.write("second plan.npz", empty)
    store.prune()
    assert {path.name for path in store.folder.iterdir()} == {"kept.npz", "first plan.npz", "second plan.npz"}
