"""Where the searches of forms begin, and which are left out."""

from __future__ import annotations

from dataclasses import replace

import msgspec
import numpy as np
import pytest
from test_forms import CART, assert_cart, columns, with_library

from odescope.commands.demo import simulate_log
from odescope.errors import NoModelError
from odescope.likelihood.search import LikelihoodSearch
from odescope.pipeline import competition, contender, forms, stages
from odescope.pipeline.identification import identify
from odescope.study.options import Driven


@pytest.fixture(scope="module")
def log():
    return simulate_log(0, 3)


@pytest.mark.parametrize(
    ("clear", "well", "asked"),
    [
        pytest.param(True, 0.0, ["lagrangian"], id="clear", marks=pytest.mark.slow),
        pytest.param(False, 1.0, ["lagrangian"], id="not clear, but runs well", marks=pytest.mark.slow),
        pytest.param(False, 0.0, ["lagrangian", "relations"], id="neither"),
    ],
)
def test_relations_that_regression_has_not_found_are_searched_only_beside_poor_mechanisms(
    log, monkeypatch, clear, well, asked
):
    def nothing(*_):
        raise NoModelError("model", "no relations")

    searched = []

    def refined(work, filtered, posed):
        searched.append(posed.form)
        if posed.form == "relations":
            return None
        found = stages.refine_form(work, filtered, posed)
        penalties = found.outcome.penalties if clear else np.full_like(found.outcome.penalties, np.inf)
        return replace(found, outcome=replace(found.outcome, penalties=penalties))

    monkeypatch.setattr(contender, "WELL", well)
    monkeypatch.setattr(stages, "propose", nothing)
    monkeypatch.setattr(competition, "refine_form", refined)
    result = identify(with_library(CART, suspect=False), columns(log))
    assert searched == asked
    assert_cart(result)
    assert result.model.scores.forms == ()


def at_once(study):
    """Return a study whose input is known to act at once: where there is no model, delays are looked for otherwise."""
    return msgspec.structs.replace(study, inputs={"u": Driven(delay=0.0)})


def starts(study, data, monkeypatch):
    """Return the form, begun from little, and the signals."""
    posed, study = [], at_once(study)
    monkeypatch.setattr(forms, "explained", lambda *_: None)

    def refined(work, filtered, form):
        posed.append((form, filtered.signals))
        raise NoModelError("likelihood", "that is all")

    monkeypatch.setattr(competition, "refine_form", refined)
    with pytest.raises(NoModelError, match="that is all"):
        identify(study, data)
    (both,) = posed
    return both


def begun(form, start=0):
    return {
        (m.kind, m.term): c for m, c in zip(form.mechanisms, form.starts[start].coefficients.tolist(), strict=True) if c
    }


def test_a_search_begins_with_the_same_model_whatever_the_unit_of_a_coordinate(log, monkeypatch):
    data = columns(log)
    metres, _ = starts(CART, data, monkeypatch)
    kilometres, _ = starts(CART, data | {"x": 1e-3 * data["x"]}, monkeypatch)
    for k in range(2):
        here, there = begun(metres, k), begun(kilometres, k)
        assert here.keys() == there.keys()
        unit = {"x_dot**2": 1e6, "abs(x_dot)": 1e3, "u on x": 1e3}
        ratio = [there[key] / (here[key] * unit.get(key[1], 1.0)) for key in here]
        assert ratio == pytest.approx([ratio[0]] * len(ratio), rel=0.02)


def test_kinetic_terms_begin_with_the_energy_of_what_is_known(log, monkeypatch):
    tied = with_library(CART, form="lagrangian", ties=("x_dot**2 in kinetic = 0.9",))
    form, signals = starts(tied, columns(log), monkeypatch)
    kinetic = {term: c for (kind, term), c in begun(form).items() if kind == "kinetic"}
    rates = {f"{n}_dot**2": np.mean(signals.joined()[signals.row(f"{n}_dot")] ** 2) for n in ("x", "phi")}
    assert kinetic["x_dot**2"] == 0.9
    assert kinetic["phi_dot**2"] * rates["phi_dot**2"] == pytest.approx(0.9 * rates["x_dot**2"])


def test_a_second_start_has_friction_in_every_joint_which_makes_a_tenth_of_each_target(log, monkeypatch):
    form, signals = starts(CART, columns(log), monkeypatch)
    first, second = (start.coefficients for start in form.starts)
    added = np.flatnonzero(first != second)
    assert {form.mechanisms[k].term for k in added} == {"x_dot**2", "phi_dot**2", "abs(x_dot)", "abs(phi_dot)"}
    joined = signals.joined()
    for k in added:
        m = form.at_nominal[k]
        (part,) = m.parts
        name = ("x", "phi")[part.relation]
        speed = joined[signals.row(f"{name}_dot")]
        force = part.share * second[k] * (np.sign(speed) if "abs" in m.term else speed)
        inertia = begun(form)["kinetic", f"{name}_dot**2"]
        expected = 0.1 * inertia * joined[signals.row(f"{name}_ddot")].std()
        assert force.std() == pytest.approx(expected, rel=0.02 if "abs" in m.term else 1e-6)


def test_regression_on_mechanisms_is_asked_for_only_where_no_search_ends_clear(log, monkeypatch):
    def never(*_):
        raise AssertionError

    monkeypatch.setattr(forms, "proposed", never)
    assert_cart(identify(CART, columns(log)))


def test_where_regression_proposes_nothing_the_start_of_a_search_is_no_model(log, monkeypatch):
    monkeypatch.setattr(forms, "proposed", lambda *_: None)
    study = msgspec.structs.replace(at_once(CART), likelihood=LikelihoodSearch(enabled=False))
    with pytest.raises(NoModelError, match="no model follows"):
        identify(study, columns(log))
