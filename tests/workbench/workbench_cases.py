"""A workbench as a process of its own, with a browser before it, for tests of its pages."""

import os
import re
import shutil
import subprocess
import sys
import time
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from odescope.library.parse import Scope, parse_term
from odescope.library.product import Product
from odescope.model.model import Model
from odescope.model.relation import Relation, RelationTerm
from odescope.recordings.coordinate import Coordinate, Input

CHROMIUM = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
AXE = Path(__file__).parent.parent.parent / "build" / "axe-core" / "axe.min.js"  # .ci/run puts it there
PATIENCE = 90_000  # milliseconds, of a machine that does much else


def decay(path, name="c", seed=0):
    """Write a log of 200 samples, which is identified in seconds."""
    t = 0.05 * np.arange(200)
    c = 2.0 * np.exp(-0.5 * t) + 0.005 * np.random.default_rng(seed).standard_normal(200)
    rows = "".join(f"{a!r},{b!r}\n" for a, b in zip(t.tolist(), c.tolist(), strict=True))
    path.write_text(f'"t","{name}"\n{rows}', encoding="utf-8")
    return path


def shaken(path):
    """Write a log of three oscillators that are shaken at random, whose search takes minutes."""
    rng, step = np.random.default_rng(0), 0.02
    x, v, rows = np.zeros(3), np.zeros(3), ["t,p,q,r"]
    for k in range(20_000):
        rows.append(",".join(map(repr, (k * step, *(x + 1e-3 * rng.standard_normal(3)).tolist()))))
        v = v + step * (np.roll(x, -1) + np.roll(x, 1) - 3.0 * x - np.sin(x) - 0.1 * v + 3.0 * rng.standard_normal(3))
        x = x + step * v
    path.write_text("\n".join(rows) + "\n", encoding="utf-8")
    return path


def chain(path):
    """Write a log of a -> b -> nothing, whose path has several models."""
    t = 0.05 * np.arange(300)
    a = 2.0 * np.exp(-0.5 * t)
    b = 2.0 * 0.5 / (0.3 - 0.5) * (np.exp(-0.5 * t) - np.exp(-0.3 * t))
    rng = np.random.default_rng(0)
    columns = [t, a + 0.003 * rng.standard_normal(300), b + 0.003 * rng.standard_normal(300)]
    rows = "".join(",".join(map(repr, row)) + "\n" for row in np.array(columns).T.tolist())
    path.write_text(f"t,a,b\n{rows}")
    return path


def heater(**fields):
    """A model of a temperature that a voltage drives, within a few degrees, beside an oscillator."""
    scope = Scope.of(["T", "x", "x_dot", "u"])

    def relation(*terms):
        return Relation(tuple(RelationTerm(Product(factor, parse_term(term, scope)), c) for factor, term, c in terms))

    return Model(
        (Coordinate("T", 1, unit="K", offset=0.5), Coordinate("x", 2)),
        (Input("u", "zero", "V"),),
        (
            relation(("T_dot", "1", 1.0), (None, "u", -0.3), (None, "T", 0.01)),
            relation(("x_ddot", "1", 1.0), (None, "x", 4.0), (None, "u", -0.1)),
        ),
        domain={"T": (295.0, 300.0), "x": (-1.0, 2.0), "x_dot": (-2.0, 2.0), "u": (9.0, 11.0)},
        **fields,
    )


class Served:
    """A workbench that runs, by its address and its process."""

    def __init__(self, folder, log):
        self.folder = folder
        command = [sys.executable, "-m", "odescope", "workbench", str(folder), "--no-browser"]
        with log.open("wb") as errors:
            self.process = subprocess.Popen(
                command, stdin=subprocess.DEVNULL, stdout=errors, stderr=errors, cwd=log.parent, env=dict(os.environ)
            )
        until = time.monotonic() + 180.0
        while not (found := re.search(r"http://\S+", log.read_text())):
            assert self.process.poll() is None, log.read_text()
            assert time.monotonic() < until, "the workbench does not begin"
            time.sleep(0.1)
        self.address = found[0]
        self.base = self.address.split("/?")[0]

    @property
    def port(self):
        return int(self.base.rpartition(":")[2])


@contextmanager
def served(folder, log):
    one = Served(folder, log)
    try:
        yield one
    finally:
        one.process.kill()
        one.process.wait()


@contextmanager
def browser():
    from playwright.sync_api import sync_playwright

    with sync_playwright() as play:
        one = play.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox", "--disable-gpu"])
        try:
            yield one
        finally:
            one.close()


class Visit:
    """Pages of a workbench in one browser window, and all that went wrong on them."""

    def __init__(self, chromium, workbench, width=1280):
        self.context = chromium.new_context(viewport={"width": width, "height": 900})
        self.context.set_default_timeout(PATIENCE)
        self.base, self.wrong = workbench.base, []
        self.context.on("request", self._asked)
        self.page = self.tab()
        self.page.goto(workbench.address)

    def tab(self):
        page = self.context.new_page()
        page.on("console", lambda m: self.wrong.append(m.text) if m.type in ("error", "warning") else None)
        page.on("pageerror", lambda e: self.wrong.append(str(e)))
        page.on("dialog", lambda d: (self.wrong.append(f"dialog {d.message}"), d.dismiss()))
        return page

    def _asked(self, request):
        if not request.url.startswith((self.base, "data:", "blob:")):
            self.wrong.append(f"asked for {request.url}")

    def go(self, path, heading=None):
        self.page.goto(self.base + path)
        if heading is not None:
            self.page.get_by_role("heading", level=1, name=heading, exact=True).wait_for()

    def says(self, text):
        self.page.get_by_text(text).first.wait_for()
