"""Two bodies that radiate at each other, in a furnace whose wall is warm."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from odescope.pipeline.identification import identify
from odescope.study.options import Data, Driven, Measured, Study

EXCHANGED, PART = 3e-11, 1.2e-11


def furnace(seed, size):
    """Return a log of T1' = .6 P - a (T1^4 - T2^4) - .01 (T1 - Tw), T2' = b (T1^4 - T2^4) - .006 (T2 - Tw).

    Args:
        seed: of heating and noise.
        size: of what is radiated, 1 for that.
    """
    rng, t = np.random.default_rng(seed), 2.0 * np.arange(1500)
    power = np.repeat(rng.uniform(0.0, 60.0, 15), 100)
    f, phase = rng.uniform(6e-4, 3e-3, 5), rng.uniform(0.0, 6.3, 5)
    wall = 330.0 + 10.0 * np.sin(2.0 * np.pi * np.multiply.outer(t, f) + phase).sum(axis=1)

    def rate(now, state):
        one, two = state
        over, outside = size * (one**4 - two**4), wall[min(int(now / 2.0 + 0.5), len(t) - 1)]
        heat = 0.6 * power[min(int(now / 2.0 + 1e-9), len(t) - 1)]
        return [heat - EXCHANGED * over - 0.01 * (one - outside), PART * over - 0.006 * (two - outside)]

    read = solve_ivp(rate, (0.0, t[-1]), [400.0, 350.0], t_eval=t, rtol=1e-8, atol=1e-6, max_step=1.0).y
    read = read + 0.003 * read.std(axis=1, keepdims=True) * rng.standard_normal(read.shape)
    return {"t": t, "T1_K": read[0], "T2_K": read[1], "P": power, "Tw_K": wall}


def terms_of(log):
    study = Study(
        data=Data(time="t"),
        coordinates={"T1_K": Measured(), "T2_K": Measured()},
        inputs={"P": Driven(hold="zero"), "Tw_K": Driven()},
    )
    return [{t.text: t for t in r.terms} for r in identify(study, log).model.relations]


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(3))
def test_what_two_bodies_radiate_at_each_other_is_found_in_both_balances(seed):
    one, two = terms_of(furnace(seed, 1.0))
    assert set(one) == {"T1_K_dot", "P", "T1_K", "Tw_K", "T1_K**4", "T2_K**4"}
    assert set(two) == {"T2_K_dot", "T2_K", "Tw_K", "T1_K**4", "T2_K**4"}
    for terms, size in ((one, EXCHANGED), (two, -PART)):
        for name, value in {"T1_K**4": size, "T2_K**4": -size}.items():
            assert abs(terms[name].coefficient - value) < 4.0 * terms[name].std_error


@pytest.mark.slow
def test_where_heat_is_only_lost_in_proportion_nothing_radiates():
    one, two = terms_of(furnace(0, 0.0))
    assert set(one) == {"T1_K_dot", "P", "T1_K", "Tw_K"}
    assert set(two) == {"T2_K_dot", "T2_K", "Tw_K"}
