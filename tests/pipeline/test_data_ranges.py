"""The ranges of the data that a model tells are those of what was recorded."""

from __future__ import annotations

import numpy as np
import pyarrow as pa
import pytest
from pyarrow import parquet
from reduce_cases import REGRESSED, ROWS, study_of

from odescope.pipeline.identification import identify
from odescope.study.options import Data, Driven, Measured, Study


@pytest.fixture(scope="module")
def batches():
    """Return three batches of x' = -x + u under an input held in steps, the last from far above."""
    rng, period = np.random.default_rng(8), 0.02
    t, found = period * np.arange(500), []
    for start in (0.4, 0.9, 1.5):
        u = np.repeat(rng.choice([0.29, 0.55, 0.98], 10), 50)
        x = np.empty(len(t))
        x[0] = start
        for k in range(len(t) - 1):
            x[k + 1] = u[k] + (x[k] - u[k]) * np.exp(-period)
        found.append({"t": t, "x": x + 0.002 * rng.standard_normal(len(t)), "u": u})
    return found


def study(**options):
    given = {"coordinates": {"x": Measured()}, "inputs": {"u": Driven()}, "likelihood": REGRESSED}
    return Study(data=Data(time="t"), **{**given, **options})


def test_a_batch_that_begins_far_away_and_an_input_in_steps_are_told_as_they_were(batches):
    domain = identify(study(inputs={"u": Driven(hold="zero")}), batches).model.domain
    assert domain["x"] == (min(b["x"].min() for b in batches), max(b["x"].max() for b in batches))
    assert domain["u"] == (0.29, 0.98)


def test_outliers_and_what_was_not_measured_are_no_data(batches):
    struck = [{name: column.copy() for name, column in b.items()} for b in batches]
    struck[0]["x"][200], struck[1]["x"][300] = 9.0, -9.0
    struck[2]["x"][:4] = np.nan
    domain = identify(study(), struck).model.domain
    usual = np.concatenate([b["x"] for b in struck])
    usual = usual[np.isfinite(usual) & (np.abs(usual) < 5.0)]
    assert domain["x"] == (usual.min(), usual.max())


@pytest.mark.slow
def test_a_log_in_chunks_tells_inputs_as_recorded_and_no_outlier(tmp_path, lengthy):
    struck, step = lengthy["x"].copy(), lengthy["u"].copy()
    top = int(struck.argmax())
    struck[top] += 0.2  # twenty standard deviations of the noise
    step[70_007] = 1.5 * step.max()
    parquet.write_table(pa.table({**lengthy, "x": struck, "u": step}), tmp_path / "log.parquet")
    result = identify(study_of(tmp_path / "log.parquet"))
    assert result.records.samples < 0.6 * ROWS
    # Coordinates of chunks are told as filtered: within the noise of what was measured.
    assert result.model.domain["x"] == pytest.approx((struck.min(), np.delete(struck, top).max()), abs=0.05)
    assert result.model.domain["u"] == (step.min(), step.max())
