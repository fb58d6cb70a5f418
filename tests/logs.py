"""Simulated logs for the tests of the command line, and the command line itself, run within the test's process."""

import sys
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from odescope.commands import cli

OSCILLATOR = "[coordinates.x]\norder = 2\n[inputs.u]\n"
OSCILLATOR_OPTIONS = ("--time", "t", "--coordinate", "x", "--input", "u", "--order", "2")


@dataclass(frozen=True)
class Ended:
    code: int
    out: str
    err: str


class Blank:
    """Stands in for the processes that draw: tests of the command line do not look at figures."""

    def begin(self, pictures):
        pass

    def paint(self, pictures):
        return {p.name: ('<svg viewBox="0 0 1 1"></svg>', b"") for p in pictures}


@contextmanager
def blank_painters():
    yield Blank()


class Command:
    """Calls `odescope ARGUMENT ...` as the console script does, figures left blank unless `drawing`."""

    def __init__(
        self, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], drawing: bool = False
    ) -> None:
        self.monkeypatch, self.capsys = monkeypatch, capsys
        if not drawing:
            monkeypatch.setattr("odescope.commands.run.painters", blank_painters)

    def __call__(self, *arguments: object) -> Ended:
        self.monkeypatch.setattr(sys, "argv", ["odescope", *map(str, arguments)])
        self.capsys.readouterr()
        with pytest.raises(SystemExit) as end:
            cli.main()
        return Ended(end.value.code or 0, *self.capsys.readouterr())

    def refused(self, *arguments: object, code: int = 2) -> str:
        """Return the one line on standard error of a call that must fail and change no file."""
        before = snapshot()
        ended = self(*arguments)
        assert (ended.code, ended.out) == (code, "")
        assert ended.err.startswith("odescope: ")
        assert ended.err.count("\n") == 1
        assert snapshot() == before
        return ended.err


def snapshot(folder: str = ".") -> dict[str, bytes | None]:
    """Return every path below the folder, with the content of those that are files."""
    return {str(p): p.read_bytes() if p.is_file() else None for p in sorted(Path(folder).rglob("*"))}


def write(path: str, columns: dict[str, np.ndarray], separator: str = ",") -> None:
    rows = zip(*(map(repr, c.tolist()) for c in columns.values()), strict=True)
    lines = [separator.join(columns), *map(separator.join, rows)]
    Path(path).write_text("\n".join(lines) + "\n", encoding="utf-8")


def smooth(rng: np.random.Generator, count: int, period: float, band: float, size: float) -> np.ndarray:
    spectrum = np.fft.rfft(rng.standard_normal(count))
    spectrum[np.fft.rfftfreq(count, period) > band] = 0.0
    found = np.fft.irfft(spectrum, count)
    return size * found / found.std()


def solved(right, start, t, u, held=False):
    """Integrate y' = right(y, u) with SciPy, sample by sample, so that no step runs over a kink of the input."""
    rows = [np.array(start, dtype=float)]
    for k in range(len(t) - 1):
        span = t[k + 1] - t[k]

        def slope(time, y, k=k, span=span):
            return right(y, u[k] if held else u[k] + (u[k + 1] - u[k]) * (time - t[k]) / span)

        rows.append(solve_ivp(slope, (t[k], t[k + 1]), rows[-1], "RK45", [t[k + 1]], rtol=1e-8, atol=1e-10).y[:, -1])
    return np.array(rows)


def oscillator(count: int = 1500, noise: float = 1e-3, held: bool = False, seed: int = 2) -> dict[str, np.ndarray]:
    """x'' = -4 x - 0.3 x' + u from x = 1, x' = 0.5, sampled each 0.02 s."""
    rng = np.random.default_rng(seed)
    t = 0.02 * np.arange(count)
    u = (
        np.repeat(4.0 * rng.standard_normal(count // 25 + 1), 25)[:count]
        if held
        else smooth(rng, count, 0.02, 1.0, 3.0)
    )
    a, b = np.array([[0.0, 1.0], [-4.0, -0.3]]), np.array([0.0, 1.0])
    x = linear(a, b, np.array([1.0, 0.5]), t, u, held)[:, 0]
    return {"t": t, "x": x + noise * rng.standard_normal(count), "u": u}


def linear(a, b, start, t, u, held):
    """Return the exact states of y' = a y + b u, u held or linear between samples, by one matrix exponential."""
    from scipy.linalg import expm

    n, step = len(a), t[1] - t[0]
    whole = np.zeros((n + 2, n + 2))
    whole[:n, :n], whole[:n, n], whole[n, n + 1] = a, b, 1.0
    power = expm(step * whole)
    states = [start]
    for k in range(len(t) - 1):
        rise = 0.0 if held else (u[k + 1] - u[k]) / step
        states.append(power[:n, :n] @ states[-1] + power[:n, n] * u[k] + power[:n, n + 1] * rise)
    return np.array(states)


def michaelis_menten(start: float, count: int = 700, noise: float = 1e-3) -> dict[str, np.ndarray]:
    """x' = 0.6 - 1.5 x/(0.3 + x), sampled each 0.01 s."""
    t = 0.01 * np.arange(count)
    run = solve_ivp(lambda _, x: 0.6 - 1.5 * x / (0.3 + x), (0, t[-1]), [start], t_eval=t, rtol=1e-10, atol=1e-12)
    rng = np.random.default_rng(int(100 * start))
    return {"t": t, "x": run.y[0] + noise * rng.standard_normal(count)}


def pendulum(count: int = 2000) -> dict[str, np.ndarray]:
    """theta'' = -9.81 sin(theta) - 0.2 theta' + u, wrapped to (-pi, pi], with units and all in the column names."""
    rng = np.random.default_rng(3)
    t = 0.01 * np.arange(count)
    u = smooth(rng, count, 0.01, 1.0, 8.0)
    run = solve_ivp(
        lambda time, y: [y[1], -9.81 * np.sin(y[0]) - 0.2 * y[1] + np.interp(time, t, u)],
        (0, t[-1]),
        [3.0, 2.0],
        t_eval=t,
        rtol=1e-8,
        atol=1e-10,
        max_step=0.05,
    )
    angle = run.y[0] + 1e-3 * rng.standard_normal(count)
    return {"Time (s)": t, "Winkel [rad]": np.mod(angle + np.pi, 2 * np.pi) - np.pi, "F;N": u}
