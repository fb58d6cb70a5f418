"""Recordings of which one is noisier than the other: the law of both, at the weight of each."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from odescope.pipeline.identification import identify
from odescope.study.options import Data, Driven, Measured, Study

END, PERIOD = 20.0, 0.01
TRUTH = {"sin(q)": -16.35, "q_dot": -0.3, "u": 1.0}


def swings(noises, seed):
    """Return recordings of a driven pendulum, whose readings of q are off by so much each."""
    rng, t, logs = np.random.default_rng(seed), np.arange(0.0, END, PERIOD), []
    for noise in noises:
        pushes, phases = rng.uniform(0.5, 1.5, 4), rng.uniform(0.0, 6.0, 4)

        def push(now, pushes=pushes, phases=phases):
            return sum(
                p * np.sin((1.0 + 0.9 * k) * now + f) for k, (p, f) in enumerate(zip(pushes, phases, strict=True))
            )

        x = solve_ivp(
            lambda now, s, push=push: [s[1], push(now) - 16.35 * np.sin(s[0]) - 0.3 * s[1]],
            (0.0, END),
            [rng.uniform(-1.0, 1.0), 0.0],
            t_eval=t,
            rtol=1e-9,
            atol=1e-11,
        ).y[0]
        logs.append({"t": t, "q": x + noise * rng.standard_normal(len(t)), "u": push(t)})
    return logs


STUDY = Study(data=Data(time="t"), coordinates={"q": Measured(order=2, angle=True)}, inputs={"u": Driven()})


@pytest.mark.parametrize(
    ("noises", "seed"),
    [
        ((1e-3, 4e-3), 0),
        *(pytest.param((1e-3, loud), s, marks=pytest.mark.slow) for loud in (4e-3, 1e-2) for s in (1, 2)),
    ],
)
def test_a_recording_that_is_noisier_is_no_noise_of_the_process(noises, seed):
    result = identify(STUDY, swings(noises, seed))
    assert result.refinement.exact
    assert 0.85 < result.refinement.scale < 1.15
    found = {row.term: row for row in result.coefficients if row.kind == "term"}
    assert set(found) == set(TRUTH)
    assert all(abs(found[term].coefficient - value) < 4.0 * found[term].std_error for term, value in TRUTH.items())


def test_the_quieter_recording_is_not_lost_for_the_louder_one():
    both = identify(STUDY, swings((1e-3, 4e-3), 0)).coefficients
    alone = identify(STUDY, swings((1e-3, 4e-3), 0)[:1]).coefficients
    errors = [{row.term: row.std_error for row in rows if row.kind == "term"} for rows in (both, alone)]
    assert all(errors[0][term] < 1.05 * errors[1][term] for term in TRUTH)
