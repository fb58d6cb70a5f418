"""What is read out of a result for trying its model."""

import msgspec
import pytest

pytest.importorskip("nicegui")

from workbench_cases import heater

from odescope.export.model_file import write_model
from odescope.model.scores import FreeRun, ModelScores
from odescope.report.data import (
    AtWork,
    Chart,
    Line,
    Observed,
    Panel,
    Recorded,
    Report,
    Reproduce,
    Thumbnail,
    Thumbnails,
)
from odescope.report.data import Run as RecordedRun
from odescope.workbench.folder import Folder
from odescope.workbench.results import DURATION, Result, duration_of, result_of, start_of


def report(*first):
    """A report that shows a recording of 33 s whose coordinates begin with some values."""
    empty = Chart(time="time (s)", beside="", panels=())
    lines = [Line(label="measured", role="recorded", x=(0.0, 1.0, 2.0), y=(None, y, 9.0)) for y in first]
    panels = tuple(Panel(label="", wide=(Line(label="run", role="model", x=(0.0,), y=(7.0,)), one)) for one in lines)
    runs = Thumbnails(runs=(Thumbnail(title="", panels=panels, mark=None),))
    recorded = Recorded(
        files=(), runs=tuple(RecordedRun(source="", samples=1, duration=s, gap=None) for s in (12.0, 33.0)),
        recordings=2, samples=2, duration=45.0, period=1.0, kept_period=1.0, kept=2,
        coordinates=(), inputs=(), chart=empty,
    )  # fmt: skip
    return Report(
        format="odescope/report", version=1, title="", model=msgspec.Raw(b"{}"), coefficients=(), notes=(),
        observed=Observed(recorded=recorded, spectra=(), derivatives=empty), searches=(),
        at_work=AtWork(free_runs=runs, runs=(), targets=empty, fits=(), held_out=False), table=(),
        reproduce=Reproduce(study="", files=(), seed=0, versions=(), stages=()),
    )  # fmt: skip


def result(place, model, of_report=None):
    return Result("r", place, model, of_report, {})


def test_the_duration_is_that_of_the_record_as_far_as_it_is_known(tmp_path):
    (tmp_path / "r").mkdir()
    write_model(heater(), tmp_path / "r" / "model.json")
    bare = result_of(Folder.of(tmp_path), "r")
    assert duration_of(bare) == DURATION
    assert duration_of(result(tmp_path, heater(), report(1.0))) == 33.0
    scores = ModelScores(free_runs=(FreeRun(7.0, 7.0), FreeRun(20.0, 3.0, recorded=5000.0)))  # of a log that is long
    assert duration_of(result(tmp_path, heater(scores=scores), report(1.0))) == 20.0


@pytest.mark.parametrize(
    ("shown", "start"),
    [
        ((296.5, 0.25), {"T": 296.0, "x": 0.25, "x_dot": 0.0}),  # less an offset of 0.5
        ((), {"T": 297.5, "x": 0.5, "x_dot": 0.0}),
        ((301.25, 0.25), {"T": 300.75, "x": 0.25, "x_dot": 0.0}),  # noise goes beyond the smooth range
        ((400.0, 0.25), {"T": 297.5, "x": 0.25, "x_dot": 0.0}),
    ],
)
def test_a_start_is_what_was_measured_first_else_the_middle_of_the_data_and_rest(tmp_path, shown, start):
    assert start_of(result(tmp_path, heater(), report(*shown) if shown else None)) == start
