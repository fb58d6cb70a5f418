"""What is no cluster, and this machine's own processes as one."""

import os
import pickle
import signal
import subprocess
import sys
import time
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
from machines import until
from worker_tasks import die_once

import odescope.parallel.dask_cluster as module
from odescope import InputError, NoModelError
from odescope.errors import WorkersLostError
from odescope.parallel.dask_cluster import open_workers


@pytest.mark.parametrize("text", ["", "Local", "http://host:8786", "tcp://host", "host:8786", "tcp://host:8786/x"])
def test_texts_that_name_no_cluster(text):
    with pytest.raises(InputError, match=f"tcp://HOST:8786; '{text}' came"), open_workers(text):
        pass


def test_dask_that_is_not_installed(monkeypatch):
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(InputError, match=r"pip install 'odescope\[cluster\]'"), open_workers("local"):
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
            open_workers(f"tcp://127.0.0.1:{port}"),
        ):
            pass
        assert time.monotonic() - begin < 10
    with pytest.raises(InputError, match="no Dask scheduler answers"), open_workers(f"tcp://127.0.0.1:{port}"):
        pass
    with (
        pytest.raises(InputError, match="no Dask scheduler answers at tls://"),
        open_workers(f"tls://127.0.0.1:{port}"),
    ):
        pass


UNGUARDED = """
import os
os.cpu_count = lambda: 2
import numpy as np
import odescope as od
from odescope.signals.differentiators import Spectral

class Own:  # travels by value
    def derivatives(self, channel, period, order):
        return Spectral().derivatives(channel, period, order)

t = np.arange(0.0, 30.0, 0.02)
x = np.exp(-0.3 * t) * np.cos(2.0 * t) + 1e-3 * np.random.default_rng(0).standard_normal(len(t))
study = od.Study(
    data=od.Data(time="t"),
    coordinates={"x": od.Measured(order=2)},
    library=od.Candidates(basis=("x", "x_dot"), degree=1),
    signals=od.Filtering(differentiator=Own()),
)
print(od.to_text(od.identify(study, {"t": t, "x": x}, cluster="local").model, digits=2))
"""


@pytest.mark.slow
def test_a_script_without_a_guard_runs_once(tmp_path):
    script = tmp_path / "script.py"
    script.write_text(UNGUARDED)
    ended = subprocess.run([sys.executable, str(script)], cwd=tmp_path, capture_output=True, text=True, timeout=120)
    assert (ended.returncode, ended.stderr) == (0, "")
    assert ended.stdout.count("x_ddot = ") == 1


ORPHANS = """
import os, time
os.cpu_count = lambda: 2
from odescope.parallel.dask_cluster import open_workers

def busy(i):
    while True:
        time.sleep(0.01)

with open_workers("local") as found:
    print(*found.map(lambda _: os.getpid(), range(6)), flush=True)
    list(found.map(busy, range(2)))
"""


@pytest.mark.skipif(not Path("/proc").exists(), reason="/proc tells what runs")
def test_local_processes_do_not_outlive_a_process_that_is_killed(tmp_path):
    with subprocess.Popen([sys.executable, "-c", ORPHANS], stdout=subprocess.PIPE, text=True, cwd=tmp_path) as process:
        own = {int(pid) for pid in process.stdout.readline().split()}
        assert own
        assert process.pid not in own
        process.kill()
    until(lambda: not any(Path(f"/proc/{pid}").exists() for pid in own), 5)


def test_a_local_process_that_dies_is_replaced(monkeypatch, tmp_path):
    monkeypatch.setattr(os, "cpu_count", lambda: 1)
    array = np.arange(10.0)
    with open_workers("local") as found:
        assert list(found.map(die_once, range(6), array, tmp_path, {2})) == [i + 45.0 for i in range(6)]


LOCAL = """
import os, sys, time
os.cpu_count = lambda: 2
from odescope.parallel.dask_cluster import open_workers

def task(i, more):
    return i + more

def busy(i):
    end = time.monotonic() + 60
    while time.monotonic() < end:
        sum(range(1000))

try:
    with open_workers("local") as found:
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
    code = f"import sys, odescope.parallel.dask_cluster; print({heavy} & set(sys.modules) or 'none')"
    assert subprocess.run([sys.executable, "-c", code], capture_output=True, text=True).stdout == "none\n"


@pytest.mark.parametrize("error", [InputError("a"), NoModelError("rank", "b"), WorkersLostError("c")])
def test_errors_travel(error):
    found = pickle.loads(pickle.dumps(error))  # noqa: S301
    assert (type(found), str(found), vars(found)) == (type(error), str(error), vars(error))
