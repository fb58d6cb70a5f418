"""A log that a solver wrote at its usual tolerance is known by the polynomials between its steps."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from odescope.recordings.coordinate import Coordinate
from odescope.recordings.record import Record, Records
from odescope.signals.solved import solver_hints

SYSTEMS = {
    "spring": (lambda t, x: [x[1], -4.0 * x[0] - 0.3 * x[1]], [1.0, 0.0], 25.0, 1000),
    "Lorenz": (
        lambda t, x: [10.0 * (x[1] - x[0]), x[0] * (28.0 - x[2]) - x[1], x[0] * x[1] - 8.0 / 3.0 * x[2]],
        [1.0, 1.0, 1.0],
        20.0,
        2000,
    ),
    "decay": (lambda t, x: [-x[0], x[0] - 0.4 * x[1]], [1.0, 0.0], 15.0, 300),
}


def said_of(columns, t):
    names = tuple("abc"[: len(columns)])
    records = Records((Record(t, np.transpose(columns).copy(), names, (None,) * len(names)),))
    return solver_hints(records, [Coordinate(name) for name in names])


def solved(system, **options):
    f, start, end, count = SYSTEMS[system]
    t = np.linspace(0.0, end, count)
    return solve_ivp(f, (0.0, end), start, t_eval=t, **options), t


@pytest.mark.parametrize("system", SYSTEMS)
def test_its_usual_tolerance_is_told_and_what_to_write_instead(system):
    found, t = solved(system)
    (hint,) = said_of(found.y, t)
    assert "rtol=1e-9" in hint
    steps = float(hint.split("each ")[1].split(" s long")[0])
    f, start, end, _ = SYSTEMS[system]
    taken = len(solve_ivp(f, (0.0, end), start).t)
    assert end / taken == pytest.approx(steps, rel=0.5)


@pytest.mark.parametrize("system", SYSTEMS)
def test_what_is_exact_or_rounded_or_noisy_is_not(system):
    found, t = solved(system, rtol=1e-9, atol=1e-12)
    assert said_of(found.y, t) == ()
    loose = solved(system)[0].y
    assert said_of(np.round(loose, 6), t) == ()
    assert said_of(loose + 1e-9 * np.random.default_rng(0).standard_normal(loose.shape), t) == ()


@pytest.mark.parametrize(
    "curve", [np.sin, np.exp, lambda t: 0.5 * t**2 * (t < 2.0), lambda t: np.abs(np.mod(t, 2.0) - 1.0)]
)
def test_nor_are_curves_parabolas_and_lines_in_pieces(curve):
    t = np.linspace(0.0, 6.0, 3000)
    assert said_of([curve(t)], t) == ()


def test_nor_is_a_counter_however_it_walks():
    for seed in range(200):
        walk = np.cumsum(np.random.default_rng(seed).integers(-1, 2, 60)).astype(float)
        assert said_of([walk], np.arange(60.0)) == ()
