"""Which columns of a log a model means."""

from dataclasses import replace

from built_models import build

from odescope.model.recorded import clocks
from odescope.recordings.coordinate import Coordinate, Input


def test_the_input_that_was_read_from_the_column_of_the_time_is_the_time():
    law = [("x_dot", "1", 1.0), (None, "sin(3.0*now)", -1.0), (None, "u", -1.0)]
    model = build([Coordinate("x")], [Input("now"), Input("u")], law)
    assert clocks(model) == frozenset()
    read = {"time": "t (s)", "columns": {"x": "x", "now": "t (s)", "u": "u"}}
    assert clocks(replace(model, provenance=read)) == {"now"}
