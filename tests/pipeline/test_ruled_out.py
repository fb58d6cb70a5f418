"""Motion in a plane and in space, by default settings: what is thrown, what orbits, a weight on a spring."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.interpolate import PchipInterpolator

from odescope.library.parse import Scope, parse_term
from odescope.pipeline.identification import identify
from odescope.pipeline.ruled_out import near_origin, not_ruled_out
from odescope.recordings.coordinate import Coordinate
from odescope.recordings.record import Record, Records
from odescope.study.options import Candidates, Data, Driven, Measured, Study

G = 9.81


def thrown(x, v):
    return -0.05 * v * np.linalg.norm(v) - G * np.eye(len(x))[-1]


def orbiting(x, v):
    return -x / np.linalg.norm(x) ** 3


def on_a_spring(x, v):
    r = np.linalg.norm(x)
    return -40.0 * (r - 1.0) * x / r - 0.1 * v - np.array([0.0, G])


def relations(coordinates, **coefficients):
    """Return the coefficients of the relations, by target and term, of forces by name."""
    speed, distance = (" + ".join(f"{c}{d}**2" for c in coordinates) for d in ("_dot", ""))
    known = {
        "drag": "{c}_dot*sqrt({speed})",
        "viscous": "{c}_dot",
        "gravitation": "{c}*sqrt({distance})**-3",
        "stiff": "{c}",
        "stretched": "{c}*sqrt({distance})**-1",
    }
    law = {
        (f"{c}_ddot", known[name].format(c=c, speed=speed, distance=distance)): value
        for name, value in coefficients.items()
        for c in coordinates
        if name != "weight"
    }
    return law | {(f"{coordinates[-1]}_ddot", "1"): coefficients[name] for name in coefficients if name == "weight"}


# The law, the coordinates, how long, where from, and the forces.
SYSTEMS = {
    "thrown in a plane": (thrown, "xy", 4.0, ([0.0, 1.0], [12.0, 15.0]), {"weight": G, "drag": 0.05}),
    "thrown in space": (thrown, "xyz", 4.0, ([0.0, 0.0, 1.0], [12.0, 8.0, 15.0]), {"weight": G, "drag": 0.05}),
    "orbit": (orbiting, "xy", 20.0, ([1.0, 0.0], [0.0, 0.9]), {"gravitation": 1.0}),
    "spring": (
        on_a_spring, "xy", 12.0, ([0.6, -0.9], [0.0, 0.0]),
        {"weight": G, "stiff": 40.0, "stretched": -40.0, "viscous": 0.1},
    ),
}  # fmt: skip


def log(system, seed, noise):
    """Return two recordings from starts about the usual one, with noise."""
    law, coordinates, duration, (x, v), _ = SYSTEMS[system]
    rng, t, n = np.random.default_rng(seed), np.linspace(0.0, duration, 1500), len(coordinates)
    runs = []
    for _ in range(2):
        start = np.concatenate([x, v]) * rng.uniform(0.85, 1.15, 2 * n)
        rate = lambda _, s: np.concatenate([s[n:], law(s[:n], s[n:])])  # noqa: E731
        run = solve_ivp(rate, (0.0, duration), start, t_eval=t, rtol=1e-9, atol=1e-11).y[:n]
        runs.append(run)
    size = noise * np.concatenate(runs, axis=1).std(axis=1)
    noisy = [run + size[:, None] * rng.standard_normal(run.shape) for run in runs]
    return [{"t": t, **dict(zip(coordinates, run, strict=True))} for run in noisy]


def found(result):
    """Return the terms of the relations, by target and term: in whatever form they were found."""
    return {(r.terms[0].factor, t.term.text): t for r in result.model.relations for t in r.terms[1:]}


@pytest.mark.parametrize("seeds", [1, pytest.param(10, marks=pytest.mark.slow)])
@pytest.mark.parametrize("system", SYSTEMS)
def test_the_forces_are_found(system, seeds):
    coordinates, truth = SYSTEMS[system][1], relations(SYSTEMS[system][1], **SYSTEMS[system][4])
    study = Study(data=Data(time="t"), coordinates={c: Measured(order=2) for c in coordinates})
    right = 0
    for seed in range(seeds):
        terms = found(identify(study, log(system, seed, 0.003)))
        right += terms.keys() == truth.keys() and all(
            abs(t.coefficient - truth[key]) <= 4.0 * t.std_error for key, t in terms.items()
        )
    assert right >= 0.9 * seeds


def test_what_comes_near_the_origin_has_no_forces_from_there():
    """They have a pole there: what is thrown from the origin is found without, its drag as elsewhere."""
    t, plane = np.linspace(0.0, 3.0, 900), tuple(Coordinate(c, 2) for c in "xy")
    states = solve_ivp(
        lambda _, s: np.concatenate([s[2:], thrown(s[:2], s[2:])]), (0.0, 3.0), [0.0, 0.0, 12.0, 15.0], t_eval=t,
        rtol=1e-9, atol=1e-11,
    ).y[:2]  # fmt: skip
    apart = states + np.array([[0.0], [2.0]])
    for of, near in ((states, (frozenset("xy"),)), (apart, ())):
        assert near_origin(plane, Records((Record(t, of.T.copy(), ("x", "y")),))) == near
    states += 0.01 * np.random.default_rng(0).standard_normal(states.shape)
    study = Study(data=Data(time="t"), coordinates={c: Measured(order=2) for c in "xy"})
    result = identify(study, {"t": t, "x": states[0], "y": states[1]})
    assert found(result).keys() == relations("xy", weight=G, drag=0.05).keys()


@pytest.mark.slow
def test_a_quadrotor_in_a_plane_is_not_left_to_noise_of_the_process():
    """Its thrust turns with it, which no force of Lagrange's equations does: what they lack is as good as white."""
    t, rng = np.linspace(0.0, 6.0, 1800), np.random.default_rng(0)
    knots = np.arange(0.0, 7.0, 0.3)
    thrust, torque = (
        PchipInterpolator(knots, rng.uniform(*span, len(knots)))(t) for span in ((8.0, 12.0), (-0.3, 0.3))
    )

    def rate(now, s):
        f, m = (np.interp(now, t, u) for u in (thrust, torque))
        v = s[3:5]
        return [
            *s[3:],
            *(f * np.array([-np.sin(s[2]), np.cos(s[2])]) - [0.0, G] - 0.3 * v * np.hypot(*v)),
            20.0 * m - 0.4 * s[5],
        ]

    states = solve_ivp(rate, (0.0, 6.0), np.zeros(6), t_eval=t, rtol=1e-9, atol=1e-11, max_step=t[1]).y[:3]
    states += 3e-4 * states.std(axis=1)[:, None] * rng.standard_normal(states.shape)
    study = Study(
        data=Data(time="t"),
        coordinates={c: Measured(order=2, angle=c == "th") for c in ("x", "z", "th")},
        inputs={"f": Driven(), "m": Driven()},
    )
    speed = "sqrt(x_dot**2 + z_dot**2)"
    result = identify(study, {"t": t, **dict(zip(("x", "z", "th"), states, strict=True)), "f": thrust, "m": torque})
    assert found(result).keys() == {
        ("x_ddot", "f*sin(th)"), ("x_ddot", f"x_dot*{speed}"),
        ("z_ddot", "1"), ("z_ddot", "f*cos(th)"), ("z_ddot", f"z_dot*{speed}"),
        ("th_ddot", "m"), ("th_ddot", "th_dot"),
    }  # fmt: skip


def test_powers_of_what_has_few_values_are_no_candidates_and_the_result_says_so():
    rng = np.random.default_rng(1)
    t = np.arange(0.0, 40.0, 0.05)
    lamp, level = (
        np.array(values)[rng.integers(0, len(values), 40)].repeat(20) for values in ((0.0, 2.0), (1.0, 2.0, 4.0))
    )
    x = np.zeros(len(t))
    for k in range(len(t) - 1):  # exact where inputs are held
        steady = (1.5 * lamp[k] + 0.3 * level[k] ** 2) / 0.8
        x[k + 1] = steady + (x[k] - steady) * np.exp(-0.8 * 0.05)
    log = {"t": t, "x": x + 0.01 * rng.standard_normal(len(t)), "lamp": lamp, "level": level}
    inputs = {"lamp": Driven(hold="zero"), "level": Driven(hold="zero")}
    found = identify(Study(data=Data(time="t"), coordinates={"x": Measured(order=1)}, inputs=inputs), log)
    (problem,) = (s.problem for s in found.searches)
    texts = [t.text for t in problem.terms]
    assert not any("lamp**2" in text or "level**3" in text for text in texts)
    assert any("level**2" in text for text in texts)
    law = {t.text: t.coefficient for t in found.model.relations[0].terms[1:]}
    assert law == pytest.approx({"x": 0.8, "lamp": -1.5, "level**2": -0.3}, rel=0.02)
    said = [note for note in found.notes if " values, of which " in note]
    assert [note.split(" would")[0] for note in said] == [
        "lamp has only two values, of which lamp**2 and higher powers",
        "level has only three values, of which level**3",
    ]


@pytest.mark.parametrize(("basis", "stays"), [(("x", "u"), False), (("x", "u", "u**2"), True), (("x", "u**2"), True)])
def test_a_power_that_a_basis_names_stays(basis, stays):
    t = np.arange(0.0, 1.0, 0.01)
    records = Records((Record(t, np.array([t, t > 0.5], dtype=float).T.copy(), ("x", "u")),))
    library = Candidates(basis=basis, degree=2)
    study = Study(data=Data(time="t"), coordinates={"x": Measured(order=1)}, inputs={"u": Driven()}, library=library)
    term = parse_term("u**2", Scope.of(["x", "u"]))
    assert not_ruled_out(study, records)(term) is stays
