"""Exponentials about the middle of their argument: the same functions, and fits that know their coefficients."""

from dataclasses import replace

import numpy as np
import pytest
from process_cases import cut
from scipy.integrate import solve_ivp

from odescope.library.constants import Constant
from odescope.library.mechanism import Mechanism, candidate
from odescope.library.parse import Scope, parse_term
from odescope.library.product import Product
from odescope.library.tape import evaluate, write_tape
from odescope.likelihood.centring import Centring
from odescope.likelihood.evaluator import Evaluator
from odescope.likelihood.program import Frame
from odescope.likelihood.search_space import SearchSpace
from odescope.likelihood.settings import Start
from odescope.recordings.coordinate import Coordinate

NAMES = ["c", "T", "q"]
CONSTANTS = {"E": Constant("E", 1e3, 2e4, 4e3), "p": Constant("p", -1.0, 3.0, 0.5)}
SCOPE = Scope.of(NAMES, constants=list(CONSTANTS))
TERMS = ["c*exp(-E/T)", "exp(-E/T)/exp(-2.0*E/T)", "c**p*exp(-E/T)", "T**p/exp(-E/T)", "exp(p*q - E/T)", "c*T"]


def mechanism(text, relation=0):
    return candidate(relation, Product(None, parse_term(text, SCOPE)), "c_dot")


def settings():
    return [Mechanism("constant", f"constant {name}", name, (), 0.0) for name in CONSTANTS]


@pytest.fixture(scope="module")
def values():
    rng = np.random.default_rng(0)
    return np.vstack([rng.uniform(0.2, 2.0, 500), rng.uniform(300.0, 380.0, 500), rng.uniform(-1.0, 3.0, 500)])


@pytest.fixture(scope="module")
def centring(values):
    return Centring.of([mechanism(t) for t in TERMS], CONSTANTS, NAMES, values)


def evaluated(terms, values, **constants):
    rows = [np.full(values.shape[1], v) for v in constants.values()]
    return evaluate(write_tape([*NAMES, *constants], terms), np.vstack([values, *rows]))


@pytest.mark.parametrize("text", TERMS)
@pytest.mark.parametrize(("energy", "power"), [(2e3, 1.5), (9e3, -0.7)])
def test_a_coefficient_says_of_a_centred_term_what_another_says_of_the_term(centring, values, text, energy, power):
    one, constants = mechanism(text), {"E": energy, "p": power}
    plain, centred = evaluated(
        [parse_term(text, SCOPE), centring.centred(parse_term(text, SCOPE))], values, **constants
    )
    np.testing.assert_allclose(centred, centring.sizes([one], constants)[0] * plain, rtol=1e-12)


@pytest.mark.parametrize("text", TERMS[:-1])
def test_the_logarithm_of_a_centred_exponential_has_a_mean_without_its_constants(centring, values, text):
    plain = parse_term(text, SCOPE)
    means = [
        np.log(evaluated([centring.centred(plain)], values, E=energy, p=power)).mean()
        for energy in (2e3, 9e3)
        for power in (-0.7, 1.5)
    ]
    np.testing.assert_allclose(means, means[0], atol=1e-11)


def test_the_slopes_are_those_of_the_sizes(centring):
    present, at, step = [*map(mechanism, TERMS), *settings()], {"E": 0.3, "p": 0.2}, 1e-6

    def sizes(moved):
        return centring.sizes(present, {n: c.at(at[n] + moved.get(n, 0.0)) for n, c in CONSTANTS.items()})

    found = centring.slopes(present, CONSTANTS, {n: c.at(at[n]) for n, c in CONSTANTS.items()})
    assert not found[:, : len(TERMS)].any()
    for j, name in enumerate(CONSTANTS, start=len(TERMS)):
        quotient = (np.log(sizes({name: step})) - np.log(sizes({name: -step}))) / (2.0 * step)
        np.testing.assert_allclose(found[:, j], quotient, rtol=1e-6, atol=1e-9)


def test_what_one_coefficient_has_in_several_terms_is_centred_where_all_are_alike(values):
    alike, unlike = mechanism("c*exp(-E/T)"), mechanism("c**p")
    tied = replace(alike, kind="tie", parts=(*alike.parts, replace(alike.parts[0], relation=1)))
    other = replace(unlike, kind="tie", parts=(*unlike.parts, mechanism("q", 1).parts[0]))
    found = Centring.of([tied, other], CONSTANTS, NAMES, values)
    assert found.constants == {"E"}
    assert found.shift(alike.parts[0].product.term).parts
    assert not found.shift(unlike.parts[0].product.term).parts


# c' = -K c exp(-E/T) of a batch whose temperature is known.
STEP, COUNT, SIGMA, ENERGY, RATE = 0.05, 400, 0.002, 8000.0, 3e9


def batch(centred):
    """Return the space of a batch, its law alone, about the middle of its exponent or not."""
    t = STEP * (np.arange(COUNT)[:, None] + np.array([0.0, 0.5, 1.0]))
    warm = 340.0 + 20.0 * np.sin(0.7 * t)

    def rate(now, c):
        return -RATE * c * np.exp(-ENERGY / (340.0 + 20.0 * np.sin(0.7 * now)))

    c = solve_ivp(rate, (0.0, t[-1, 0]), [1.0], t_eval=t[:, 0], rtol=1e-10, atol=1e-12).y.T
    measured = c + SIGMA * np.random.default_rng(0).standard_normal(c.shape)
    segments = cut(c, measured, warm[:, :, None], [SIGMA], [1e-3], (COUNT,), 20, STEP)
    scope, energy = Scope.of(["c", "T"], constants=["E"]), CONSTANTS["E"]
    law = [Product("c_dot"), Product(None, parse_term("c*exp(-E/T)", scope))]
    mechanisms = (
        *(candidate(0, p, "c_dot") for p in law),
        Mechanism("constant", "constant E", "E", (), 0.0),
    )
    values = np.vstack([c[:, 0], warm[:, 0]])
    centring = Centring.of(mechanisms, ["E"] if centred else [], ["c", "T"], values)
    frame = Frame.of((Coordinate("c", 1),), ["T"], {"E": energy}, centring)
    return SearchSpace(Evaluator(segments, 2), mechanisms, frame)


@pytest.mark.parametrize("off", [0.75, 1.3])
def test_a_fit_of_a_centred_term_is_the_fit_of_the_term_with_a_statistic_that_says_whether_it_is_there(off):
    it, other = batch(True), batch(False)
    # The rate is right at 340 K.
    begin = Start(np.array([1.0, RATE * np.exp((off - 1.0) * ENERGY / 340.0)]), {"E": off * ENERGY})
    defect_std = 0.01 * it.segments.spread
    found = it.begin(begin.among(it.mechanisms, it.frame), defect_std)
    plain = other.fit(found.theta * it.sizes(found.theta), found.present, found.x0, defect_std)
    assert found.cost == pytest.approx(plain.cost, abs=1e-2)
    (relation,), (same,) = (s.relations_of(f, f.covariance) for s, f in ((it, found), (other, plain)))
    (energy,), (again,) = (s.settings_of(f, f.covariance).parameters for s, f in ((it, found), (other, plain)))
    assert energy.value == pytest.approx(again.value, abs=0.05 * energy.std_error)
    assert abs(energy.value - ENERGY) < 3.0 * energy.std_error
    assert [t.text for t in relation.terms[1:]] == [f"c*exp(-{energy.value!r}*T**-1)"]
    rate, by_hand = relation.terms[1], same.terms[1]
    assert rate.coefficient == pytest.approx(by_hand.coefficient, abs=0.05 * rate.std_error)
    assert rate.std_error == pytest.approx(by_hand.std_error, rel=0.05)
    assert abs(np.log(rate.coefficient / RATE)) < 3.0 * rate.std_error / RATE
    # Of the rate at no temperature little is known: whether there is a reaction is known well.
    assert max(plain.wald[0], 1.0) < 0.05 * found.wald[0]
    assert it.sureness_of(found, found.covariance)[1] == pytest.approx(np.sqrt(found.wald[0]), rel=1e-6)


@pytest.mark.parametrize("centred", [True, False])
def test_coefficients_of_which_the_data_say_nothing_are_stated_without_a_word_of_numpy(centred):
    space = batch(centred)
    begin = Start(np.array([1.0, RATE]), {"E": ENERGY})
    found = space.begin(begin.among(space.mechanisms, space.frame), 0.01 * space.segments.spread)
    covariance = found.covariance.copy()
    covariance[0, 0] = np.inf
    (relation,) = space.relations_of(found, covariance)
    assert relation.terms[1].std_error is None
