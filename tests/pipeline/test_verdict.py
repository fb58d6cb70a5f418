"""Whether what was found is a model, and what is told where nothing was."""

import numpy as np
import pytest
from identification_cases import study_of
from scipy.integrate import solve_ivp

from odescope.errors import NoModelError
from odescope.model.scores import ModelScores, TargetScore
from odescope.model.worth import uncertain
from odescope.pipeline.evaluation import require_prediction
from odescope.pipeline.identification import NothingFound, identify
from odescope.study.library_options import Candidates
from odescope.study.options import Data, Measured, Study


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


def reactor(feed, reactions, composition=None):
    """A -> B -> C in a stirred tank with a feed of A and an outflow of all: two logs, and a study of some reactions."""

    def change(_, y):
        a, b, c = y
        return [feed * (1.0 - a) - 0.5 * a, 0.5 * a - 0.3 * b - feed * b, 0.3 * b - feed * c]

    rng, t, logs = np.random.default_rng(0), np.linspace(0.0, 20.0, 300), []
    for start in ([2.0, 0.0, 0.0], [0.3, 1.0, 0.2]):
        y = solve_ivp(change, (0.0, 20.0), start, t_eval=t, rtol=1e-9).y
        logs.append({"t": t, **dict(zip("ABC", y + 0.01 * rng.standard_normal(y.shape), strict=True))})
    library = Candidates(form="reactions", reactions=reactions, composition=composition)
    return Study(data=Data(time="t"), coordinates={n: Measured() for n in "ABC"}, library=library), logs


@pytest.mark.parametrize("composition", [None, {"A": "a", "B": "a", "C": "a"}])
def test_a_network_that_lacks_the_feed_of_its_record_is_uncertain_and_says_what_to_add(composition):
    result = identify(*reactor(0.02, None if composition else ("A -> B", "B -> C"), composition))
    said = uncertain(result.model.scores)
    assert said.startswith("uncertain: these reactions would keep")
    assert '"-> S"' in said


def test_a_network_whose_reactions_explain_nothing_is_no_model():
    with pytest.raises(NoModelError, match=r'no candidate earns its place.*"-> S"') as e:
        identify(*reactor(0.5, ("A -> B", "B -> C")))
    assert e.value.exit_code == 3


def test_with_its_feed_the_network_is_found_and_certain():
    result = identify(*reactor(0.2, ("A -> B", "B -> C", "-> A", "A ->", "B ->", "C ->")))
    assert uncertain(result.model.scores) == ""
    rates = {m.name: m.coefficient for m in result.model.mechanisms}
    assert rates == pytest.approx(
        {"A -> B": 0.5, "B -> C": 0.3, "-> A": 0.2, "A ->": 0.2, "B ->": 0.2, "C ->": 0.2}, rel=0.1
    )
