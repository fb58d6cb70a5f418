"""What the terminal says of a result."""

import pytest

from odescope.model.scores import PathScore
from odescope.report.console import LISTED, _free_runs, _held_out
from odescope.report.data import RunShown


def shown(recording, duration, valid, recorded=None, ended=""):
    return RunShown(recording, "", duration, recorded or duration, valid, ended, ())


@pytest.mark.parametrize(
    ("run", "line"),
    [
        (shown(1, 8.0, 8.0), "free run: 8 of 8 s with the record\n"),
        (shown(1, 22.68, 22.68, 147.0), "free run: 22.68 of the first 22.68 s, of 147 s, with the record\n"),
        (shown(1, 8.0, 0.5, ended="met a pole"), "free run: 0.5 of 8 s with the record; met a pole\n"),
    ],
)
def test_a_free_run_is_told_with_how_much_was_tried(run, line):
    assert list(_free_runs([run], "s")) == [line]


def test_durations_are_told_in_the_unit_of_the_log():
    assert list(_free_runs([shown(1, 7200.0, 5400.0)], "h")) == ["free run: 1.5 of 2 h with the record\n"]


@pytest.mark.parametrize(
    ("error", "told"),
    [(0.5, "0.5 ± 6.3e-06 standard deviations\n"), (1.0, "1, the largest that counts: free runs lose the record\n")],
)
def test_an_error_at_its_bound_is_told_as_none(error, told):
    assert _held_out(PathScore(3, error, 6.3e-6, None, None, True)) == f"free-run error, held out: {told}"


@pytest.mark.parametrize(("recorded", "far"), [(8.0, "to its end"), (80.0, "for all that was tried of it")])
def test_of_many_the_rest_is_counted(recorded, far):
    runs = [shown(k + 1, 8.0, 2.0 if k == 0 else 8.0, recorded) for k in range(LISTED + 2)]
    lines = list(_free_runs(runs, "s"))
    assert len(lines) == LISTED + 1
    assert lines[-1] == f"free runs of all {LISTED + 2} recordings tried: {LISTED + 1} stay with their record {far}\n"
