"""Records of ten million rows give light reports."""

from dataclasses import replace

import numpy as np
import pytest
from pages import identified

from odescope.pipeline.identification import identify
from odescope.recordings.record import Record, Records
from odescope.report import summary, to_html, to_json_text
from odescope.study.options import Data, Driven, Measured, Study

ROWS = 10_000_000
LIGHT = 5_000_000  # bytes


@pytest.mark.slow
def test_ten_million_rows_behind_the_same_signals():
    result = identified()[0]
    short = result.records.runs[0]
    t = np.linspace(short.t[0], short.t[-1], ROWS)
    rng = np.random.default_rng(0)
    values = np.column_stack([np.interp(t, short.t, c) for c in short.values.T])
    values += 0.01 * rng.standard_normal((ROWS, 1))
    values[1_234_567] += 30.0
    records = Records((Record(t, values, short.names, short.units),))
    report = summary(replace(result, records=records, gated={}))
    assert len(to_json_text(report)) < LIGHT
    assert len(to_html(report)) < LIGHT / 2
    line = report.observed.recorded.chart.panels[0].wide[0]
    assert max(v for v in line.y if v is not None) > 29.0  # the spike is still there


@pytest.mark.slow
def test_ten_million_rows_from_end_to_end():
    t = 0.001 * np.arange(ROWS)
    u, x = np.zeros(ROWS), np.zeros(ROWS)
    for size, frequency, phase in ((2.0, 1.3, 0.0), (1.5, 2.9, 1.0), (1.0, 0.7, 2.0), (1.0, 4.1, 0.5)):
        gain = 1.0 / (4.0 - frequency**2 + 0.3j * frequency)  # x'' + 0.3 x' + 4 x = u
        u += size * np.sin(frequency * t + phase)
        x += size * (gain * np.exp(1j * (frequency * t + phase))).imag
    x += 1e-3 * np.random.default_rng(0).standard_normal(ROWS)
    study = Study(data=Data(time="t"), coordinates={"x": Measured(order=2)}, inputs={"u": Driven()})
    result = identify(study, {"t": t, "x": x, "u": u})
    report = summary(result)
    assert len(to_html(report)) < LIGHT
    found = {term.text: term.coefficient for term in result.model.relations[0].terms}
    assert {"x_ddot", "x", "u"} <= set(found)
