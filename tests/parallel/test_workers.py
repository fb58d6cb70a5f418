import os
import pickle
import signal
import subprocess
import sys
import threading
import time
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
from machines import Machines, until
from threadpoolctl import threadpool_info

import odescope.parallel.workers as module
from odescope import InputError, NoModelError
from odescope.errors import WorkersLostError
from odescope.parallel.workers import AHEAD_OF_CLUSTER, AHEAD_OF_THREADS, Threads, workers


@pytest.fixture(scope="module")
def machines(tmp_path_factory):
    found = Machines(tmp_path_factory.mktemp("machines"))
    yield found
    found.stop()


@pytest.fixture
def cluster(machines):
    """The cluster, with two workers that live."""
    machines.staff(2)
    with workers(machines.address) as found:
        until(lambda: found.count == 2)
        yield found


# Tasks ----------------------------------------------------------------------------------------------------------------


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


def die_once(i, array, folder, fatal):
    """Take the worker down with the task, the first time."""
    flag = Path(folder) / str(i)
    if i in fatal and not flag.exists():
        flag.touch()
        os.kill(os.getpid(), signal.SIGKILL)
    time.sleep(0.01)
    return i + array.sum()


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


# Threads --------------------------------------------------------------------------------------------------------------


def test_threads_keep_the_order():
    with workers() as found:
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


# A cluster ------------------------------------------------------------------------------------------------------------


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


def test_another_version_of_odescope_is_refused(machines, monkeypatch):
    machines.staff(2)
    with workers(machines.address) as found:
        monkeypatch.setattr(module, "_version", lambda: "9.9")
        with pytest.raises(InputError, match=r"a worker on \S+ runs odescope .*, and this is odescope 9\.9"):
            list(found.map(slow, range(2)))
    with (
        pytest.raises(InputError, match=r"the scheduler runs odescope .*install odescope==9\.9"),
        workers(machines.address),
    ):
        pass


def test_another_server_is_no_scheduler(cluster, machines):
    (worker, *_) = cluster.client.nthreads()
    with (
        pytest.raises(InputError, match="answers a Dask worker; give the address that `dask scheduler`"),
        workers(worker),
    ):
        pass


def test_a_worker_that_dies_costs_its_task_and_not_the_run(cluster, machines, tmp_path):
    array = np.arange(300_000.0)
    results = list(cluster.map(die_once, range(60), array, tmp_path, {20}))
    assert results == [i + array.sum() for i in range(60)]
    assert sum(worker.poll() is None for worker in machines.workers) == 1


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
        with pytest.raises(InputError, match=r"has no worker after .* dask worker tcp://"), workers(machines.address):
            pass
        machines.hire()
        monkeypatch.setattr(module, "FIRST_WORKER", 30)
        with workers(machines.address) as found:
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


# What is no cluster ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("text", ["", "Local", "http://host:8786", "tcp://host", "host:8786", "tcp://host:8786/x"])
def test_texts_that_name_no_cluster(text):
    with pytest.raises(InputError, match=f"tcp://HOST:8786; '{text}' came"), workers(text):
        pass


def test_dask_that_is_not_installed(monkeypatch):
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(InputError, match=r"pip install 'odescope\[cluster\]'"), workers("local"):
        pass


@contextmanager
def silent_port():
    """A server that takes connections and never says a word."""
    import socket

    with socket.create_server(("127.0.0.1", 0)) as server:
        yield server.getsockname()[1]


def test_a_port_where_nobody_answers(monkeypatch):
    monkeypatch.setattr(module, "CONNECT", 0.5)
    with silent_port() as port:
        begin = time.monotonic()
        with (
            pytest.raises(InputError, match=f"no Dask scheduler answers at tcp://127.0.0.1:{port} "),
            workers(f"tcp://127.0.0.1:{port}"),
        ):
            pass
        assert time.monotonic() - begin < 10
    with pytest.raises(InputError, match="no Dask scheduler answers"), workers(f"tcp://127.0.0.1:{port}"):
        pass
    with pytest.raises(InputError, match="no Dask scheduler answers at tls://"), workers(f"tls://127.0.0.1:{port}"):
        pass


# This machine as a cluster --------------------------------------------------------------------------------------------

LOCAL = """
import os, sys, time
os.cpu_count = lambda: 2
from odescope.parallel.workers import workers

def task(i, more):
    return i + more

def busy(i):
    end = time.monotonic() + 60
    while time.monotonic() < end:
        sum(range(1000))

if __name__ == "__main__":
    try:
        with workers("local") as found:
            print(found.count, list(found.map(task, range(5), 10)), flush=True)
            for _ in found.map(busy, range(9)):
                pass
    except KeyboardInterrupt:
        print("stopped", flush=True)
"""


def test_processes_of_this_machine_end_with_an_interrupt_and_without_a_word(tmp_path):
    script = tmp_path / "script.py"
    script.write_text(LOCAL)
    with subprocess.Popen(
        [sys.executable, str(script)], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, start_new_session=True
    ) as process:
        assert process.stdout.readline() == "2 [10, 11, 12, 13, 14]\n"
        time.sleep(0.5)
        begin = time.monotonic()
        os.killpg(process.pid, signal.SIGINT)  # as a terminal does it: to the workers as well
        out, err = process.communicate(timeout=30)
    assert (out, err, process.returncode) == ("stopped\n", "", 0)
    assert time.monotonic() - begin < 10


def test_importing_is_light():
    heavy = "{'numpy', 'dask', 'distributed', 'threadpoolctl'}"
    code = f"import sys, odescope.parallel.workers; print({heavy} & set(sys.modules) or 'none')"
    assert subprocess.run([sys.executable, "-c", code], capture_output=True, text=True).stdout == "none\n"


@pytest.mark.parametrize("error", [InputError("a"), NoModelError("rank", "b"), WorkersLostError("c")])
def test_errors_travel(error):
    found = pickle.loads(pickle.dumps(error))  # noqa: S301
    assert (type(found), str(found), vars(found)) == (type(error), str(error), vars(error))
