"""Recordings so short that each is one segment of the likelihood."""

import numpy as np
import pytest

from odescope import Data, LikelihoodSearch, Measured, Study, identify


def logistic(seed):
    t = np.arange(401) * 0.025
    return {"t": t, "y": 2.0 / (1.0 + 39.0 * np.exp(-1.2 * t)) + np.random.default_rng(seed).normal(0.0, 0.003, 401)}


@pytest.mark.parametrize("terms", [None, 2])
def test_have_a_path_of_models_to_choose_from(terms):
    study = Study(data=Data(time="t"), coordinates={"y": Measured()}, likelihood=LikelihoodSearch(terms=terms))
    found = identify(study, [logistic(1), logistic(2)]).model
    assert found.scores is not None
    assert [step.terms for step in found.scores.path] == [3, 2]
    assert sum(len(r.terms) for r in found.relations) == (terms or 3)
