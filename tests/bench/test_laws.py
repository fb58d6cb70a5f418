"""A law is recognised however a model writes it, and nothing else is taken for it."""

from dataclasses import replace

import numpy as np
import pytest
from bench_cases import clean, ran, rig_of
from laws import judge, rows_of
from truths import lagrangian, relations

from odescope.library.product import Product
from odescope.model.model import Model
from odescope.model.relation import Relation, RelationTerm

ZERO = 0.1


@pytest.fixture(scope="module")
def cart():
    return rig_of("cart")


@pytest.fixture(scope="module")
def seen(cart):
    run = ran(cart, clean(cart))
    return np.column_stack([run.states, run.inputs]).T


def verdict_on(rig, found, seen, zero=0.0):
    shifted = seen.copy()
    shifted[1] += zero
    return judge(rig.truth((0.0,)), (0.0, zero), (), found, shifted, np.random.default_rng(0))


def written(rig, change):
    """Return the model of the rig's laws, each changed."""
    study = rig.study
    return relations(study.measured(), study.driven(), {t: change(law) for t, law in rig.laws.items()}).model


def solved(model):
    """Return a model with its accelerations worked out, as fractions."""
    rows = []
    for q in model.quotients:
        lead = q.denominator.parts[0][0]
        terms = [RelationTerm(Product(q.target, t), c / lead) for c, t in q.denominator.parts]
        rows.append(Relation((*terms, *(RelationTerm(Product(None, t), -c / lead) for c, t in q.numerator.parts))))
    return replace(model, relations=tuple(rows))


def energies(rig):
    """Return the cart as Lagrange's equations say it."""
    study, (first, second) = rig.study, rig.laws.values()
    whole, arm, _, b, dry, _ = (c for _, _, c in first)
    inertia, _, weight, b1, dry1 = (c for _, _, c in second)
    truth = lagrangian(
        study.measured(),
        study.driven(),
        {"x_dot**2": whole / 2, "x_dot*phi_dot*cos(phi)": arm, "phi_dot**2": inertia / 2},
        {"cos(phi)": -weight},
        {"x_dot**2": b / 2, "abs(x_dot)": dry, "phi_dot**2": b1 / 2, "abs(phi_dot)": dry1},
        {"x": {"u": 1.0}},
    )
    return truth.model


def smooth(law):
    """Dry friction as a tanh that is sharp."""
    return tuple((f, t.replace("sign(", "tanh(100.0*"), c) for f, t, c in law)


def mixed(rig):
    """Return the equations of motion, each plus a multiple of the other."""
    first, second = rig.truth((0.0,)).model.relations
    sums = [
        Relation((*a.terms, *(replace(t, coefficient=k * t.coefficient) for t in b.terms)))
        for a, b, k in ((first, second, 0.3), (second, first, -0.2))
    ]
    return Model(rig.study.measured(), rig.study.driven(), tuple(sums))


def turned(rig, whole):
    """Return the cart in readings of an angle that is off, expanded: sin(phi - z) as a sum."""
    c, s = np.cos(ZERO), np.sin(ZERO)

    def expanded(law):
        terms = []
        for factor, text, k in law:
            for one, other, sign in (("sin(phi)", "cos(phi)", -1.0), ("cos(phi)", "sin(phi)", 1.0)):
                if one in text and whole:
                    terms += [(factor, text, c * k), (factor, text.replace(one, other), sign * s * k)]
                    break
            else:
                terms.append((factor, text, k))
        return tuple(terms)

    return written(rig, expanded)


WAYS = {
    "equations of motion": lambda rig: rig.truth((0.0,)).model,
    "fractions": lambda rig: solved(rig.truth((0.0,)).model),
    "energies": energies,
    "smooth friction": lambda rig: written(rig, smooth),
    "combinations": mixed,
}


@pytest.mark.parametrize("way", WAYS)
def test_the_law_is_the_law_however_written(cart, seen, way):
    verdict = verdict_on(cart, WAYS[way](cart), seen)
    assert verdict.exact
    assert verdict.off < 1e-9
    assert max(map(abs, verdict.physical.values())) < 1e-9


@pytest.mark.parametrize("target", ["x_ddot", "phi_ddot"])
def test_no_term_may_be_missing_and_none_too_many(cart, seen, target):
    law = cart.laws[target]
    for k in range(1, len(law)):
        less = replace(cart, laws={**cart.laws, target: (*law[:k], *law[k + 1 :])})
        assert not verdict_on(cart, less.truth((0.0,)).model, seen).exact
    for term in ("1", "x", "x_dot**3", "phi_dot*cos(phi)", "cos(phi)**2"):
        more = replace(cart, laws={**cart.laws, target: (*law, (None, term, 1e-3))})
        assert not verdict_on(cart, more.truth((0.0,)).model, seen).exact


def test_a_wide_tanh_is_not_dry_friction(cart, seen):
    wide = written(cart, lambda law: tuple((f, t.replace("sign(", "tanh(2.0*"), c) for f, t, c in law))
    assert not verdict_on(cart, wide, seen).exact


def test_a_zero_that_is_off_may_be_expanded_but_not_left_out(cart, seen):
    aware = verdict_on(cart, turned(cart, True), seen, ZERO)
    assert aware.exact
    assert aware.off < 1e-9
    blind = verdict_on(cart, turned(cart, False), seen, ZERO)
    assert not blind.exact
    assert blind.off > 0.01


def test_a_zero_of_what_no_equation_holds_does_not_count(cart, seen):
    shifted = seen.copy()
    shifted[0] += ZERO
    verdict = judge(cart.truth((0.0,)), (ZERO, 0.0), (), written(cart, tuple), shifted, np.random.default_rng(0))
    assert verdict.exact


def test_errors_are_those_of_the_coefficients_as_the_model_writes_them(cart, seen):
    """One coefficient of the fractions moved by two standard errors, which no equation of motion has."""
    model = solved(cart.truth((0.0,)).model)
    first, second = model.relations
    k = next(k for k, t in enumerate(first.terms) if t.text == "u")
    error = 0.01 * first.terms[k].coefficient
    terms = list(first.terms)
    terms[k] = replace(terms[k], coefficient=terms[k].coefficient + 2.0 * error, std_error=abs(error))
    found = replace(model, relations=(Relation(tuple(terms)), second))
    verdict = verdict_on(cart, found, seen)
    assert verdict.exact
    ((off, stated),) = verdict.stated
    assert off / stated == pytest.approx(2.0 * np.sign(error), rel=1e-6)


def test_one_equation_of_motion_may_be_had_with_the_difference_of_both():
    """Of the arm, whose rig names it; without that, only Lagrange's own would do."""
    arm = rig_of("arm")
    run = ran(arm, clean(arm), samples=801)
    seen = np.column_stack([run.states, run.inputs]).T
    truth, study = arm.truth((0.0, 0.0)), arm.study
    laws = dict(zip(arm.laws, (*arm.also, arm.laws["q2_ddot"]), strict=True))
    off = tuple((f, t, c * (1.02 if t == "sin(q1)" else 1.0)) for f, t, c in laws["q1_ddot"])
    found = relations(study.measured(), study.driven(), {**laws, "q1_ddot": off}).model
    verdict = judge(truth, (0.0, 0.0), rows_of(truth, arm.also), found, seen, np.random.default_rng(0))
    assert verdict.exact
    assert verdict.physical["q1_ddot: sin(q1)"] == pytest.approx(0.02, rel=1e-6)
