"""What the stage says: a pendulum that lacks a term, or has its input late, or nothing but white torque."""

import json
import math
import re
from dataclasses import replace
from functools import cache
from types import SimpleNamespace

import msgspec
import numpy as np
import pytest
from small_systems import System

from odescope import Study, from_json, identify, to_json
from odescope.likelihood.evaluator import Evaluator
from odescope.likelihood.findings import likelihood_scores, missing_physics
from odescope.likelihood.held_out import free_run_error
from odescope.likelihood.noise_levels import estimate_noise
from odescope.likelihood.path import ModelPath, PathStep
from odescope.likelihood.process_noise import Noisy, robust_evidence
from odescope.likelihood.search_space import SearchSpace
from odescope.likelihood.segments import Segments
from odescope.recordings.coordinate import Coordinate
from odescope.study.library_options import Candidates
from odescope.study.options import Data, Driven, Measured

A, B, G = 9.0, 0.4, 2.0
STEP, NOISE, PIECE = 0.04, 0.005, 5
TERMS = (
    "1", "sin(th)", "cos(th)", "th_dot", "th_dot**2", "u", "u*cos(th)", "th_dot*cos(th)", "sin(th)*cos(th)",
    "th_dot**3", "th_dot*u", "th_ddot",
)  # fmt: skip
SIGN, DELAY = "goes with the sign of th_dot", "as with a delay"


def wave(t):
    return 2.0 * np.sin(0.9 * t) + 1.6 * np.sin(2.3 * t + 1) + 1.2 * np.sin(4.1 * t + 2)


def pendulum(seed, count=2000, torque=0.0, friction=0.0, late=0):
    """Return states and input of a pendulum with dry friction and a torque that holds over each sample, by RK4.

    The input is linear between samples, and acts so many samples late.
    """
    rng, parts = np.random.default_rng(seed), 4
    times = STEP * np.arange(count + 1)
    acting = wave(times - late * STEP).tolist()
    th, v, rows, h = 0.3, 0.0, [], STEP / parts
    for k, w in enumerate((torque * rng.standard_normal(count)).tolist()):
        rows.append((th, v))
        begin, rise = acting[k], (acting[k + 1] - acting[k]) / parts

        def f(th, v, s, begin=begin, rise=rise, w=w):
            dry = friction * ((v > 0) - (v < 0))
            return G * (begin + rise * s) - A * math.sin(th) - B * v - dry + w

        for s in range(parts):
            a = f(th, v, s)
            v2 = v + h / 2 * a
            b = f(th + h / 2 * v, v2, s + 0.5)
            v3 = v + h / 2 * b
            c = f(th + h / 2 * v2, v3, s + 0.5)
            v4 = v + h * c
            d = f(th + h * v3, v4, s + 1)
            th, v = th + h / 6 * (v + 2 * v2 + 2 * v3 + v4), v + h / 6 * (a + 2 * b + 2 * c + d)
    return times[:-1], np.array(rows), wave(times)


@cache
def identified(seed, terms=TERMS, delay=0.0, **options):
    t, states, u = pendulum(seed, **options)
    measured = states[:, 0] + NOISE * np.random.default_rng(1000 + seed).standard_normal(len(t))
    study = Study(
        data=Data(time="t"),
        coordinates={"th": Measured(order=2, angle=True)},
        inputs={"u": Driven(delay=delay)},
        library=Candidates(terms=terms),
    )
    return identify(study, {"t": t, "th": measured, "u": u[:-1]})


def terms(result):
    return {t.text: t for t in result.model.relations[0].terms}


def said(result, phrase):
    return [n for n in result.notes if phrase in n]


def correlation(note):
    return float(re.search(r"correlation (-?[\d.]+)", note)[1])


def test_dry_friction_that_the_library_lacks_is_named():
    result = identified(0, count=4000, friction=0.8)
    assert result.refinement.process is not None
    (note,) = said(result, SIGN)
    assert "try sign(th_dot) in the library's basis" in note
    # It moves with the input, whose rate may be named too: the weaker cause of the two.
    assert correlation(note) < min([0.0, *(-abs(correlation(n)) for n in said(result, DELAY))])


def test_once_the_library_has_the_friction_it_is_found_and_no_longer_named():
    result = identified(0, terms=(*TERMS, "sign(th_dot)"), count=1500, friction=0.8)
    found = terms(result)
    assert found["sign(th_dot)"].coefficient == pytest.approx(0.8, rel=0.05)
    assert found["th_dot"].coefficient == pytest.approx(B, rel=0.05)
    assert not said(result, SIGN)


def test_dry_friction_is_named_in_a_record_of_four_hundred_segments_too():
    assert said(identified(0, count=2000, friction=0.8), SIGN)


def test_a_delay_is_found_with_an_error_that_holds_beside_the_coefficients():
    result = identified(0, late=3, delay="auto")
    (u,) = result.model.inputs
    found = result.model.scores.delays["u"]
    assert u.delay == found.delay
    assert abs(found.delay - 3 * STEP) < 5 * found.std_error < 0.01 * STEP
    assert terms(result)["th_dot"].coefficient == pytest.approx(B, rel=1e-3)
    assert not said(result, DELAY)


def test_an_input_that_acts_late_is_spoken_of_as_a_delay():
    result = identified(0, late=3)
    (note,) = said(result, DELAY)
    assert "the rate of u" in note
    # G u(t - d) lacks -G d u_dot: what is missing falls where the input rises.
    assert correlation(note) < -0.5
    assert not said(result, SIGN)


def test_of_white_torque_nothing_is_said_but_its_size():
    result = identified(1, torque=1.0)
    process = result.refinement.process
    assert set(terms(result)) == {"th_ddot", "sin(th)", "th_dot", "u"}
    assert process.unexplained[0] == pytest.approx(1.0 / math.sqrt(process.window / STEP), rel=0.3)
    (note,) = said(result, "root mean square) unexplained")
    assert f"leaves {process.unexplained[0]:.2g} rad s⁻² of th_ddot (" in note
    whole = result.signals.joined()[result.signals.row("th_ddot")]
    part = 100.0 * process.unexplained[0] / np.sqrt(np.mean(whole**2))
    assert f"({part:.2f} % of its root mean square) unexplained" in note


def test_a_record_that_is_followed_has_no_process_noise_and_nothing_unexplained():
    result = identified(0)
    assert result.refinement.process is None
    assert result.refinement.follows
    assert not said(result, "unexplained")
    assert set(terms(result)) == {"th_ddot", "sin(th)", "th_dot", "u"}
    assert likelihood_scores(result.refinement, result.model.targets).process_noise is None


PENDULUM = System(
    (Coordinate("th", 2, angle=True),),
    ("u",),
    ((0, 0, "1", 1.0), (0, -1, "sin(th)", A), (0, -1, "th_dot", B), (0, -1, "u", -G)),
    (0,),
    None,
)


def among(system, seed, count=2000, **options):
    """Return a space of all terms of a system, in segments of a recording of the pendulum."""
    _, states, u = pendulum(seed, count=count, **options)
    nodes = np.stack([u[:-1], (u[:-1] + u[1:]) / 2, u[1:]], axis=1)[:, :, None]
    measured = states[:, :1] + NOISE * np.random.default_rng(1000 + seed).standard_normal((count, 1))
    start = np.arange(0, count, PIECE)
    segments = Segments(
        measured, nodes, states, start, np.full(len(start), PIECE), start < start[-1], np.array([NOISE]),
        np.array([0.02, 0.3]), STEP, 1, ((0, count),),
    )  # fmt: skip
    return SearchSpace(Evaluator(segments), system.mechanisms, system.frame)


def unexplained(seed, count=2000, **options):
    """Return the pendulum with process noise and the true terms, fitted without a search."""
    it = among(PENDULUM, seed, count, **options)
    it, found, marginal = estimate_noise(it, it.begin(PENDULUM.theta, it.segments.spread))
    evidence = robust_evidence(it, found)
    return Noisy(found, it, marginal, evidence, free_run_error(it, found.theta), (), ModelPath(it, (), 0))


def test_white_torque_is_not_taken_for_physics_over_seeds():
    false = [missing_physics(unexplained(seed, 1200, torque=1.0), ["th_ddot"]) for seed in range(15)]
    assert sum(map(bool, false)) <= 1


@pytest.mark.parametrize(
    ("options", "phrase"), [({"friction": 0.8, "torque": 0.5}, SIGN), ({"late": 2, "torque": 0.5}, DELAY)]
)
def test_missing_physics_is_named_under_white_torque_over_seeds(options, phrase):
    found = [missing_physics(unexplained(seed, 3000, **options), ["th_ddot"]) for seed in range(5)]
    assert sum(any(phrase in s for s in sentences) for sentences in found) >= 4


def without_friction(seed, **options):
    """Return the path from the pendulum with dry friction to that without, which is chosen."""
    system = replace(PENDULUM, terms=(*PENDULUM.terms, (0, -1, "sign(th_dot)", options.get("friction", 0.1))))
    it = among(system, seed, 3000, torque=0.5, **options)
    it, longer, _ = estimate_noise(it, it.begin(system.theta, it.segments.spread))
    shorter = it.begin(np.append(longer.theta[:-1], 0.0), it.segments.spread)
    steps = (
        PathStep(longer, np.full(3, 0.01), None, 0.0, 4),
        PathStep(shorter, np.full(3, 0.01), it.mechanisms[-1], 30.0, 3),
    )
    return ModelPath(it, steps, 1)


def test_dry_friction_stays_where_what_is_unexplained_without_it_shows_it():
    kept = [without_friction(seed, friction=0.8).keeping_friction.chosen == 0 for seed in range(5)]
    invented = [without_friction(seed).keeping_friction.chosen == 0 for seed in range(5)]
    assert sum(kept) >= 4
    assert not any(invented)


def test_friction_that_the_library_has_is_not_asked_for():
    path = without_friction(0, friction=0.8)
    (told,) = missing_physics(SimpleNamespace(space=path.space, fit=path.choice.fit), ["th_ddot"])
    assert SIGN in told
    assert "the library has it" in told
    assert "try sign" not in told


RUNS = {
    "followed": {},
    "white torque": {"torque": 1.0},
    "friction": {"friction": 0.8, "count": 4000},
    "late": {"late": 3},
}


@pytest.mark.parametrize("name", RUNS)
def test_scores_are_json_and_agree_with_the_model(name):
    result = identified(0, **RUNS[name])
    judged = result.model.scores.likelihood
    if judged.process_noise is not None:
        (left,), (share,) = judged.process_noise.values(), judged.unexplained.values()
        assert left / share == pytest.approx(
            np.sqrt(np.mean(result.signals.columns[0][result.signals.row("th_ddot")] ** 2))
        )
    assert likelihood_scores(result.refinement, result.model.targets) == msgspec.structs.replace(
        judged, unexplained=None
    )
    written = json.loads(to_json(result.model))
    assert from_json(json.dumps(written)).scores == result.model.scores
    scores = written["scores"]["likelihood"]
    found = terms(result)
    intervals = {s["term"]: s["interval"] for s in scores["intervals"]}
    assert intervals.keys() == found.keys() - {"th_ddot"}
    for text, (low, high) in intervals.items():
        assert low < found[text].coefficient < high
        assert (high - low) / 2 == pytest.approx(1.959964 * found[text].std_error, rel=1e-3)
    for pair in scores["correlations"]:
        assert 0.5 < abs(pair["correlation"]) <= 1.0
        assert pair["first"] != pair["second"]
    limits = {s["term"]: s["limit"] for s in scores["limits"]}
    present = intervals.keys()
    assert not limits.keys() & present
    assert len(limits) + len(present) == len(TERMS) - 1
    assert all(limit is None or 0.0 < limit < math.inf for limit in limits.values())
