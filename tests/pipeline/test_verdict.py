"""Whether what was found is a model, and what is told where nothing was."""

import numpy as np
import pytest
from identification_cases import study_of

from odescope.errors import NoModelError
from odescope.model.scores import ModelScores, TargetScore
from odescope.pipeline.evaluation import require_prediction
from odescope.pipeline.identification import NothingFound, identify
from odescope.study.options import Measured


def held_out(*r2):
    return ModelScores(targets={f"x{k}_dot": TargetScore(r2_held_out=value) for k, value in enumerate(r2)})


def test_a_regression_that_is_further_off_than_the_mean_is_no_model():
    with pytest.raises(NoModelError, match=r"the best relation for x1_dot is further off .* \(R² = -31\)") as e:
        require_prediction(held_out(0.9, -31.0), follows=False)
    assert (e.value.stage, e.value.exit_code) == ("model", 3)


@pytest.mark.parametrize(
    ("found", "follows"), [(held_out(0.9, -31.0), True), (held_out(0.1, None), False), (None, False)]
)
def test_what_follows_the_record_or_predicts_a_little_is_a_model(found, follows):
    require_prediction(found, follows)


@pytest.mark.parametrize("order", [1, 2])
def test_what_was_searched_in_vain_is_told_before_the_error(order):
    rng, events = np.random.default_rng(0), []
    study = study_of(coordinates={"x": Measured(order=order), "y": Measured(order=order)})
    walks = {name: np.cumsum(rng.standard_normal(3000)) for name in "xy"}
    with pytest.raises(NoModelError) as e:
        identify(study, {"t": np.arange(3000.0), **walks}, watch=events.append)
    (told,) = (event for event in events if isinstance(event, NothingFound))
    assert told.failure is e.value
    assert any("time counts in whole numbers" in sentence for sentence in told.advice)
    assert told.result.signals.samples > 1000
    for search, best in zip(told.result.searches, told.result.chosen, strict=True):
        assert search.found.supports
        assert best is search.ranked.candidates[0]
    assert told.result.model.targets == told.result.signals.targets
