"""A real Dask scheduler on loopback, and workers that can be killed."""

import json
import os
import subprocess
import sys
import time
from pathlib import Path

HERE = Path(__file__).parent


class Machines:
    """A Dask scheduler and its workers, each a process; workers import the tasks below from this file."""

    def __init__(self, folder, **settings):
        self.folder = folder
        path = [str(HERE), str(HERE / "parallel"), *filter(None, [os.environ.get("PYTHONPATH")])]
        self.environment = {**os.environ, "PYTHONPATH": os.pathsep.join(path), **settings}
        known = folder / "scheduler.json"
        self.scheduler = self.start(
            "scheduler", "--host", "127.0.0.1", "--port", "0", "--no-dashboard", "--scheduler-file", str(known)
        )
        until(lambda: known.exists() and known.read_text().endswith("}"))  # it is there before it is written
        self.address = json.loads(known.read_text())["address"]
        self.workers = []

    def start(self, kind, *arguments):
        return subprocess.Popen(
            [sys.executable, "-m", "dask", kind, *arguments],
            cwd=self.folder,
            env=self.environment,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )

    def hire(self):
        own = ("--nthreads", "1", "--no-nanny", "--no-dashboard", "--local-directory", str(self.folder))
        self.workers.append(self.start("worker", self.address, *own))

    def staff(self, count):
        """Replace the workers that died."""
        self.workers = [worker for worker in self.workers if worker.poll() is None]
        while len(self.workers) < count:
            self.hire()

    def stop(self):
        for process in (*self.workers, self.scheduler):
            process.kill()
            process.wait()


def until(true, seconds=60.0):
    end = time.monotonic() + seconds
    while not true():
        assert time.monotonic() < end, "it never came about"
        time.sleep(0.02)
