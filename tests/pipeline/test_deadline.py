"""One clock for all searches of a run: it begins with the run, and what it ends leaves the best model so far."""

import time

import numpy as np
import pytest
from identification_cases import TIME

from odescope.likelihood.search import LikelihoodSearch
from odescope.pipeline import stages
from odescope.pipeline.identification import identify
from odescope.study.options import Driven, Measured, Study

T = 0.02 * np.arange(1500)


def shaken(seconds):
    """A mass on a spring under a recorded force, whose relations and Lagrange's equations compete, and its study."""
    rng = np.random.default_rng(0)
    u = np.repeat(rng.standard_normal(len(T) // 50), 50)
    x, v, seen = 0.5, 0.0, []
    for force in u:
        seen.append(x + 1e-3 * rng.standard_normal())
        for _ in range(20):
            v += 0.001 * (force - 4.0 * x - 0.3 * v)
            x += 0.001 * v
    study = Study(
        data=TIME,
        coordinates={"x": Measured(order=2)},
        inputs={"u": Driven(hold="zero")},
        likelihood=LikelihoodSearch(seconds=seconds),
    )
    return study, {"t": T, "x": np.array(seen), "u": u}


@pytest.fixture
def deadlines(monkeypatch):
    """Those that the searches are given."""
    found, refine = [], stages.refine

    def watched(*given):
        found.append(given[-1])
        return refine(*given)

    monkeypatch.setattr(stages, "refine", watched)
    return found


def test_the_clock_of_all_searches_began_with_the_run(deadlines):
    begun = time.time()
    result = identify(*shaken(1000.0))
    assert not [note for note in result.notes if "ended by the clock" in note]
    assert len(set(deadlines)) == 1
    assert 0.0 < deadlines[0] - 1000.0 - begun < 60.0


def test_when_the_clock_strikes_there_is_a_model_and_it_is_said(deadlines):
    result = identify(*shaken(1e-3))
    (warning,) = [w for w in result.warnings if "ended by the clock" in w]
    assert warning == "the search was ended by the clock, [likelihood] seconds: another run may end elsewhere"
    assert result.model.targets == ("x_ddot",)
    assert "suspicion" not in result.seconds


def test_without_one_no_search_looks_at_a_clock(deadlines):
    identify(*shaken(None))
    assert set(deadlines) == {None}
