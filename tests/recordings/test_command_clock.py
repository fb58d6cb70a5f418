"""Inputs that a controller changes at even times, in logs that were taken off these."""

import numpy as np
import pytest

from odescope import Data, Driven, Measured, Study, identify
from odescope.recordings.command_clock import by_clock, clock_phase, last_ticks


def taken(rng, count, off=0.3):
    """Return when samples were taken, in periods, off even times but in order."""
    return np.arange(count) + rng.uniform(-off, off, count)


@pytest.mark.parametrize("seed", range(10))
def test_the_clock_of_a_command_is_seen_and_what_was_read_stands_at_its_ticks(seed):
    rng = np.random.default_rng(seed)
    at, phase = taken(rng, 600), rng.uniform(-0.2, 0.2)
    command = np.sin(0.3 * np.arange(-1, 602))
    tick = np.floor(at - phase).astype(int)
    values = command[tick + 1]
    found = clock_phase(at, [values])
    assert found == pytest.approx(phase, abs=0.01)
    on_ticks = by_clock(last_ticks(at, found), values, 599)
    read = np.isin(np.arange(599), tick)
    np.testing.assert_array_equal(on_ticks[read], command[1:600][read])
    assert np.abs(on_ticks - command[1:600]).max() < 0.05  # between two ticks that were read: the mean of these


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
    assert clock_phase(at, [values]) is None
    assert clock_phase(np.arange(600.0), [values]) is None


def test_an_input_that_changes_between_ticks_goes_by_no_clock():
    rng = np.random.default_rng(0)
    at = taken(rng, 400)
    assert by_clock(last_ticks(at, 0.0), np.sin(0.3 * at), 400) is None


@pytest.mark.parametrize("seed", range(3))
def test_a_lag_is_found_behind_commands_that_were_read_off_their_ticks(seed):
    rng, count, period, rate = np.random.default_rng(seed), 1200, 0.1, 2.0
    u = np.sin(0.3 * np.arange(count) + 4e-4 * np.arange(count) ** 2) + 0.5
    fresh = np.zeros(count + 1)
    for k in range(count):  # held, so exact from tick to tick
        fresh[k + 1] = u[k] + (fresh[k] - u[k]) * np.exp(-rate * period)
    at = np.clip(taken(rng, count - 1), 0.0, None)
    tick = np.floor(at).astype(int)
    x = u[tick] + (fresh[tick] - u[tick]) * np.exp(-rate * period * (at - tick))
    log = {"t": period * at, "x": x + 0.003 * rng.standard_normal(len(x)), "u": u[tick]}
    study = Study(data=Data(time="t"), coordinates={"x": Measured(order=1)}, inputs={"u": Driven()})
    found = identify(study, log)
    (relation,) = found.model.relations
    terms = {t.text: t.coefficient for t in relation.terms[1:]}
    assert terms == {"x": pytest.approx(-rate, rel=0.005), "u": pytest.approx(rate, rel=0.005)}
    assert any("u changes at even times alone" in note for note in found.notes)
