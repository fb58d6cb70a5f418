"""Identification on a Dask scheduler and two workers: the same model, also where a worker is killed half-way."""

import msgspec
import numpy as np
import pyarrow as pa
import pytest
from logs import oscillator, write
from machines import Machines, until
from pyarrow import parquet

from odescope.events import Progress
from odescope.likelihood.search import LikelihoodSearch
from odescope.pipeline.identification import identify
from odescope.study.options import Data, Driven, Filtering, Measured, Study

RECORDINGS = 64
LITTLE = 570.0  # MB: just above what is refused, so that 50 000 rows are too many


@pytest.fixture(scope="module")
def machines(tmp_path_factory):
    found = Machines(tmp_path_factory.mktemp("machines"))
    found.staff(2)
    yield found
    found.stop()


@pytest.fixture(scope="module")
def study(tmp_path_factory):
    """64 recordings of half a minute to a minute, each a file; some as CSV, and one too short to be of use."""
    folder, rng = tmp_path_factory.mktemp("logs"), np.random.default_rng(0)
    files = []
    for k in range(RECORDINGS):
        log = oscillator(int(rng.integers(1000, 2000)), noise=0.02, seed=k)
        log = {name: column[:30] for name, column in log.items()} if k == 11 else log
        files.append(str(folder / (f"run{k:02}.csv" if k % 8 == 0 else f"run{k:02}.parquet")))
        if k % 8 == 0:
            write(files[-1], log)
        else:
            parquet.write_table(pa.table(log), files[-1])
    data = Data(files=tuple(files), time="t")
    return Study(
        data=data,
        coordinates={"x": Measured(order=2)},
        inputs={"u": Driven()},
        signals=Filtering(outliers="clip"),
        likelihood=LikelihoodSearch(),
    )


@pytest.fixture(scope="module")
def alone(study):
    return identify(study)


def assert_same(result, alone):
    assert result.notes == alone.notes
    for own, other in zip(result.model.relations, alone.model.relations, strict=True):
        assert [t.text for t in own.terms] == [t.text for t in other.terms]
        for t, u in zip(own.terms, other.terms, strict=True):
            assert t.coefficient == pytest.approx(u.coefficient, rel=1e-9)
            assert (t.std_error or 0.0) == pytest.approx(u.std_error or 0.0, rel=1e-7)
    for one, two in zip(result.searches, alone.searches, strict=True):
        assert [c.support for c in one.ranked.candidates] == [c.support for c in two.ranked.candidates]
        np.testing.assert_allclose(one.inclusion, two.inclusion)
        np.testing.assert_allclose(one.problem.factor.r, two.problem.factor.r, atol=1e-11)
        criteria = [[c.criterion for c in s.ranked.candidates] for s in (one, two)]
        np.testing.assert_allclose(*criteria, rtol=1e-9)
    for name, ends in alone.model.domain.items():
        assert result.model.domain[name] == pytest.approx(ends, rel=1e-9)


@pytest.mark.slow
def test_two_workers_give_the_model_of_one_process(machines, study, alone):
    result = identify(study, cluster=machines.address)
    assert result.model.provenance["recordings"] == RECORDINGS - 1
    assert alone.notes[0] == "1 recording is shorter than a period of the cutoff and was left out"
    assert_same(result, alone)


@pytest.mark.slow
def test_a_worker_killed_half_way_costs_its_task_alone(machines, study):
    study = msgspec.structs.replace(study, data=msgspec.structs.replace(study.data, memory=LITTLE))
    machines.staff(2)
    killed, told = [], []

    def watch(event):
        told.append(event)
        if isinstance(event, Progress) and event.part == "chunk" and event.done == RECORDINGS // 4:
            machines.workers[0].kill()
            killed.append(machines.workers[0].wait())

    result = identify(study, watch=watch, cluster=machines.address)
    assert killed
    assert Progress("recordings", "chunk", RECORDINGS, RECORDINGS, 0.0) in told
    assert result.model.provenance["recordings"] == RECORDINGS - 1
    assert_same(result, identify(study))
    machines.staff(2)


@pytest.mark.slow
def test_a_log_in_chunks_is_read_by_the_workers(machines, tmp_path):
    log = oscillator(90_000, noise=0.01)
    parquet.write_table(pa.table(log), tmp_path / "log.parquet")
    data = Data(files=(str(tmp_path / "log.parquet"),), time="t", memory=LITTLE)
    study = Study(data=data, coordinates={"x": Measured(order=2)}, inputs={"u": Driven()})
    machines.staff(2)
    here, there = identify(study), identify(study, cluster=machines.address, store=tmp_path / "factors")
    assert there.model.scores.streamed.portions == len(list((tmp_path / "factors").rglob("*.npz"))) > 5
    assert_same(there, here)


@pytest.mark.slow
def test_the_command_line_takes_a_cluster(machines, tmp_path, monkeypatch, capsys):
    from logs import OSCILLATOR_OPTIONS, Command

    monkeypatch.chdir(tmp_path)
    write("run.csv", oscillator())
    run = Command(monkeypatch, capsys)
    until(lambda: all(w.poll() is None for w in machines.workers))
    ended = run("identify", "run.csv", *OSCILLATOR_OPTIONS, "--cluster", machines.address, "--out", "there")
    assert ended.code == 0
    assert "x_ddot = " in ended.out
    assert ended.out == run("identify", "run.csv", *OSCILLATOR_OPTIONS, "--out", "here").out
    assert "local, or the address" in run.refused("identify", "run.csv", *OSCILLATOR_OPTIONS, "--cluster", "elsewhere")
