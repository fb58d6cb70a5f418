"""The hold of an input, found by the likelihood on a driven oscillator that is sampled nine times a period."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from odescope.export.model_file import from_json, to_json
from odescope.likelihood.holds import choose_holds
from odescope.pipeline.identification import identify
from odescope.study.library_options import Candidates
from odescope.study.options import Data, Driven, Measured, Study

PERIOD, COUNT, FINE = 0.1, 1000, 16
STIFFNESS = (2.0 * np.pi / (9.0 * PERIOD)) ** 2
TRUTH = {"x": STIFFNESS, "x_dot": 0.6, "x**3": 2.0, "u": -1.0}


def driving(hold, rng, rows=1):
    """Return an input as a function of time."""
    if hold == "slow":  # so slow that to hold it is to have it half a sample later
        f, phase = rng.uniform(0.005, 0.02, 30) / PERIOD, rng.uniform(0.0, 2.0 * np.pi, 30)
        t, size = PERIOD * np.arange(COUNT), 20.0 * rng.standard_normal(30)
        return lambda s: np.interp(s, t, np.sin(2.0 * np.pi * np.multiply.outer(t, f) + phase) @ size)
    if hold == "band-limited":
        f, phase = rng.uniform(0.03, 0.3, 30) / PERIOD, rng.uniform(0.0, 2.0 * np.pi, 30)
        size = 20.0 * rng.standard_normal(30)
        return lambda s: np.sin(2.0 * np.pi * np.multiply.outer(s, f) + phase) @ size
    levels = 100.0 * np.convolve(rng.standard_normal(COUNT // rows + 7), [0.3, 0.8, 1.0, 0.8, 0.3], "valid")
    if hold == "zero":
        return lambda s: levels[np.clip(np.floor(s / (rows * PERIOD)).astype(int), 0, len(levels) - 1)]
    return lambda s: np.interp(s, PERIOD * np.arange(len(levels)), levels)


def in_bursts(hold, u):
    """Return an input that says something only twice in a record."""
    held = PERIOD if hold == "zero" else 1e-9
    at, size, width = np.array([30.0, 75.0]), np.array([1.0, 0.6]), np.array([6.0, 4.0])
    return lambda s: (
        u(s) * (0.03 + np.exp(-0.5 * ((np.floor(np.asarray(s) / held)[..., None] * held - at) / width) ** 2) @ size)
    )


def oscillator(hold, seed, late=0.0, rows=1, cubic=2.0, bursts=False):
    """Return a log of x'' = -stiffness x - 0.6 x' - cubic x^3 + u(t - late), u between its samples as the hold says."""
    rng = np.random.default_rng(seed)
    u, step = driving(hold, rng, rows), PERIOD / FINE
    u = in_bursts(hold, u) if bursts else u
    begin, inside = step * np.arange(COUNT * FINE) - late, 1e-6 * step
    acting = np.stack([u(begin + inside), u(begin + 0.5 * step), u(begin + step - inside)], axis=1).tolist()

    def slope(x, v, f):
        return v, f - STIFFNESS * x - 0.6 * v - cubic * x**3

    x, v, positions = 0.0, 0.0, []
    for k, (first, middle, last) in enumerate(acting):
        if k % FINE == 0:
            positions.append(x)
        a1, b1 = slope(x, v, first)
        a2, b2 = slope(x + 0.5 * step * a1, v + 0.5 * step * b1, middle)
        a3, b3 = slope(x + 0.5 * step * a2, v + 0.5 * step * b2, middle)
        a4, b4 = slope(x + step * a3, v + step * b3, last)
        x += step * (a1 + 2.0 * a2 + 2.0 * a3 + a4) / 6.0
        v += step * (b1 + 2.0 * b2 + 2.0 * b3 + b4) / 6.0
    t = PERIOD * np.arange(COUNT)
    return {"t": t, "x": np.array(positions) + 0.1 * rng.standard_normal(COUNT), "u": u(t + inside)}


def study(**driven):
    return Study(
        data=Data(time="t"),
        coordinates={"x": Measured(order=2)},
        inputs={"u": Driven(**driven)},
        library=Candidates(terms=("x_ddot", "x", "x_dot", "x**3", "u", "1", "x**2", "x*u")),
    )


def off(model):
    """Return by how many standard errors each coefficient is off the truth."""
    terms = [t for t in model.relations[0].terms if t.std_error is not None]
    return {t.term.text: (t.coefficient - TRUTH.get(t.term.text, 0.0)) / t.std_error for t in terms}


@pytest.mark.parametrize("seeds", [3, pytest.param(10, marks=pytest.mark.slow)])
@pytest.mark.parametrize(
    "hold", ["zero", *(pytest.param(hold, marks=pytest.mark.slow) for hold in ("linear", "band-limited"))]
)
def test_the_hold_is_found_and_the_coefficients_are_right(hold, seeds):
    found, right = 0, 0
    for seed in range(seeds):
        model = identify(study(), oscillator(hold, seed)).model
        found += model.inputs[0].hold == hold
        errors = off(model)
        right += set(errors) == set(TRUTH) and max(np.abs(list(errors.values()))) < 4.0
        assert from_json(to_json(model)).inputs == model.inputs
    assert found >= 0.9 * seeds
    assert right >= 0.9 * seeds


@pytest.mark.slow
@pytest.mark.parametrize("hold", ["zero", "band-limited", "linear"])
def test_the_hold_is_found_together_with_a_delay(hold):
    late = 0.0375
    for seed in range(2):
        model = identify(study(), oscillator(hold, seed, late)).model
        assert model.inputs[0].hold == hold
        error = model.scores.delays["u"].std_error
        assert model.inputs[0].delay == pytest.approx(late, abs=max(4.0 * error, 1e-4))
        assert max(np.abs(list(off(model).values()))) < 4.0


@pytest.mark.parametrize("steps", [1, pytest.param(4, marks=pytest.mark.slow)])
def test_a_few_steps_of_a_command_are_held_and_not_late(steps):
    """Half a sample later they would do as well in lines; a record in which nothing is commanded says nothing."""
    for seed in range(3):
        rng = np.random.default_rng(seed)
        t, runs = PERIOD * np.arange(COUNT), []
        for levels in (rng.uniform(-1.0, 1.0, steps + 1), np.zeros(steps + 1)):
            u, x = levels[np.arange(COUNT) * (steps + 1) // COUNT], np.ones(COUNT)
            for k in range(COUNT - 1):  # x' = 3 u - 2 x, exactly
                x[k + 1] = 1.5 * u[k] + (x[k] - 1.5 * u[k]) * np.exp(-2.0 * PERIOD)
            runs.append({"t": t, "x": x + 1e-3 * rng.standard_normal(COUNT), "u": u})
        plain = Study(data=Data(time="t"), coordinates={"x": Measured()}, inputs={"u": Driven()})
        model = identify(plain, runs).model
        assert (model.inputs[0].hold, model.inputs[0].delay) == ("zero", 0.0)
        assert {t.term.text: t.coefficient for t in model.relations[0].terms} == pytest.approx(
            {"1": 1.0, "x": 2.0, "u": -3.0}, rel=0.01
        )


@pytest.mark.parametrize("hold", ["zero", "band-limited"])
def test_a_hold_is_found_that_shows_in_a_few_parts_of_the_record_alone(hold):
    model = identify(study(), oscillator(hold, 2, bursts=True)).model
    assert model.inputs[0].hold == hold
    assert max(np.abs(list(off(model).values()))) < 4.0


@pytest.mark.parametrize("seen", ["linear", "zero"])
def test_a_hold_that_was_chosen_before_a_delay_was_found_stays_only_where_the_log_shows_it(seen):
    found = identify(study(), oscillator("slow", 1, 0.45)).refinement
    late = [m.kind for m in found.space.mechanisms].index("delay")
    held = found.space.on(found.space.segments.held(["zero"]))
    theta = found.fit.theta - 0.5 * PERIOD * (np.arange(len(found.fit.theta)) == late)
    fit = held.fit(theta, found.fit.present, found.fit.x0, np.full_like(held.segments.spread, np.inf))
    choice = choose_holds(held, fit, {"u": seen})
    assert choice.holds == (seen,)
    assert choice.fit.theta[late] == pytest.approx(0.45 - 0.5 * PERIOD * (seen == "zero"), abs=0.01)


@pytest.mark.parametrize(("late", "hold"), [(0.0, "linear"), (0.5 * PERIOD, "zero")])
def test_half_a_sample_late_is_held(late, hold):
    """What a controller holds from sample to sample looks late; a hold says that without a number to estimate."""
    for seed in range(3):
        result = identify(study(), oscillator("slow", seed, late))
        assert (result.model.inputs[0].hold, result.model.inputs[0].delay) == (hold, 0.0)
        assert max(np.abs(list(off(result.model).values()))) < 4.0


@pytest.mark.slow
def test_segments_that_were_lost_under_the_wrong_delay_are_found_again():
    model = identify(study(), oscillator("band-limited", 4, 0.1)).model
    assert model.inputs[0].hold == "band-limited"
    assert set(off(model)) == set(TRUTH)
    assert max(np.abs(list(off(model).values()))) < 4.0


@pytest.mark.slow
def test_delays_are_estimated_before_regression_where_that_finds_no_law_at_once():
    model = identify(study(), oscillator("linear", 1, 0.7)).model
    assert model.inputs[0].delay == pytest.approx(0.7, abs=0.001)
    assert set(off(model)) == set(TRUTH)
    assert max(np.abs(list(off(model).values()))) < 4.0


def test_a_command_held_over_several_rows_is_found_and_said():
    result = identify(study(), oscillator("zero", 3, rows=4))
    assert result.model.inputs[0].hold == "zero"
    gain = result.model.scores.holds["u"].gain
    assert gain > 0.0
    assert f"u is held between samples: {gain:,.0f} in log-likelihood over linear" in result.notes
    linear = identify(study(hold="linear"), oscillator("zero", 3, rows=4)).model
    assert linear.inputs[0].hold == "linear"
    assert "u" not in linear.scores.holds


def test_each_of_two_inputs_has_its_own_hold():
    data, other = oscillator("zero", 5, cubic=0.0), oscillator("band-limited", 6, cubic=0.0)
    # Two oscillators, each driven by its own input, are one system of two coordinates.
    both = Study(
        data=Data(time="t"),
        coordinates={"x": Measured(order=2), "y": Measured(order=2)},
        inputs={"u": Driven(), "w": Driven()},
        library=Candidates(basis=("x", "x_dot", "y", "y_dot", "u", "w"), degree=1, form="relations"),
    )
    columns = {"t": data["t"], "x": data["x"], "u": data["u"], "y": other["x"], "w": other["u"]}
    model = identify(both, columns).model
    assert [i.hold for i in model.inputs] == ["zero", "band-limited"]


def ship(seed):
    """Return a log of a ship that a swell of 15 to 36 samples a period rolls, at .8 % noise."""
    rng, t = np.random.default_rng(seed), 0.5 * np.arange(2500)
    w = 2.0 * np.pi / rng.uniform(7.5, 18.0, 10)
    phase, size = rng.uniform(0.0, 2.0 * np.pi, 10), 0.02 * rng.uniform(0.7, 1.3, 10)

    def swell(now):
        return np.sin(np.multiply.outer(now, w) + phase) @ size

    def rate(now, y):
        return [y[1], swell(now) - 0.3 * y[0] - 0.04 * y[1]]

    x = solve_ivp(rate, (t[0], t[-1]), [0.2, 0.0], "DOP853", t, rtol=1e-9, atol=1e-11).y[0]
    return {"t": t, "x": x + 0.008 * x.std() * rng.standard_normal(len(t)), "u": swell(t)}


@pytest.mark.parametrize("seed", [0, *(pytest.param(s, marks=pytest.mark.slow) for s in range(1, 6))])
def test_a_swell_that_says_little_within_short_segments_is_band_limited(seed):
    model = identify(
        Study(data=Data(time="t"), coordinates={"x": Measured(order=2)}, inputs={"u": Driven()}), ship(seed)
    )
    (u,) = model.model.inputs
    (gain,) = (t for t in model.model.relations[0].terms if t.text == "u")
    assert u.hold == "band-limited"
    assert abs(gain.coefficient + 1.0) < 4.0 * gain.std_error


def circuit(seed, between):
    """Return a log of a circuit whose voltage is a sum of sines, or runs linearly between its samples, at 1 % noise.

    The shortest sine has 40 samples: what either loses of it, 1/500, is in the gain, and in little else.
    """
    rng, t = np.random.default_rng(seed), 1e-4 * np.arange(2000)
    w, phase = 2.0 * np.pi * rng.uniform(20.0, 250.0, 8), rng.uniform(0.0, 2.0 * np.pi, 8)

    def wave(now):
        return 3.0 * np.sin(np.multiply.outer(now, w) + phase).sum(axis=-1)

    samples = wave(t)

    def rate(now, y):
        u = wave(now) if between == "band-limited" else np.interp(now, t, samples)
        return [100.0 * (u - 2.0 * y[0] - y[1]), 1e4 * y[0]]

    y = solve_ivp(rate, (t[0], t[-1]), [0.0, 0.0], "DOP853", t, rtol=1e-9, atol=1e-11, max_step=1e-4).y
    noisy = {name: x + 0.01 * x.std() * rng.standard_normal(len(t)) for name, x in zip("iv", y, strict=True)}
    return {"t": t, "u": samples} | noisy


@pytest.mark.parametrize("seeds", [2, pytest.param(8, marks=pytest.mark.slow)])
@pytest.mark.parametrize("between", ["band-limited", "linear"])
def test_errors_allow_for_holds_that_a_record_does_not_decide_between(between, seeds):
    """Without that a gain is up to five standard errors off where its input is smooth and taken as linear."""
    coordinates = {"i": Measured(), "v": Measured()}
    allowing = Study(data=Data(time="t"), coordinates=coordinates, inputs={"u": Driven()})
    for seed in range(seeds):
        model = identify(allowing, circuit(seed, between)).model
        (gain,) = (t for t in model.relations[0].terms if t.text == "u")
        assert abs(gain.coefficient + 100.0) < 3.0 * gain.std_error
        assert abs(gain.coefficient + 100.0) < 0.3


def test_a_hold_that_is_given_is_not_doubted():
    coordinates = {"i": Measured(), "v": Measured()}
    known = Study(data=Data(time="t"), coordinates=coordinates, inputs={"u": Driven(hold="band-limited")})
    open_ = Study(data=Data(time="t"), coordinates=coordinates, inputs={"u": Driven()})
    gains = []
    for study_, doubted in ((known, False), (open_, True)):
        result = identify(study_, circuit(0, "band-limited"))
        assert any("the record does not decide" in note for note in result.notes) == doubted
        gains += [t for t in result.model.relations[0].terms if t.text == "u"]
    assert gains[1].std_error > 1.5 * gains[0].std_error
    assert abs(gains[0].coefficient + 100.0) < 3.0 * gains[0].std_error


@pytest.mark.parametrize("seed", [0, *(pytest.param(s, marks=pytest.mark.slow) for s in (1, 3))])
def test_a_slow_input_that_comes_late_may_as_well_be_held_and_come_half_a_sample_earlier(seed):
    result = identify(study(), oscillator("slow", seed, late=0.0375))
    assert result.model.inputs[0].hold == "linear"
    assert any(note.startswith("u is linear between samples, or held: the record does not") for note in result.notes)
    error = result.model.scores.delays["u"].std_error
    assert result.model.inputs[0].delay == pytest.approx(0.0375, abs=error)
    assert 0.2 * PERIOD < error < 0.5 * PERIOD


@pytest.mark.parametrize("seed", [0, *(pytest.param(seed, marks=pytest.mark.slow) for seed in range(1, 6))])
def test_a_held_input_beside_a_drift_that_was_not_recorded_is_not_told_as_late(seed):
    rng, count, period, parts = np.random.default_rng(seed), 440, 0.25, 50
    u = np.convolve(rng.standard_normal(count + 12), np.hanning(13), "valid")
    u, x = u / u.std(), np.zeros(count)
    for k in range(count - 1):
        x[k + 1] = x[k]
        for part in range(parts):
            drift = 0.1 * np.sin(2.0 * np.pi * 1.3 * (k + part / parts) / count)
            x[k + 1] += period / parts * (-0.5 * x[k + 1] + 2.0 * u[k] + drift)
    log = {"t": period * np.arange(count), "x": x + 0.003 * x.std() * rng.standard_normal(count), "u": u}
    found = identify(Study(coordinates={"x": Measured()}, inputs={"u": Driven()}, data=Data(time="t")), log).model
    assert found.inputs[0].hold == "zero"
    assert abs(found.inputs[0].delay) < 0.1 * period  # half of the hold is what a line through the samples needs
    gain = {t.text: -t.coefficient for t in found.relations[0].terms}["u"]
    assert gain == pytest.approx(2.0, rel=0.01)
