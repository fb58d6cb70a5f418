"""Inputs that multiply rates, themselves and each other beside angles, where the default library lacks them."""

import numpy as np
import pytest
from logs import smooth, solved

from odescope.pipeline import competition
from odescope.pipeline.identification import identify
from odescope.pipeline.modulated import products_of
from odescope.pipeline.suspicion import with_suspected
from odescope.study.library_options import Candidates
from odescope.study.options import Data, Driven, Measured, Study

T = 0.02 * np.arange(600)

BRAKE = (lambda s, u: [s[1], -9.0 * np.sin(s[0]) - (0.1 + 0.6 * u**2) * s[1]], [2.4, 0.0], 0.5, 0.9)
HOOP = (lambda s, u: [s[1], np.sin(s[0]) * (u**2 * np.cos(s[0]) - 15.0) - 0.3 * s[1]], [1.2, 0.0], 3.0, 1.5)


def logged(system, seed=0):
    """The angle of a pendulum, noisy, and what was done to it."""
    rate, start, mean, size = system
    rng = np.random.default_rng(seed)
    u = mean + smooth(rng, len(T), 0.02, 0.4, size)
    angle = solved(rate, start, T, u)[:, 0]
    return {"t": T, "phi": angle + 0.003 * rng.standard_normal(len(T)), "u": u}


def study(**library):
    phi, u = Measured(order=2, angle=True), Driven(hold="linear")
    return Study(data=Data(time="t"), coordinates={"phi": phi}, inputs={"u": u}, library=Candidates(**library))


def terms(log, **library):
    relation = identify(study(**library), log).model.relations[0]
    return {t.product.text for t in relation.terms if t.product.factor is None}


def test_what_is_tried_are_springs_and_products_of_rates_and_inputs_with_harmonics_of_the_angle():
    springs, *tried = (set(texts) for texts in products_of(study()))
    assert springs == {"phi"}
    assert [len(texts) for texts in tried] == [8, 12, 32, 52]  # of v, u; each with 1, s, c, s c, c^2; phi; u phi_ddot
    assert {"phi_dot*u", "phi_ddot*u", "u**2"} <= tried[0] < tried[1]
    assert "phi_dot*u**2" in tried[1] - tried[0]
    assert tried[0] < tried[2] < tried[3]
    assert tried[1] < tried[3]
    assert not any(text.startswith(("phi*", "phi**")) for text in tried[3])


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(1, 6))
@pytest.mark.parametrize(
    ("system", "law"),
    [
        (BRAKE, {"sin(phi)", "phi_dot", "phi_dot*u**2"}),
        (HOOP, {"sin(phi)", "phi_dot", "u**2*cos(phi)*sin(phi)"}),
    ],
)
def test_products_with_inputs_are_found(system, law, seed):
    assert terms(logged(system, seed)) == law


@pytest.mark.slow
def test_a_library_without_suspicion_stays_as_it_is():
    assert "phi_dot*u**2" not in terms(logged(BRAKE), suspect=False)


def steered(seed):
    """The headings of a car, noisy, with its speed and the angle that it is steered by; and how they are studied."""
    rng, logs = np.random.default_rng(seed), []
    for _ in range(2):
        v, d = 3.0 + smooth(rng, len(T), 0.02, 2.0, 1.0), smooth(rng, len(T), 0.02, 1.0, 0.25)
        heading = solved(lambda _, u: [u[0] * np.tan(u[1]) / 1.6], [0.0], T, np.column_stack([v, d]))[:, 0]
        logs.append({"t": T, "h": heading + 0.002 * rng.standard_normal(len(T)), "v": v, "d": d})
    inputs = {"v": Driven(), "d": Driven()}
    return Study(data=Data(time="t"), coordinates={"h": Measured(angle=True)}, inputs=inputs), logs


@pytest.mark.parametrize("seed", [0, *(pytest.param(k, marks=pytest.mark.slow) for k in (1, 2))])
def test_a_car_turns_by_its_speed_times_the_tangent_of_the_angle_that_it_is_steered_by(seed):
    (relation,) = identify(*steered(seed)).model.relations
    (found,) = (t for t in relation.terms if t.product.factor is None)
    assert found.product.text == "v*tan(d)"
    assert -found.coefficient == pytest.approx(1.0 / 1.6, rel=0.002)


@pytest.mark.slow
def test_functions_are_suspected_beside_the_candidates_that_the_model_is_made_of(monkeypatch):
    def suspected(work, filtered, posed, refinement):
        own = refinement.space.mechanisms
        seen.append((posed.mechanisms, tuple(m for m in own if m.parts), [own[k].term for k in refinement.fit.present]))
        return with_suspected(work, filtered, posed, refinement)

    seen = []
    monkeypatch.setattr(competition, "with_suspected", suspected)
    identify(*steered(0))
    ((posed, candidates, present),) = seen
    assert "d*v" in present  # which the default library does not hold
    assert posed == candidates
