"""Inputs that a controller changes at even times, in logs that were taken off these."""

import numpy as np
import pytest

from odescope import Data, Driven, Measured, Study, identify
from odescope.recordings.command_clock import by_clock, command_clock


def taken(rng, count, off=0.3):
    """Return when samples were taken, in periods, off even times but in order."""
    return np.arange(count) + rng.uniform(-off, off, count)


@pytest.mark.parametrize("seed", range(10))
def test_the_clock_of_a_command_is_seen_and_what_was_read_stands_at_its_ticks(seed):
    rng = np.random.default_rng(seed)
    phase, drift = rng.uniform(-0.2, 0.2), rng.uniform(-3e-5, 3e-5)  # a fiftieth of a period over the log
    at = phase + 1.0 + (1.0 + drift) * taken(rng, 600)
    command = np.sin(0.3 * np.arange(-1, 602))
    begun = np.floor((at - phase) / (1.0 + drift)).astype(int)
    values = command[begun]
    tick, period = command_clock(at, [values])
    assert period == pytest.approx(1.0 + drift, abs=0.01 / 600)
    origin = tick - round(tick - phase) * period
    assert origin == pytest.approx(phase, abs=0.01)
    found = by_clock(np.floor((at - origin) / period).astype(int), values, 600)
    read = np.isin(np.arange(600), begun)
    # A sample hardly before or after a tick may be taken for one of the other side.
    assert np.mean(found[read] == command[:600][read]) > 0.99
    assert np.median(np.abs(found - command[:600])[~read]) < 1e-3  # what was not read lies on a smooth curve


@pytest.mark.parametrize("seed", range(10))
@pytest.mark.parametrize("kind", ["smooth", "with the sample", "held over ten samples", "by hand"])
def test_no_clock_is_seen_where_there_is_none(seed, kind):
    rng = np.random.default_rng(seed)
    at = taken(rng, 600)
    level = rng.standard_normal(601)
    switched = np.sort(rng.uniform(0.0, 600.0, 40))
    values = {
        "smooth": np.sin(0.3 * at),
        "with the sample": level[:600],
        "held over ten samples": np.repeat(level[:60], 10),
        "by hand": level[np.searchsorted(switched, at)],
    }[kind]
    assert command_clock(at, [values]) is None
    assert command_clock(np.arange(600.0), [values]) is None


def test_a_command_that_steps_lies_on_a_line_where_it_was_not_read():
    command = np.repeat([0.0, 1.0, -1.0, 2.0], 10)
    read = np.setdiff1d(np.arange(40), [5, 10])
    found = by_clock(read, command[read], 40)
    np.testing.assert_array_equal(found, np.where(np.arange(40) == 10, 0.5, command))


def test_an_input_that_changes_between_ticks_goes_by_no_clock():
    rng = np.random.default_rng(0)
    at = taken(rng, 400)
    assert by_clock(np.floor(at).astype(int), np.sin(0.3 * at), 400) is None


@pytest.mark.parametrize("seed", range(4))
def test_a_lag_is_found_behind_commands_that_were_read_off_their_ticks(seed):
    rng, count, period, rate = np.random.default_rng(seed), 1200, 0.1, 2.0
    u = np.sin(0.3 * np.arange(count) + 1e-4 * np.arange(count) ** 2) + 0.5
    fresh = np.zeros(count + 1)
    for k in range(count):  # held, so exact from tick to tick
        fresh[k + 1] = u[k] + (fresh[k] - u[k]) * np.exp(-rate * period)
    at = np.clip(taken(rng, count - 1), 0.0, None)
    tick = np.floor(at).astype(int)
    x = u[tick] + (fresh[tick] - u[tick]) * np.exp(-rate * period * (at - tick))
    log = {"t": period * at, "x": x + 0.01 * rng.standard_normal(len(x)), "u": u[tick]}
    study = Study(data=Data(time="t"), coordinates={"x": Measured(order=1)}, inputs={"u": Driven()})
    found = identify(study, log)
    (relation,) = found.model.relations
    terms = {t.text: t.coefficient for t in relation.terms[1:]}  # x_dot + 2 x - 2 u = 0
    assert terms == {"x": pytest.approx(rate, rel=0.01), "u": pytest.approx(-rate, rel=0.01)}
    assert any("u changes at even times alone" in note for note in found.notes)
