"""Products of a higher degree than the default library has, where that does not follow the record."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from odescope.pipeline.identification import identify
from odescope.study.library_options import Candidates
from odescope.study.options import Data, Measured, Study

pytestmark = pytest.mark.slow

T = np.linspace(0.0, 8.0, 160)


def logged(rate, start, noise):
    values = solve_ivp(lambda _, x: rate(x), (0.0, 8.0), [start], t_eval=T, rtol=1e-10, atol=1e-12).y[0]
    return {"t": T, "x": values + noise * values.std() * np.random.default_rng(0).standard_normal(len(T))}


def terms(log, **library):
    study = Study(data=Data(time="t"), coordinates={"x": Measured()}, library=Candidates(**library))
    relation = identify(study, log).model.relations[0]
    return {t.product.text for t in relation.terms}


@pytest.fixture(scope="module")
def quintic():
    return logged(lambda x: 0.15 * x + 0.05 * x**3 - 0.002 * x**5, 0.8, 0.0)


def test_a_law_of_degree_five_is_found(quintic):
    assert terms(quintic) == {"x_dot", "x", "x**3", "x**5"}


def test_a_library_by_hand_and_one_without_suspicion_stay_as_they_are(quintic):
    assert not {"x**4", "x**5", "x**6"} & terms(quintic, basis=("x",), degree=3)
    assert not {"x**4", "x**5", "x**6"} & terms(quintic, suspect=False)


def test_a_quotient_that_is_the_law_stays():
    assert terms(logged(lambda x: 1.0 - 1.6 * x / (0.5 + x), 3.0, 0.005)) == {"x_dot", "x_dot*x", "1", "x"}
