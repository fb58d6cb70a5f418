"""What the tests of identification and what_supports_no_model share."""

from __future__ import annotations

import numpy as np
import pytest

from odescope.likelihood.search import LikelihoodSearch
from odescope.study.library_options import Candidates
from odescope.study.options import Data, Driven, Measured, Study

TIME = Data(time="t")


REGRESSED = LikelihoodSearch(enabled=False)  # what is tested here is the path up to the model of the regression


def study_of(**options):
    return Study(**{"data": TIME, "likelihood": REGRESSED, **options})


def band(rng, count, period, cutoff):
    """White noise cut at a frequency, of variance 1."""
    spectrum = np.fft.rfft(rng.standard_normal(count))
    spectrum[np.fft.rfftfreq(count, period) > cutoff] = 0.0
    wave = np.fft.irfft(spectrum, count)
    return wave / wave.std()


def runge_kutta(f, t, start, u, zero=False, steps=2):
    """The classical method, `steps` a sample, the input linear between samples or held: states (N, n)."""
    state = np.array(start, dtype=float)
    found = [state]
    for k, width in enumerate(np.diff(t)):
        h, slope = width / steps, 0.0 if zero else (u[k + 1] - u[k]) / width
        for s in range(steps):
            now = s * h
            a = f(state, u[k] + slope * now)
            b = f(state + h / 2 * a, u[k] + slope * (now + h / 2))
            c = f(state + h / 2 * b, u[k] + slope * (now + h / 2))
            d = f(state + h * c, u[k] + slope * (now + h))
            state = state + h / 6 * (a + 2 * b + 2 * c + d)
        found.append(state)
    return np.array(found)


def noisy(rng, values, size):
    return values + size * values.std() * rng.standard_normal(len(values))


def relations(result):
    return {
        target: {t.text: t.coefficient for t in relation.terms}
        for target, relation in zip(result.model.targets, result.model.relations, strict=True)
    }


def assert_recovers(result, truth, rel):
    found = relations(result)
    assert found.keys() == truth.keys()
    for target, terms in truth.items():
        assert found[target].keys() == terms.keys(), target
        for term, value in terms.items():
            assert found[target][term] == pytest.approx(value, rel=rel), f"{term} of {target}"


DEMO = study_of(
    coordinates={"x": Measured(order=2, cyclic=True, unit="m"), "phi": Measured(order=2, angle=True)},
    inputs={"u": Driven()},
    library=Candidates(preset="paper"),
)
