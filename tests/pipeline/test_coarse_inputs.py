"""Inputs with a cell now and then: in lines from cell to cell, or held."""

import numpy as np
import pytest

from odescope import Candidates, Data, Driven, Measured, Study, identify
from odescope.pipeline.coarse_inputs import coarse_inputs
from odescope.recordings.readers import records_from

N, PERIOD, RATE, GAIN = 500, 0.02, 2.0, 3.0
LIBRARY = Candidates(basis=("x", "u"), degree=1, suspect=False)


def log(kind, seed):
    """Return a lag driven by a command that is held over random times, or by a smooth input, with few cells."""
    rng = np.random.default_rng(seed)
    t = PERIOD * np.arange(N)
    if kind == "held":
        first = np.cumsum(rng.integers(5, 40, N // 20))
        first = np.concatenate([[0], first[first < N - 1]])
        u = rng.uniform(-1.0, 1.0, len(first))[np.searchsorted(first, np.arange(N), side="right") - 1]
    else:
        first = np.arange(0, N, 10)
        u = np.sin(1.3 * t + rng.uniform(0, 6)) + 0.5 * np.sin(2.1 * t + rng.uniform(0, 6))
    x, fine = np.zeros(N), 20
    for k in range(N - 1):
        ends = u[k], u[k] if kind == "held" else u[k + 1]
        x[k + 1] = x[k]
        for part in (np.arange(fine) + 0.5) / fine:
            drive = GAIN / RATE * (ends[0] + part * (ends[1] - ends[0]))
            x[k + 1] = drive + (x[k + 1] - drive) * np.exp(-RATE * PERIOD / fine)
    cells = np.full(N, np.nan)
    cells[first] = u[first]
    return {"t": t, "x": x + 0.003 * rng.standard_normal(N), "u": cells}


def study(**u):
    return Study(coordinates={"x": Measured()}, inputs={"u": Driven(**u)}, library=LIBRARY, data=Data(time="t"))


@pytest.mark.parametrize("seed", [0, *(pytest.param(seed, marks=pytest.mark.slow) for seed in range(1, 6))])
@pytest.mark.parametrize(("kind", "hold"), [("held", "zero"), ("smooth", "linear")])
def test_whether_an_input_holds_its_cells_is_found(kind, hold, seed):
    found = identify(study(), log(kind, seed))
    terms = {str(t.term): t for t in found.model.relations[0].terms if t.factor is None}
    assert set(terms) == {"x", "u"}
    assert abs(terms["u"].coefficient + GAIN) < 4.0 * terms["u"].std_error
    assert found.study.inputs["u"].hold == ("zero" if hold == "zero" else "auto")
    assert ("u is held between samples" in " ".join(found.notes)) == (hold == "zero")


@pytest.mark.parametrize(
    ("every", "said", "coarse"), [(10, {}, True), (2, {}, True), (1, {}, False), (10, {"hold": "linear"}, False)]
)
def test_inputs_are_coarse_that_have_far_fewer_cells_than_what_moves(every, said, coarse):
    data = log("smooth", 0)
    data["u"] = np.where(np.arange(N) % every == 0, np.sin(data["t"]), np.nan)
    asked = study(**said)
    assert coarse_inputs(records_from(data, asked.layout()), asked) == (("u",) if coarse else ())


def test_where_all_columns_lack_cells_alike_no_input_is_coarse():
    data = log("smooth", 0)
    data["u"] = np.where(np.arange(N) % 3 == 0, np.sin(data["t"]), np.nan)
    data["x"] = np.where(np.arange(N) % 3 == 1, data["x"], np.nan)
    assert coarse_inputs(records_from(data, study().layout()), study()) == ()
