"""A coordinate that nothing in the record moves is perhaps an input."""

import numpy as np
import pytest
from scipy.interpolate import PchipInterpolator

from odescope import Candidates, Data, Driven, Measured, NoModelError, Study, identify
from odescope.pipeline.identification import NothingFound


def vehicle(friction):
    """Speed on a road whose slope comes and goes, v' = F - .8 v - 2 s and what else there may be, 60 s at 40 ms."""
    rng, t = np.random.default_rng(0), 0.04 * np.arange(1500)
    slope = PchipInterpolator(np.arange(0.0, 64.0, 2.0), rng.uniform(-1.0, 1.0, 32))(t)
    force = rng.uniform(0.0, 3.0, 40)[(t / 1.7).astype(int)]
    speed = np.ones(len(t))
    for k in range(len(t) - 1):
        middle = 0.5 * (slope[k] + slope[k + 1])
        steady = (force[k] - 2.0 * middle - friction[k]) / 0.8
        speed[k + 1] = steady + (speed[k] - steady) * np.exp(-0.8 * 0.04)
    noise = rng.standard_normal((2, len(t)))
    return {"t": t, "v": speed + 0.01 * noise[0], "s": slope + 0.005 * noise[1], "F": force}


def advice(log):
    told = []
    study = Study(
        data=Data(time="t"),
        coordinates={"v": Measured(), "s": Measured(order=2)},
        inputs={"F": Driven(delay=0.0, hold="zero")},
        library=Candidates(basis=["v", "s", "F"], degree=1, suspect=False),
    )
    with pytest.raises(NoModelError, match="s_ddot"):
        identify(study, log, watch=told.append)
    (ended,) = (event for event in told if isinstance(event, NothingFound))
    return ended.advice


def test_the_law_of_the_others_is_told_with_it_as_input():
    (sentence,) = (text for text in advice(vehicle(np.zeros(1500))) if "[inputs]" in text)
    assert "with s as input the rest has a law (v_dot = " in sentence
    law = sentence.partition("v_dot = ")[2].partition(")")[0]
    found = eval(law, {"F": 1.0, "s": 0.1, "v": 0.01})  # noqa: S307 - printed by the package, in a test
    assert found == pytest.approx(1.0 - 0.2 - 0.008, abs=0.02)


def test_nothing_is_said_where_the_others_have_no_law_then_either():
    wind = 0.5 * np.cumsum(np.random.default_rng(1).standard_normal(1500)) * 0.2
    assert not [text for text in advice(vehicle(wind)) if "[inputs]" in text]
