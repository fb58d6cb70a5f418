"""Angles that turn together are the wheels of a gear; the ends of a shaft, and arms that go round, stay angles."""

import msgspec
import numpy as np
import pytest
from scipy.integrate import solve_ivp

from odescope.events import Monitor
from odescope.parallel.workers import Threads
from odescope.pipeline.filtering import prepare
from odescope.pipeline.identification import identify
from odescope.pipeline.work import Work
from odescope.recordings.coordinate import Coordinate
from odescope.recordings.record import Record, Records
from odescope.signals.shafts import turning_together
from odescope.study.library_options import Candidates
from odescope.study.options import Data, Driven, Measured, Study

LAGRANGIAN = Candidates(form="lagrangian")
T = np.linspace(0.0, 10.0, 1001)
NAMES = [Coordinate("a", 2, angle=True), Coordinate("b", 2, angle=True)]


def records(a, b):
    return Records.of([Record(T, np.column_stack([a, b]), ("a", "b"))])


@pytest.mark.parametrize("ratio", [1.5, -1.0, 12.0, 1.0 / 12.0])
def test_wheels_of_a_gear_turn_together(ratio):
    slow, twist = 12.0 * np.sin(0.7 * T), 0.2 * np.sin(9.0 * T)
    fast = max(abs(ratio), 1.0 / abs(ratio)) * np.sign(ratio) * (slow + twist)
    a, b = (fast, slow) if abs(ratio) >= 1.0 else (slow, fast)
    assert turning_together(records(a, b), NAMES) == (("a", "b"),)
    b[500] = 999.0
    assert turning_together(records(a, b), NAMES) == (("a", "b"),)
    assert turning_together(records(a, b), [NAMES[0], Coordinate("b", 2)]) == ()


def test_ends_of_a_shaft_and_arms_that_swing_side_by_side_or_go_round_apart_do_not():
    swing, beside = 1.5 * np.sin(2.0 * T), 1.5 * np.sin(2.0 * T) + 0.1 * np.sin(5.0 * T)
    assert turning_together(records(swing, beside), NAMES) == ()
    swing[500] = beside[500] = 999.0
    assert turning_together(records(swing, beside), NAMES) == ()
    assert turning_together(records(8.0 * np.sin(T), 8.0 * np.sin(T) + np.sin(3.0 * T)), NAMES) == ()
    assert turning_together(records(3.0 * T, np.full_like(T, 0.3)), NAMES) == ()
    shaft = 12.0 * np.sin(0.7 * T)
    assert turning_together(records(shaft, shaft + 0.2 * np.sin(9.0 * T)), NAMES) == ()


def test_angles_that_turn_at_steady_rates_of_their_own_do_not():
    # Two clocks: phases that pull at each other a little, or not at all.
    slow, fast = 3.0 * T + 0.2 * np.sin(3.7 * T), 11.0 * T + 0.2 * np.sin(5.0 * T)
    assert turning_together(records(slow, fast), NAMES) == ()
    assert turning_together(records(slow, -11.0 * T), NAMES) == ()
    read = 0.01 * np.random.default_rng(0).standard_normal((2, len(T)))
    assert turning_together(records(3.0 * T + read[0], 11.0 * T + read[1]), NAMES) == ()
    assert turning_together(records(slow, 3.0 * slow), NAMES) == (("a", "b"),)


@pytest.mark.slow
def test_a_shaft_between_two_angles_is_a_spring_between_their_inertias():
    rng = np.random.default_rng(3)
    phase, hertz = rng.uniform(0.0, 2.0 * np.pi, 8), rng.uniform(0.05, 1.5, 8)

    def torque(t):
        return 1.5 * np.sin(2.0 * np.pi * hertz[:, None] * np.atleast_1d(t) + phase[:, None]).sum(axis=0)

    def law(t, s):
        between = 35.0 * (s[0] - s[1]) + 0.06 * (s[2] - s[3])
        return [s[2], s[3], (torque(t)[0] - between - 0.05 * s[2]) / 0.05, (between - 0.08 * s[3]) / 0.2]

    clean = solve_ivp(law, (0.0, 10.0), [0.0] * 4, t_eval=T, rtol=1e-9, atol=1e-10).y[:2]
    assert np.ptp(clean, axis=1).min() > 2.0 * np.pi
    a, b = clean + 1e-3 * rng.standard_normal(clean.shape)
    arm = Measured(order=2, angle=True)
    study = Study(data=Data(time="t"), coordinates={"a": arm, "b": arm}, inputs={"u": Driven()}, library=LAGRANGIAN)
    result = identify(study, {"t": T, "a": a, "b": b, "u": torque(T)})
    found = {f"{m.kind} {m.term}": m.coefficient for m in result.model.mechanisms}
    force = found.pop("force u")
    assert {name: value / force for name, value in found.items()} == pytest.approx(
        {
            "kinetic a_dot**2": 0.025,
            "kinetic b_dot**2": 0.1,
            "potential (a - b)**2": 17.5,
            "dissipation a_dot**2": 0.025,
            "dissipation b_dot**2": 0.04,
            "dissipation (a_dot - b_dot)**2": 0.03,
        },
        rel=0.1,
    )
    assert not any("turn together" in note for note in result.notes)
    assert all(c.angle for c in result.model.coordinates)


def test_a_library_that_is_named_is_left_as_it_is():
    turning = 12.0 * np.sin(0.7 * T)
    columns = {"t": T, "a": turning, "b": 3.0 * turning + 0.2 * np.sin(9.0 * T)}
    arm, paper = Measured(order=2, angle=True), Candidates(preset="paper")
    study = Study(data=Data(time="t"), coordinates={"a": arm, "b": arm}, library=paper)
    prepared = prepare(Work(study, Monitor(), Threads(1)), columns, None)
    assert (prepared.shafts, prepared.study) == ((), study)
    plain = prepare(Work(msgspec.structs.replace(study, library=Candidates()), Monitor(), Threads(1)), columns, None)
    assert plain.shafts == (("a", "b"),)
    assert not any("sin" in term.text or "cos" in term.text for term in plain.terms)
