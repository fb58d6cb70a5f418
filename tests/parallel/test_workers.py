import os
import signal
import threading
import time
from pathlib import Path

import numpy as np
import pytest
from machines import Machines, until
from threadpoolctl import threadpool_info
from worker_tasks import die_once

import odescope.parallel.dask_cluster as module
from odescope import InputError, NoModelError
from odescope.errors import WorkersLostError
from odescope.parallel.dask_cluster import AHEAD_OF_CLUSTER, open_workers
from odescope.parallel.workers import AHEAD_OF_THREADS, Threads, check_wanted


def scaled(i, array, factor):
    return i * factor + array.sum()


def slow(i):
    time.sleep(0.1)
    return i


def refuse(i, log):
    with open(log, "a") as file:
        file.write(f"{i}\n")
    if i == 3:
        raise InputError("column 'phi' has 3 gaps; split the run there")
    return i


def fail(error):
    raise error


def die(i):
    os.kill(os.getpid(), signal.SIGKILL)


def blas_threads(_):
    np.ones((2, 2)) @ np.ones((2, 2))
    return [pool["num_threads"] for pool in threadpool_info() if pool["user_api"] == "blas"]


class Counted:
    """Counts the items that were taken."""

    def __init__(self, count):
        self.count, self.taken = count, 0

    def __iter__(self):
        for i in range(self.count):
            self.taken += 1
            yield i


def test_threads_keep_the_order():
    with open_workers() as found:
        assert found == Threads(os.cpu_count())
        assert list(found.map(lambda i, a: (time.sleep(0.002 * (i % 3)), i + a)[1], range(50), 7)) == [
            i + 7 for i in range(50)
        ]
        assert list(found.map(slow, [])) == []


def test_threads_take_items_a_bounded_number_ahead():
    threads, items = Threads(3), Counted(100)
    results = threads.map(abs, items)
    assert items.taken == 0
    for consumed in range(1, 60):
        next(results)
        assert items.taken < consumed + AHEAD_OF_THREADS * threads.count
    results.close()


def test_threads_drop_what_is_pending_when_closed_early():
    ran = []
    results = Threads(1).map(lambda i: (time.sleep(0.05), ran.append(i)), range(10))
    next(results)
    results.close()
    time.sleep(0.15)
    assert len(ran) <= 2


class Ending(Exception):
    pass


def ending_after(seconds):
    """A check that ends a map after so many seconds."""
    end = time.monotonic() + seconds

    def check():
        if time.monotonic() > end:
            raise Ending

    return check


def test_tasks_of_threads_end_within_a_second_of_a_stop_also_those_within_tasks():
    running = []

    def inner(i):
        running.append(i)
        try:
            for _ in range(1000):
                time.sleep(0.01)
                check_wanted()
        finally:
            running.remove(i)

    def outer(i):
        list(Threads(2).map(inner, range(10 * i, 10 * i + 5)))

    begin = time.monotonic()
    with pytest.raises(Ending):
        list(Threads(2).map(outer, range(4), check=ending_after(0.5)))
    assert time.monotonic() - begin < 1.5
    until(lambda: not running, 1)


def test_a_task_may_raise_what_waiting_raises():
    with pytest.raises(TimeoutError, match="its own"):
        list(Threads(1).map(fail, [TimeoutError("its own")]))


def test_threads_raise_what_a_task_raises():
    results = Threads(2).map(lambda i: 1 // (3 - i), range(100))
    assert [next(results) for _ in range(3)] == [0, 0, 1]
    with pytest.raises(ZeroDivisionError):
        next(results)


def test_tasks_that_want_to_be_alone_run_in_the_thread_of_the_caller():
    items = Counted(5)
    seen = []
    for thread in Threads(4).map(lambda i: threading.current_thread(), items, alone=True):
        seen.append(thread)
        assert items.taken == len(seen)
    assert seen == [threading.current_thread()] * 5


def test_a_cluster_gives_what_threads_give(cluster):
    array = np.arange(3_000_000.0)
    expected = list(Threads().map(scaled, range(30), array, 2.5))
    assert list(cluster.map(scaled, range(30), array, 2.5)) == expected
    assert list(cluster.map(scaled, range(3), array, 2.5, alone=True)) == expected[:3]
    assert list(cluster.map(lambda text: text + "!", ["a", "b"])) == ["a!", "b!"]
    assert list(cluster.map(slow, [])) == []


def test_workers_keep_blas_to_one_thread(cluster):
    assert all(set(found) == {1} for found in cluster.map(blas_threads, range(2)))


def test_a_cluster_takes_items_a_bounded_number_ahead(cluster):
    items = Counted(100)
    results = cluster.map(abs, items)
    for consumed in range(1, 40):
        next(results)
        assert items.taken < consumed + AHEAD_OF_CLUSTER * 2
    results.close()


def test_an_error_meant_for_the_user_arrives_as_it_is_and_is_not_tried_again(cluster, tmp_path):
    log = tmp_path / "log"
    results = cluster.map(refuse, range(5), log)
    assert [next(results) for _ in range(3)] == [0, 1, 2]
    with pytest.raises(InputError, match=r"^column 'phi' has 3 gaps; split the run there$"):
        next(results)
    assert log.read_text().split().count("3") == 1


@pytest.mark.parametrize("error", [NoModelError("rank", "nothing is left"), TimeoutError("late"), OSError(28, "full")])
def test_errors_arrive_with_type_and_text(cluster, error):
    with pytest.raises(type(error)) as caught:
        list(cluster.map(fail, [error]))
    assert type(caught.value) is type(error)
    assert str(caught.value) == str(error)
    if not isinstance(error, NoModelError):
        assert caught.traceback[-1].name == "fail"


def idle(cluster):
    client = cluster.client
    return not any(client.processing().values()) and not client.futures and not any(client.has_what().values())


def test_nothing_runs_after_an_early_end(cluster):
    results = cluster.map(slow, range(100))
    assert [next(results), next(results)] == [0, 1]
    results.close()
    until(lambda: idle(cluster), 10)


def test_nothing_runs_after_an_interrupt(cluster):
    def consume():
        for i in cluster.map(slow, range(100)):
            if i == 1:
                raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        consume()
    until(lambda: idle(cluster), 10)


def patient(i, folder):
    """Run for long, and leave a file when it is over."""
    (Path(folder) / f"begun{i}").touch()
    try:
        for _ in range(3000):
            time.sleep(0.01)
            check_wanted()
    finally:
        (Path(folder) / f"ended{i}").touch()


def test_tasks_of_a_cluster_end_within_a_second_of_a_stop(cluster, tmp_path):
    def check():
        if len(list(tmp_path.glob("begun*"))) == 2:
            raise Ending

    with pytest.raises(Ending):
        list(cluster.map(patient, range(4), tmp_path, check=check))
    until(lambda: len(list(tmp_path.glob("ended*"))) == 2, 1.5)
    until(lambda: idle(cluster), 10)


def test_another_version_of_odescope_is_refused(machines, monkeypatch):
    machines.staff(2)
    with open_workers(machines.address) as found:
        monkeypatch.setattr(module, "_version", lambda: "9.9")
        with pytest.raises(InputError, match=r"a worker on \S+ runs odescope .*, and this is odescope 9\.9"):
            list(found.map(slow, range(2)))
    with (
        pytest.raises(InputError, match=r"the scheduler runs odescope .*install odescope==9\.9"),
        open_workers(machines.address),
    ):
        pass


def test_another_server_is_no_scheduler(cluster, machines):
    (worker, *_) = cluster.client.nthreads()
    with (
        pytest.raises(InputError, match="answers a Dask worker; give the address that `dask scheduler`"),
        open_workers(worker),
    ):
        pass


def test_a_worker_that_dies_costs_its_task_and_not_the_run(cluster, machines, tmp_path):
    array = np.arange(300_000.0)
    results = list(cluster.map(die_once, range(60), array, tmp_path, {20}))
    assert results == [i + array.sum() for i in range(60)]
    assert sum(worker.poll() is None for worker in machines.workers) == 1


@pytest.mark.slow
def test_all_workers_die_and_another_comes(cluster, machines, tmp_path):
    """Nobody is left who holds what is shared: it is made anew."""
    array = np.arange(300_000.0)
    dying = list(machines.workers)

    def replace():
        for worker in dying:
            worker.wait()
        machines.hire()

    thread = threading.Thread(target=replace)
    thread.start()
    results = list(cluster.map(die_once, range(40), array, tmp_path, {10, 11}))
    thread.join()
    assert results == [i + array.sum() for i in range(40)]


def test_a_cluster_that_falls_apart_says_so(tmp_path, monkeypatch, capfd):
    monkeypatch.setattr(module, "FIRST_WORKER", 0.3)
    monkeypatch.setattr(module, "CONNECT", 3.0)
    monkeypatch.setattr(module, "LOOK", 0.2)
    monkeypatch.setattr(module, "DESERTED", 0.6)
    machines = Machines(tmp_path, DASK_DISTRIBUTED__SCHEDULER__ALLOWED_FAILURES="0")
    try:
        with (
            pytest.raises(InputError, match=r"has no worker after .* dask worker tcp://"),
            open_workers(machines.address),
        ):
            pass
        machines.hire()
        monkeypatch.setattr(module, "FIRST_WORKER", 30)
        with open_workers(machines.address) as found:
            with pytest.raises(WorkersLostError, match="died one after the other of the same task"):
                list(found.map(die, range(1)))
            with pytest.raises(WorkersLostError, match="has had no worker for 1 s; start workers"):
                list(found.map(slow, range(1)))
            results = found.map(slow, range(100))
            threading.Timer(0.1, machines.scheduler.kill).start()
            with pytest.raises(WorkersLostError, match="the connection to the scheduler at tcp"):
                list(results)
    finally:
        machines.stop()
    assert capfd.readouterr().err == ""
