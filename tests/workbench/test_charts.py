"""Charts as what is handed to the browser."""

import pytest

pytest.importorskip("nicegui")

from odescope.report.data import Point
from odescope.workbench import charts


def test_the_chosen_have_the_colour_of_their_equation_and_no_other(monkeypatch):
    drawn = []
    monkeypatch.setattr(charts, "chart", lambda options, *_: drawn.append(options))
    points = [Point(terms=3, rmse=0.1, chosen=True), Point(terms=5, rmse=0.2, chosen=False)]
    charts.candidates(dict.fromkeys(("a_dot", "b_dot", "c_dot"), points))
    series = {one["name"]: one["itemStyle"] for one in drawn[0]["series"]}
    of_chosen = [series[f"{target}, chosen"]["color"] for target in ("a_dot", "b_dot", "c_dot")]
    assert of_chosen == [series[target]["borderColor"] for target in ("a_dot", "b_dot", "c_dot")]
    assert len(set(of_chosen)) == 3


def test_points_stand_clear_of_the_edges():
    options = charts.spots([charts.Group("one", [(3, 0.1), (7, None), (5, 2.0)], 0, False)], "terms", "error")
    assert (options["xAxis"]["min"], options["xAxis"]["max"]) == (2, 8)
    assert options["series"][0]["data"] == [[3, 0.1], [5, 2.0]]
    charts.spots([], "terms", "error")
