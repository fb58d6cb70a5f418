"""Where on the path of models to stop, given the errors of free runs."""

import numpy as np
import pytest

from odescope.likelihood.path import ModelPath, PathStep


def path(*errors):
    """Return a path whose models have these errors in each of three stretches, one term fewer each."""
    steps = [PathStep(None, np.array(e), None, 0.0, len(errors) - k) for k, e in enumerate(errors)]
    return ModelPath(None, tuple(steps), 0)


@pytest.mark.parametrize(
    ("longer", "shorter", "terms"),
    [
        (0.0030, 0.0045, 1),  # both near the record, and nearly as near
        (4e-5, 0.0045, 2),  # both near the record, but a hundred times further without the term
        (0.0030, 0.0080, 2),  # the shorter one is further off than half a percent
    ],
)
def test_a_term_that_brings_runs_much_nearer_stays_however_near_they_are_without(longer, shorter, terms):
    assert path([longer] * 3, [shorter] * 3).at_knee.choice.terms == terms
