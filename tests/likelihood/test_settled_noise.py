"""The noise that a model leaves of a short record, and what is searched for with it."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.linalg import expm
from small_systems import SPRING, SPRING_PRESENT, SPRING_STEP, drive, shots, spring_run

from odescope import Candidates, Coordinate, Data, Driven, Measured, Study, identify
from odescope.likelihood.evaluator import Evaluator
from odescope.likelihood.followed import followed
from odescope.likelihood.search import fitted_again, search
from odescope.likelihood.search_space import SearchSpace
from odescope.likelihood.segments import cut_segments
from odescope.likelihood.settled_noise import with_noise_left
from odescope.recordings.record import Record, Records
from odescope.signals.differentiators import Spectral
from odescope.signals.estimate import Channel, Signals, estimate_signals

NOISE = 2e-3


def spring(said):
    """Return the space of a spring whose noise is said to be so much, and the fit of its law."""
    states = spring_run()
    data = shots(states, drive(), SPRING_STEP, NOISE, np.random.default_rng(1), np.array([1e-3, 5e-3]))
    space = SearchSpace(Evaluator(replace(data, noise=np.array([said])), 2), SPRING.mechanisms, SPRING.frame)
    found = space.fit(SPRING.theta, SPRING_PRESENT, space.segments.initial, 1e-3 * data.spread)
    return space, found, states


def test_what_a_model_says_of_every_average_is_the_run_from_the_start_of_its_segment():
    space, found, states = spring(NOISE)
    signal, seen = followed(space, found)
    assert seen.all()
    assert np.abs(signal[:, 0] - states[:, 0]).max() < NOISE


@pytest.mark.parametrize("said", [0.5 * NOISE, 2.0 * NOISE])
def test_noise_that_was_said_wrong_is_what_the_model_leaves(said):
    space, found, _ = spring(said)
    left = with_noise_left(space, found)
    assert left.noise[0] == pytest.approx(NOISE, rel=0.06)
    assert np.all(left.weight == 1.0)
    again = space.on(left)
    assert with_noise_left(again, again.again(found, found.x0, 1e-3 * left.spread)) is None


def test_noise_that_was_said_right_stays():
    space, found, _ = spring(NOISE)
    assert with_noise_left(space, found) is None


def test_costs_under_two_noises_compare_with_what_their_densities_have_before_the_exponential():
    space, found, _ = spring(2.0 * NOISE)
    end = fitted_again(space, search(space, SPRING.theta), found)
    left = with_noise_left(space, found)
    right = fitted_again(space.on(left), end, space.on(left).again(found, found.x0, 1e-3 * left.spread))
    rest = followed(space, found)[0] - space.segments.measured

    def dense(noise):
        return float(np.sum((rest / noise) ** 2 + 2.0 * np.log(noise)))

    expected = dense(2.0 * NOISE) - dense(left.noise[0])
    assert end.deviance - right.deviance == pytest.approx(expected, abs=1.0)
    assert end.penalised < right.penalised  # what these say of it


def test_averages_of_a_short_log_whose_noise_grows_weigh_by_their_readings():
    t = 0.05 * np.arange(200)
    signal = 1.0 + 9.0 * np.exp(-0.6 * t)
    x = signal * (1.0 + 0.05 * np.random.default_rng(3).standard_normal(200))
    records = Records((Record(t, x[:, None], ("x",)),))
    channel = Channel("x", float(np.std(x - signal)), 0.4)
    data = cut_segments(records, Signals((), (), (), 0.05, (channel,), (Coordinate("x", 1),), ()), Spectral())
    assert data.block == 1
    deviation = data.noise[0] / data.weight[:, 0]
    assert np.abs(np.log(deviation / (0.05 * signal))).max() < 0.5
    steady = replace(channel, floor=channel.noise)  # what a solver leaves
    alike = cut_segments(records, Signals((), (), (), 0.05, (steady,), (Coordinate("x", 1),), ()), Spectral())
    assert alike.weight is None


@pytest.mark.parametrize("louder", [2.0, 5.0])
def test_averages_of_a_recording_that_is_noisier_weigh_less(louder):
    t, rng = 0.05 * np.arange(1200), np.random.default_rng(0)
    waves = [np.sin(0.6 * t), np.cos(0.5 * t)]
    read = [w + level * 0.01 * rng.standard_normal(1200) for w, level in zip(waves, (1.0, louder), strict=True)]
    records = Records(tuple(Record(t, x[:, None], ("x",)) for x in read))
    signals = estimate_signals(records, [Coordinate("x", 1)], [], Spectral())
    data = cut_segments(records, signals, Spectral())
    assert signals.channels[0].noise == pytest.approx(0.01 * np.sqrt(0.5 * (1.0 + louder**2)), rel=0.1)
    deviations = [data.noise[0] / data.weight[low:high, 0] * np.sqrt(data.block) for low, high in data.runs]
    assert all(np.ptp(d) == 0.0 for d in deviations)
    assert [d[0] for d in deviations] == pytest.approx([0.01, 0.01 * louder], rel=0.1)


def test_the_noise_that_a_model_leaves_is_that_of_each_recording():
    space, found, states = spring(NOISE)
    half = len(states) // 2
    measured = space.segments.measured.copy()
    measured[half:] += 3.0 * NOISE * np.random.default_rng(5).standard_normal(measured[half:].shape)
    louder = space.on(replace(space.segments, measured=measured, runs=((0, half), (half, len(states)))))
    left = with_noise_left(louder, found)
    deviations = left.noise[0] / left.weight[:, 0]
    assert [deviations[0], deviations[-1]] == pytest.approx([NOISE, np.sqrt(10.0) * NOISE], rel=0.1)
    assert np.ptp(deviations[:half]) == np.ptp(deviations[half:]) == 0.0


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, 3])
def test_the_law_of_an_epidemic_is_found_from_few_counts_that_are_off_by_a_share(seed):
    t, rng = np.linspace(0.0, 10.0, 75), np.random.default_rng(seed)
    rates = {"x": {"x_dot", "x*y"}, "y": {"y_dot", "x*y", "y"}}
    run = solve_ivp(
        lambda _, s: [-0.5 * s[0] * s[1], 0.5 * s[0] * s[1] - 0.4 * s[1]],
        (0.0, 10.0), [6.0, 0.7], t_eval=t, rtol=1e-9, atol=1e-10,
    )  # fmt: skip
    counted = run.y.T * (1.0 + 0.05 * rng.standard_normal((75, 2)))
    study = Study(data=Data(time="t"), coordinates={name: Measured(order=1) for name in rates}, library=Candidates())
    model = identify(study, {"t": t, "x": counted[:, 0], "y": counted[:, 1]}).model
    assert [{t.product.text for t in r.terms} for r in model.relations] == list(rates.values())
    assert all(abs(t.coefficient) == pytest.approx(c, rel=0.05)
               for r, own in zip(model.relations, ({"x*y": 0.5}, {"x*y": 0.5, "y": 0.4}), strict=True)
               for t in r.terms if (c := own.get(t.product.text)))  # fmt: skip


@pytest.mark.parametrize("seed", range(2))
def test_every_channel_of_a_long_record_has_its_own_noise(seed):
    """The filter takes kinks of one, which follows a stepped input, for noise, and noise of the other for signal."""
    rng, step, count = np.random.default_rng(seed), 0.2, 2000
    u, states = np.repeat(rng.uniform(-1.0, 1.0, count // 40), 40), np.zeros((count, 2))
    held = expm(step * np.array([[-2.0, 0.0, 2.0], [1.0, -0.5, 0.0], [0.0, 0.0, 0.0]]))
    for k in range(count - 1):
        states[k + 1] = held[:2] @ [*states[k], u[k]]
    noise = np.array([0.003, 0.02]) * states.std(axis=0)
    x, y = (states + noise * rng.standard_normal((count, 2))).T
    study = Study(data=Data(time="t"), coordinates={"x": Measured(), "y": Measured()}, inputs={"u": Driven()})
    result = identify(study, {"t": step * np.arange(count), "x": x, "y": y, "u": u})
    found = result.refinement
    np.testing.assert_allclose(found.space.segments.noise * np.sqrt(found.scale), noise, rtol=0.05)
    terms = [{t.text: t for t in relation.terms} for relation in result.model.relations]
    assert [set(t) for t in terms] == [{"x_dot", "x", "u"}, {"y_dot", "x", "y"}]
    for relation, truth in zip(terms, ({"x": 2.0, "u": -2.0}, {"x": -1.0, "y": 0.5}), strict=True):
        assert all(abs(relation[n].coefficient - value) < 4.0 * relation[n].std_error for n, value in truth.items())
