"""Records that are quick at first and slow ever after: what regression proposes of the beginning runs away."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from odescope.pipeline.identification import identify
from odescope.study.options import Data, Driven, Measured, Study

STEP, ROWS, NOISE = 0.5, 1200, 0.02
LAW = {
    "A_dot": {"A*B**2": -4.0, "F": 1.0, "A*F": -1.0},
    "B_dot": {"A*B**2": 4.0, "B*F": -1.0, "B": -0.04, "1": 0.001},
}


def log(seed):
    """A + 2 B -> 3 B in a stirred tank, B fed and dying slowly, under a feed of A that is held a minute."""
    rng = np.random.default_rng(seed)
    feed = np.repeat(rng.uniform(0.03, 0.07, 10), ROWS // 10)
    states, state = [], np.array([0.5, 0.25])
    for f in feed:
        states.append(state)
        state = solve_ivp(
            lambda _, s, f=f: [
                f * (1.0 - s[0]) - 4.0 * s[0] * s[1] ** 2, 4.0 * s[0] * s[1] ** 2 - (f + 0.04) * s[1] + 0.001
            ],
            (0.0, STEP), state, rtol=1e-9, atol=1e-11,
        ).y[:, -1]  # fmt: skip
    clean = np.array(states)
    a, b = (clean + NOISE * clean.std(axis=0) * rng.standard_normal(clean.shape)).T
    return {"t": STEP * np.arange(ROWS), "A": a, "B": b, "F": feed}


@pytest.mark.parametrize("seed", [0, *(pytest.param(k, marks=pytest.mark.slow) for k in range(1, 8))])
def test_a_fast_reaction_and_a_slow_tank_are_found_from_nothing(seed):
    coordinates = {"A": Measured(), "B": Measured()}
    model = identify(Study(data=Data(time="t"), coordinates=coordinates, inputs={"F": Driven()}), log(seed)).model
    for relation, (target, law) in zip(model.relations, LAW.items(), strict=True):
        terms = {t.text: t for t in relation.terms}
        assert terms.pop(target).coefficient == 1.0
        assert terms.keys() == law.keys()
        for text, term in terms.items():
            assert abs(-term.coefficient - law[text]) < 4.0 * term.std_error
