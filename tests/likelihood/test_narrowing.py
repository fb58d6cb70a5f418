"""Dry friction in a search: wide at first, narrower where a record shows it, in steps that are stable there."""

import numpy as np
import pytest

from odescope import Candidates, Data, Driven, Measured, Study, identify
from odescope.library.constants import Constant
from odescope.library.mechanism import Mechanism, candidate
from odescope.library.parse import Scope, parse_term
from odescope.library.product import Product
from odescope.likelihood.evaluator import Evaluator
from odescope.likelihood.fit import Fit
from odescope.likelihood.layers import MOST_STEPS, STABLE
from odescope.likelihood.narrowing import narrowed
from odescope.likelihood.program import Frame, Program
from odescope.likelihood.search import WIDTHS, search
from odescope.likelihood.search_space import SearchSpace
from odescope.likelihood.segments import Segments
from odescope.recordings.coordinate import Coordinate

MASS, FORCE, WIDTH = 2.0, 3.0, 0.01
FRAME = Frame.of([Coordinate("x", 2)], [], {"w": Constant("w", WIDTH, 300 * WIDTH, WIDTH, optional=True)})
SCOPE = Scope.of(["x", "x_dot", "w"])
TERMS = (("x_ddot", "1"), (None, "x_dot"), (None, "tanh(x_dot/w)"))
MECHANISMS = tuple(candidate(0, Product(f, parse_term(t, SCOPE)), "x_ddot") for f, t in TERMS)

OWN_WIDTH = Mechanism("constant", "constant w", "w", (), 0.0)


def resting_block(seed, seconds, step=1e-4, every=100, noise=2e-4):
    """Return the log of a block of mass 1 that Coulomb's friction holds in turn, and viscous and dry friction."""
    rng = np.random.default_rng(seed)
    dry, viscous = rng.uniform(1.0, 2.0), rng.uniform(0.3, 1.0)
    slow, fast, strong, weak = rng.uniform([0.3, 0.9, 1.2, 0.5], [0.6, 1.6, 2.0, 1.2])
    begin = rng.uniform(0.0, 6.0, 2)

    def push(t):
        return strong * np.sin(2 * np.pi * slow * t + begin[0]) + weak * np.sin(2 * np.pi * fast * t + begin[1])

    count = round(seconds / step)
    v, forces = np.zeros(count + 1), push((np.arange(count) + 0.5) * step)
    for k in range(count):
        way = np.sign(v[k]) or np.sign(forces[k]) * (abs(forces[k]) > dry)
        next_ = (v[k] * (1 - 0.5 * step * viscous) + step * (forces[k] * abs(way) - dry * way)) / (
            1 + 0.5 * step * viscous
        )
        v[k + 1] = 0.0 if next_ * way < 0.0 else next_
    x = np.concatenate([[0.0], np.cumsum(0.5 * step * (v[1:] + v[:-1]))])
    t = np.arange(0, count + 1, every) * step
    log = {"t": t, "x": x[::every] + noise * rng.standard_normal(len(t)), "u": push(t)}
    return log, {"x_dot": viscous, "sign(x_dot)": dry, "u": -1.0}, float(np.mean(v == 0.0))


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(4))
def test_a_block_that_often_rests_is_found_with_errors_that_hold(seed):
    log, truth, rest = resting_block(seed, 6.0)
    assert 0.25 < rest < 0.7
    study = Study(
        data=Data(time="t"),
        coordinates={"x": Measured(order=2)},
        inputs={"u": Driven()},
        library=Candidates(basis=("x", "x_dot", "u", "sign(x_dot)"), degree=1),
    )
    (relation,) = identify(study, log).model.relations
    found = {t.product.text: t for t in relation.terms if t.product.factor is None}
    assert found.keys() == truth.keys()
    for name, value in truth.items():
        assert found[name].std_error is not None
        assert abs(found[name].coefficient - value) < 4.0 * found[name].std_error


def test_friction_decays_as_fast_as_it_slows_down_what_hardly_slides():
    program, theta = Program.of(MECHANISMS, FRAME), np.array([MASS, 0.5, FORCE])

    def acceleration(v):
        return -(0.5 * v + FORCE * np.tanh(v / WIDTH)) / MASS

    h = 1e-5 * WIDTH
    slope = (acceleration(h) - acceleration(-h)) / (2 * h)
    assert program.decay(theta) == pytest.approx(-slope - 0.5 / MASS, rel=1e-6)
    assert program.decay(np.array([MASS, 0.5, 0.0])) == 0.0
    assert program.decay(3.0 * theta) == pytest.approx(program.decay(theta))  # a relation says the same at any scale


def block_in_search(width, more=(), layer=0.0):
    """Return the space of a block without input that comes to rest again and again, and its fit under a wide layer.

    Candidates are its friction, its width, and more; the friction's own layer is none by default.
    """
    rng, step = np.random.default_rng(1), 0.01
    runs, start, measured, states = 40, [], [], []
    for k in range(runs):
        x, v = rng.uniform(-0.1, 0.1), rng.uniform(-0.6, 0.6)
        start.append(25 * k)
        for _ in range(25):
            measured.append(x + 1e-5 * rng.standard_normal())
            states.append((x, v))
            for _ in range(1000):  # of semi-implicit Euler
                slower = 1e-5 * FORCE / MASS * (np.tanh(abs(v) / layer) if layer else 1.0)
                v = 0.0 if abs(v) <= slower else v - slower * np.sign(v)
                x += 1e-5 * v
    count = np.full(runs, 25)
    segments = Segments(
        np.array(measured)[:, None], np.zeros((25 * runs, 3, 0)), np.array(states), np.array(start), count,
        np.zeros(runs, dtype=bool), np.array([1e-5]), np.ones(2), step, 1, tuple((a, a + 25) for a in start),
    )  # fmt: skip
    frame = Frame.of([Coordinate("x", 2)], [], {"w": Constant("w", width, 3.0, width, optional=True)})
    space = SearchSpace(Evaluator(segments), (MECHANISMS[0], MECHANISMS[2], OWN_WIDTH, *more), frame)
    found = space.begin(np.array([1.0, FORCE / MASS, 0.0, *(0.0 for _ in more)]), np.full(2, np.inf))
    assert isinstance(found, Fit)
    return space, found


def test_a_layer_is_halved_while_the_record_shows_its_creep():
    wide, found = block_in_search(0.05)
    narrow, better = narrowed(wide, found, np.full(2, np.inf), halvings=3)
    widths = [s.frame.constants["w"].nominal for s in (wide, narrow)]
    assert widths[1] == pytest.approx(widths[0] / 8)
    assert better.cost < 0.2 * found.cost
    errors = [abs(f.theta[1] - FORCE / MASS) for f in (found, better)]
    assert errors[1] < 0.3 * errors[0]
    assert not narrow.too_narrow(better)


def test_no_term_stands_for_the_creep_of_a_layer_that_is_too_wide():
    others = ("x_dot", "x_dot*abs(x_dot)", "x_dot**3", "x_dot**5")
    space, found = block_in_search(0.05, [candidate(0, Product(None, parse_term(t, SCOPE)), "x_ddot") for t in others])
    wide = search(space, found.theta, WIDTHS[:1])
    assert [m.mechanism.term for m in wide.trail if m.action == "add" and m.mechanism.parts] == []
    assert wide.constants["w"].nominal < 0.02
    assert abs(wide.fit.theta[1] - FORCE / MASS) < 0.01 * FORCE / MASS


def test_a_layer_is_too_narrow_where_the_shortest_step_is_not_stable():
    space, found = block_in_search(0.0004)
    least = FORCE / MASS / (MOST_STEPS * STABLE / 0.01)
    for width, too_narrow in ((1.1 * least, False), (0.9 * least, True)):
        narrower = space.with_constants({"w": Constant("w", width, 3.0, width, optional=True)})
        assert narrower.too_narrow(found) == too_narrow


def test_a_layer_stays_as_it_is_where_half_of_it_is_no_better():
    space, found = block_in_search(0.0004)
    same, kept = narrowed(space, found, np.full(2, np.inf))
    assert same.frame.constants["w"].nominal == 0.0004
    assert kept is found


def test_a_width_that_halves_fell_near_is_a_parameter_where_half_of_it_costs_more():
    space, near = block_in_search(0.95 * WIDTH, layer=WIDTH)
    own, found = narrowed(space, near, np.full(2, np.inf))
    gain, penalty = near.cost - found.cost, own.price(found) - space.price(near)
    assert 1.0 < gain < penalty  # by itself it would not be worth a parameter
    assert own.fixed_constants(found) == []
    (width,) = (k for k, m in enumerate(own.mechanisms) if m.kind == "constant")
    value = own.frame.constants["w"].at(found.theta[width])
    errors = dict(zip(found.free.tolist(), np.sqrt(found.variances), strict=True))
    assert abs(np.log(value / WIDTH)) < 4.0 * errors[width]
    assert abs(found.theta[1] - FORCE / MASS) < 4.0 * errors[1]
