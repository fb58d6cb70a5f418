"""The R² of a target that hardly varies is that of noise: it stays in files, and nobody is told it."""

from dataclasses import replace

import msgspec
import numpy as np
import pytest
from pages import Page, blank

from odescope.likelihood.search import LikelihoodSearch
from odescope.model.notes import trust
from odescope.model.scores import ModelScores, TargetScore, hardly_varies
from odescope.model.worth import uncertain
from odescope.pipeline.identification import identify
from odescope.report import summary, to_html
from odescope.report.console import trust_text
from odescope.study.library_options import Candidates
from odescope.study.options import Data, Measured, Study


@pytest.mark.parametrize(
    ("r2", "explained", "steady"), [(-3e-4, 0.99999, True), (0.5, 0.99999, False), (0.0, 0.5, False)]
)
def test_a_target_is_steady_where_its_mean_is_nearly_all_of_it(r2, explained, steady):
    scores = ModelScores({"x_ddot": TargetScore(r2_held_out=r2, explained_held_out=explained)})
    assert hardly_varies(r2, explained) is steady
    assert any("of the variance of x_ddot" in line for line in trust(scores)) is not steady
    assert ("of the variance" in uncertain(scores)) is (not steady and r2 < 0.5)


def test_the_target_of_a_falling_body_has_a_dash():
    t = 0.01 * np.arange(300)
    height = 50.0 + 2.0 * t - 4.905 * t**2 + 0.01 * np.random.default_rng(0).standard_normal(300)
    study = Study(
        data=Data(time="t"),
        coordinates={"h": Measured(order=2, unit="m")},
        library=Candidates(basis=("h_dot",), degree=1),
        likelihood=LikelihoodSearch(starts=1),
    )
    result = identify(study, {"t": t, "h": height})
    score = result.model.scores.targets["h_ddot"]
    assert score.r2_held_out < 0.1
    report = summary(result, "fall")
    assert "R²" not in trust_text(report)  # a free run over what is held out says more
    without = replace(result.model, scores=msgspec.structs.replace(result.model.scores, path=()))
    alone = trust_text(summary(replace(result, model=without), "fall"))
    assert alone.splitlines()[1].split() == ["h_ddot", "1", "–"]
    page = Page(to_html(report, blank(report)))
    assert ["h_ddot", "–"] in [cells[:2] for _, cells in page.rows]
    assert "A target that hardly varies about its mean has no R²" in page.text
