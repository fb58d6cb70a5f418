"""Constants of functions by variable projection, against least squares in constants and coefficients at once."""

import numpy as np
import pytest
from scipy.optimize import least_squares

from odescope.library.constants import Constant
from odescope.library.expression import ONE
from odescope.library.families import families_of
from odescope.likelihood.imitation import Imitated, Placed, Samples, choices_of

NAMES = ["level_z", "order_z"]
Z = np.linspace(0.2, 5.0, 300)
RATE = next(c for c in choices_of(families_of("z", Z, ()), (ONE,)) if [k.name for k in c.constants] == NAMES)


def fitted(said, level, order, steps=60):
    found = Imitated(said, np.array([np.ones_like(Z), Z]), Samples({"z": Z}))
    return found.fitted([Placed(RATE, dict(zip(NAMES, (level, order), strict=True)))], found.beside(found.base), steps)


def rate(level, order):
    return Z**order / (level**order + Z**order)


@pytest.mark.parametrize("seed", range(5))
def test_constants_are_those_of_least_squares_in_everything_at_once(seed):
    rng = np.random.default_rng(seed)
    level, order = rng.uniform(1.0, 3.0), rng.uniform(2.0, 5.0)
    said = 0.4 - 0.2 * Z + 3.0 * rate(level, order) + 0.02 * rng.standard_normal(len(Z))
    squares, (placed,) = fitted(said, 1.2 * level, 0.8 * order)
    every = least_squares(lambda p: p[0] + p[1] * Z + p[2] * rate(p[3], p[4]) - said, [0.4, -0.2, 3.0, level, order])
    assert squares == pytest.approx(2.0 * every.cost, rel=1e-3)
    assert [placed.values[n] for n in NAMES] == pytest.approx(every.x[3:], rel=5e-3)


def test_a_constant_beyond_its_range_stays_at_its_end_and_the_other_is_the_best_there():
    level: Constant = RATE.constants[0]
    said = 3.0 * rate(3.0 * level.high, 2.5)
    squares, (placed,) = fitted(said, 0.5 * level.high, 2.0)
    assert placed.values["level_z"] == pytest.approx(level.high)
    columns = [np.column_stack([np.ones_like(Z), Z, rate(level.high, p)]) for p in np.linspace(1.5, 6.0, 400)]
    assert squares <= 1.01 * min(float(np.linalg.lstsq(c, said)[1][0]) for c in columns)


def test_without_steps_the_squares_are_those_where_it_begins():
    said = np.log(Z)
    squares, (placed,) = fitted(said, 1.7, 3.0, steps=0)
    columns = np.column_stack([np.ones_like(Z), Z, rate(1.7, 3.0)])
    assert squares == pytest.approx(float(np.linalg.lstsq(columns, said)[1][0]))
    assert placed.values == pytest.approx({"level_z": 1.7, "order_z": 3.0})
