from dataclasses import dataclass, replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from odescope.errors import InputError, NoModelError
from odescope.recordings.coordinate import Coordinate, Input, state_names
from odescope.recordings.record import Record, Records, Stretch
from odescope.signals.cutoff import FixedCutoff
from odescope.signals.differentiators import Derivatives, SavitzkyGolay, Spectral
from odescope.signals.estimate import estimate_signals, signals_like
from odescope.signals.spectral import differentiate_smoothly, reach

X, PHI, U = Coordinate("x", order=2), Coordinate("phi", order=1), Input("u")


def record(t, **columns):
    return Record(t, np.column_stack(list(columns.values())), tuple(columns))


@dataclass(frozen=True)
class Exact:
    """A differentiator of one's own: sin(rate t + phase) in closed form, its phase read off the first sample."""

    rate: float
    cutoff: float

    def derivatives(self, channel, period, order):
        values = []
        for samples in channel:
            phase = np.arcsin(samples[0]) + self.rate * period * np.arange(len(samples))
            values.append(np.array([self.rate**k * np.sin(phase + k * np.pi / 2.0) for k in range(order + 1)]))
        return Derivatives(tuple(values), 0.0, self.cutoff)


def sines(starts=(0.0,), counts=(1000,), period=0.01, rate=1.0):
    runs = []
    for start, count in zip(starts, counts, strict=True):
        t = start + period * np.arange(count)
        wave = np.sin(rate * (t - start) + 0.3)
        runs.append(record(t, u=np.cos(0.7 * t), phi=wave, x=wave))
    return Records(tuple(runs))


def test_states_of_mixed_orders_come_by_derivative():
    mixed = [Coordinate("a", order=3), Coordinate("b"), Coordinate("c", order=2)]
    assert state_names(mixed) == ("a", "b", "c", "a_dot", "c_dot", "a_ddot")


def test_every_row_is_what_its_name_says_at_the_times_that_start_and_period_give():
    signals = estimate_signals(sines((0.0, 50.0), (1000, 700)), [X, PHI], [U], Exact(1.0, 0.8), margin=0.2)
    assert signals.names == ("x", "phi", "x_dot", "x_ddot", "phi_dot", "u")
    assert signals.period == pytest.approx(0.15)  # eight samples a period of 0.8 Hz allow 0.156
    for columns, start, origin in zip(signals.columns, signals.start, (0.0, 50.0), strict=True):
        t = start + signals.period * np.arange(columns.shape[1])
        phase = t - origin + 0.3
        expected = {"x": np.sin(phase), "phi": np.sin(phase), "x_dot": np.cos(phase), "phi_dot": np.cos(phase)}
        expected |= {"x_ddot": -np.sin(phase)}
        for name, values in expected.items():
            assert columns[signals.row(name)] == pytest.approx(values, abs=1e-9)
        # The thinned input passes a filter, which meets its ends.
        assert columns[signals.row("u")] == pytest.approx(np.cos(0.7 * t), abs=2e-3)


def test_without_thinning_inputs_and_grid_are_those_of_the_record():
    records = sines()
    signals = estimate_signals(records, [X], [U], Exact(1.0, 0.5), margin=0.05, decimate=False)
    kept = slice(10, 990)
    assert signals.period == pytest.approx(0.01, rel=1e-12)
    assert np.array_equal(signals.columns[0][signals.row("u")], records.runs[0].column("u")[kept])
    assert signals.start == (records.runs[0].t[10],)
    assert signals.samples == 980


@pytest.mark.parametrize("cutoff", [0.3, 1.1, 4.0, 13.0, 40.0])
def test_thinning_keeps_at_least_eight_samples_a_period_of_the_cutoff_and_no_stride_to_spare(cutoff):
    signals = estimate_signals(sines(), [X], [], Exact(1.0, cutoff))
    stride = round(signals.period / 0.01)
    assert stride == 1 or 1.0 / signals.period >= 8.0 * cutoff
    assert 1.0 / ((stride + 1) * 0.01) < 8.0 * cutoff


def test_the_highest_cutoff_sets_the_rate_and_the_lowest_the_margin():
    @dataclass(frozen=True)
    class Two:
        def derivatives(self, channel, period, order):
            return Exact(1.0, 5.0 if order == 2 else 1.25).derivatives(channel, period, order)

    signals = estimate_signals(sines(counts=(4000,)), [X, PHI], [], Two(), margin=0.5)
    assert signals.start[0] == pytest.approx(0.5 / 1.25)
    assert signals.period == pytest.approx(0.02)
    assert [(c.name, c.cutoff) for c in signals.channels] == [("x", 5.0), ("phi", 1.25)]


def test_margins_never_take_more_than_a_twentieth():
    signals = estimate_signals(sines((0.0, 0.0), (1000, 200)), [X], [], Exact(1.0, 0.01), decimate=False)
    assert [c.shape[1] for c in signals.columns] == [900, 180]


def test_an_input_faster_than_the_thinned_rate_does_not_fold_onto_the_signals():
    t = 0.01 * np.arange(2000)
    slow = np.cos(0.5 * t)
    for hertz in (11.0, 23.0, 49.0):
        records = Records((record(t, x=np.sin(t + 0.3), u=slow + np.cos(2.0 * np.pi * hertz * t)),))
        signals = estimate_signals(records, [X], [U], Exact(1.0, 1.0))
        assert signals.period == pytest.approx(0.12)
        kept = signals.start[0] + signals.period * np.arange(signals.samples)
        assert np.sqrt(np.mean((signals.columns[0][signals.row("u")] - np.cos(0.5 * kept)) ** 2)) < 0.05


def test_joined_puts_the_records_end_to_end():
    signals = estimate_signals(sines((0.0, 9.0), (600, 400)), [X], [U], Exact(1.0, 2.0))
    joined = signals.joined()
    first = signals.columns[0].shape[1]
    assert np.array_equal(joined[:, :first], signals.columns[0])
    assert np.array_equal(joined[:, first:], signals.columns[1])
    assert joined.shape[1] == signals.samples


@pytest.mark.parametrize("differentiator", [Spectral(), SavitzkyGolay(41, 4)])
def test_a_noisy_pendulum_satisfies_its_own_equation(differentiator):
    starts, t = [(2.0, 0.0), (0.5, 6.0)], 0.01 * np.arange(1500)
    runs, truth = [], []
    for seed, start in enumerate(starts):
        y = solve_ivp(
            lambda _, s: [s[1], -9.0 * np.sin(s[0])], (0.0, 15.0), start, "DOP853", t, rtol=1e-10, atol=1e-10
        ).y
        runs.append(record(t, x=y[0] + 0.003 * np.random.default_rng(seed).standard_normal(len(t))))
        truth.append(y)
    signals = estimate_signals(Records(tuple(runs)), [X], [], differentiator)
    x, x_dot, x_ddot = signals.joined()
    assert np.sqrt(np.mean((x_ddot + 9.0 * np.sin(x)) ** 2)) < 0.05 * x_ddot.std()
    for columns, start, (angle, rate) in zip(signals.columns, signals.start, truth, strict=True):
        at = np.round((start + signals.period * np.arange(columns.shape[1])) / 0.01).astype(int)
        assert np.sqrt(np.mean((columns[0] - angle[at]) ** 2)) < 0.003
        assert np.sqrt(np.mean((columns[1] - rate[at]) ** 2)) < 0.03 * x_dot.std()
    assert signals.channels[0].noise == pytest.approx(0.003, rel=0.1)


# refusals


def test_recordings_at_different_periods_are_refused():
    runs = (*sines().runs, *sines(period=0.02, counts=(500,)).runs)
    with pytest.raises(InputError, match=r"sampled at different periods, 0\.01 s to 0\.02 s"):
        estimate_signals(Records(runs), [X], [U], Exact(1.0, 1.0))


def test_periods_that_differ_by_the_rounding_of_their_clocks_are_one():
    runs = (*sines().runs, *sines(period=0.01 * (1.0 + 1e-6)).runs)
    assert len(estimate_signals(Records(runs), [X], [U], Exact(1.0, 1.0)).columns) == 2


@pytest.mark.parametrize("order", [1, 2, 3])
@pytest.mark.parametrize("differentiator", [Spectral(), Spectral(FixedCutoff(3.0)), SavitzkyGolay(41, 4)])
def test_noise_alone_is_no_signal(order, differentiator):
    for seed in range(5):
        rng = np.random.default_rng(seed)
        t = 0.01 * np.arange(600)
        runs = Records((record(t, good=np.sin(t), flat=rng.standard_normal(600)),))
        with pytest.raises(NoModelError, match="the signals stage came out empty: flat holds nothing") as caught:
            estimate_signals(runs, [Coordinate("good"), Coordinate("flat", order)], [], differentiator)
        assert (caught.value.stage, caught.value.exit_code) == ("signals", 3)


@pytest.mark.parametrize("order", [1, 2])
def test_a_slow_wave_under_three_times_its_noise_is_still_a_signal(order):
    t = 0.01 * np.arange(3000)
    for seed in range(5):
        samples = np.sin(t) + 2.0 * np.random.default_rng(seed).standard_normal(3000)
        signals = estimate_signals(Records((record(t, x=samples),)), [Coordinate("x", order)], [], Spectral())
        found = signals.columns[0][0]
        expected = np.sin(signals.start[0] + signals.period * np.arange(len(found)))
        assert np.corrcoef(found, expected)[0, 1] > 0.9


# piece by piece


def long_record(count=60_000, seed=0):
    """A drift, a sine, a random walk and noise; and an input with steps."""
    rng = np.random.default_rng(seed)
    t = 0.01 * np.arange(count)
    walk, noise = 0.02 * np.cumsum(rng.standard_normal(count)), 0.1 * rng.standard_normal(count)
    x = 0.2 * t + 3.0 * np.sin(4.0 * t) + walk + noise
    return record(t, x=x, u=np.sign(np.sin(0.7 * t)) + 0.1 * np.sin(3.0 * t))


@pytest.mark.parametrize("rows", [3000, 7777, 20_000])
def test_a_long_record_filtered_piece_by_piece_has_the_derivatives_of_the_whole(rows):
    """To a millionth of their scale, away from the ends of the record: there, no filter is right."""
    whole = long_record()
    x = Coordinate("x", 2)
    like = estimate_signals(Records((whole,)), [x], [U], Spectral(FixedCutoff(1.5)), decimate=False)
    overlap = int(np.ceil(reach(1.5) / 0.01)) + 1
    pieces = []
    for first in range(0, len(whole), rows):
        low, high = max(0, first - overlap), min(len(whole), first + rows + overlap)
        own = first - low, min(first + rows, len(whole)) - low
        piece = replace(whole, t=whole.t[low:high], values=whole.values[low:high])
        pieces.append(Stretch(piece, *own, begins=low == 0, ends=high == len(whole)))
    at_once = signals_like(like, [Stretch(whole, 0, len(whole), begins=False, ends=False)], Spectral()).columns[0]
    joined = signals_like(like, pieces, Spectral())
    drop = len(whole) - joined.samples
    assert 0 < drop < 0.01 * len(whole)  # margins at the two ends
    found = np.concatenate(joined.columns, axis=1)[:, overlap : -2 * overlap]
    expected = at_once[:, drop // 2 :][:, overlap : overlap + found.shape[1]]
    scale = at_once.std(axis=1)
    assert np.all(np.abs(found - expected).max(axis=1) < 1e-6 * scale)
    half = overlap // 2  # the overlap is not longer than it has to be
    piece = pieces[1]
    run, own = piece.record, slice(half, len(piece.record) - half)
    shorter = replace(run, t=run.t[own], values=run.values[own])
    worse = replace(piece, record=shorter, first=piece.first - half, stop=piece.stop - half)
    (cut,) = signals_like(like, [worse], Spectral()).columns
    assert np.any(np.abs(cut - at_once[:, rows : rows + cut.shape[1]]).max(axis=1) > 1e-6 * scale)


def test_a_piece_passes_what_lies_below_the_cutoff_and_nothing_far_above():
    t = 0.01 * np.arange(20_000)
    for hertz, gain in ((0.5, 1.0), (1.45, 1.0), (2.1, 0.0), (9.0, 0.0)):
        x = np.sin(2 * np.pi * hertz * t)
        middle = differentiate_smoothly(x, 0.01, 1.5, 1)[:, 5000:15_000]
        assert np.abs(middle[0] - gain * x[5000:15_000]).max() < 1e-5
        slope = 2 * np.pi * hertz * np.cos(2 * np.pi * hertz * t[5000:15_000])
        assert np.abs(middle[1] - gain * slope).max() < 1e-5 * np.abs(slope).max()


@pytest.mark.parametrize("differentiator", [Spectral(), SavitzkyGolay(31)])
def test_other_whole_records_are_filtered_as_those_before(differentiator):
    records = sines((0.0, 9.0), (1500, 1100))
    both = estimate_signals(records, [X], [U], differentiator)
    again = signals_like(both, [Stretch.whole(r) for r in records], differentiator)
    assert again.start == both.start
    for one, other in zip(again.columns, both.columns, strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-12, atol=1e-12)
    slow = record(0.037 * np.arange(500), x=np.sin(0.1 * np.arange(500)), u=np.zeros(500))
    with pytest.raises(InputError, match=r"a recording is sampled every 0\.037 s"):
        signals_like(both, [Stretch.whole(slow)], differentiator)


@pytest.mark.parametrize("taken_out", [0, 40])
def test_the_noise_of_a_sensor_that_averages_is_known_whether_a_few_samples_count_or_not(taken_out):
    rng, t = np.random.default_rng(5), 0.01 * np.arange(4000)
    smoothed = np.convolve(rng.standard_normal(len(t)), np.full(5, 0.2), "same")
    counts = np.ones((len(t), 1))
    counts[rng.choice(len(t), taken_out, replace=False)] = 0.0
    run = Record(t, (np.sin(t) + 0.01 * smoothed)[:, None], ("x",), counts=counts if taken_out else None)
    channel = estimate_signals(Records.of([run]), [Coordinate("x")], [], Spectral()).channels[0]
    assert 0.007 < channel.noise < 0.014
    assert 0.1 < channel.white < 0.4
