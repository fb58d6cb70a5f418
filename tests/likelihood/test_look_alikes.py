"""Terms that a record hardly tells from others are named, and those that it tells are not."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from odescope.pipeline.identification import identify
from odescope.study.options import Data, Driven, Measured, Study

SEEDS = [0, *(pytest.param(k, marks=pytest.mark.slow) for k in (1, 2))]
STUDY = Study(
    data=Data(time="t"), coordinates={"phi": Measured(order=2, angle=True)}, inputs={"u": Driven(hold="linear")}
)


def pendulum(seed, count, size):
    """Return a log of a driven pendulum that swings up to an angle, at 3 % noise."""
    rng, t = np.random.default_rng(seed), 0.05 * np.arange(count)
    f, phase = rng.uniform(0.05, 0.8, 8), rng.uniform(0.0, 2.0 * np.pi, 8)
    u = size * np.sin(2.0 * np.pi * np.multiply.outer(t, f) + phase).sum(axis=1)

    def rate(now, z):
        return [z[1], -4.0 * np.sin(z[0]) - 0.3 * z[1] + 1.5 * np.interp(now, t, u)]

    phi = solve_ivp(rate, (0.0, t[-1]), [0.6 * size, 0.0], t_eval=t, rtol=1e-8, atol=1e-10, max_step=0.05).y[0]
    return {"t": t, "phi": phi + 0.03 * phi.std() * rng.standard_normal(count), "u": u}


def look_alikes(result):
    return [note for note in result.warnings if note.startswith("look-alikes")]


@pytest.mark.parametrize("seed", SEEDS)
def test_a_short_swing_does_not_tell_a_sine_or_a_drag_from_their_likes(seed):
    (said,) = look_alikes(identify(STUDY, pendulum(seed, 70, 0.4)))
    assert "in phi_ddot or " in said


@pytest.mark.parametrize("seed", SEEDS)
def test_a_long_record_of_large_swings_tells_every_term(seed):
    result = identify(STUDY, pendulum(seed, 1500, 1.0))
    assert {t.text for t in result.model.relations[0].terms} == {"phi_ddot", "sin(phi)", "phi_dot", "u"}
    assert look_alikes(result) == []
