"""Which columns of a log a model means."""

from dataclasses import replace

import numpy as np
import pytest
from built_models import build

from odescope.errors import InputError
from odescope.model.recorded import clocks, records_for
from odescope.recordings.coordinate import Coordinate, Input
from odescope.recordings.headings import Heading


def test_the_input_that_was_read_from_the_column_of_the_time_is_the_time():
    law = [("x_dot", "1", 1.0), (None, "sin(3.0*now)", -1.0), (None, "u", -1.0)]
    model = build([Coordinate("x")], [Input("now"), Input("u")], law)
    assert clocks(model) == frozenset()
    read = {"time": "t (s)", "columns": {"x": "x", "now": "t (s)", "u": "u"}}
    assert clocks(replace(model, provenance=read)) == {"now"}


@pytest.mark.parametrize(
    ("identified", "in_degrees", "label", "reads"),
    [
        ("phi [deg]", False, "phi [deg]", "rad"),  # the study overruled the heading
        ("phi [rad]", True, "phi [rad]", "deg"),
        ("phi", True, "phi", "deg"),
        ("phi", True, "phi [rad]", "rad"),
        ("phi [rad]", True, "phi", "deg"),
        ("phi", False, "phi [deg]", "deg"),
        ("phi [deg]", True, "phi [degrees]", "deg"),
    ],
)
def test_an_angle_is_read_as_its_model_was_identified_from_it_and_another_column_as_it_is_headed(
    identified, in_degrees, label, reads
):
    pendulum = [("phi_ddot", "1", 1.0), (None, "sin(phi)", 9.0)]
    made_from = {"columns": {"phi": identified}} | ({"degrees": ["phi"]} if in_degrees else {})
    model = replace(build([Coordinate("phi", 2, angle=True)], [], pendulum), provenance=made_from)
    t = np.arange(20) / 10
    read = records_for(model, {"t": t, label: 0.5 * np.cos(t)}).runs[0].column("phi")
    np.testing.assert_allclose(read, 0.5 * np.cos(t) * (np.pi / 180.0 if reads == "deg" else 1.0))


def test_a_column_in_another_unit_than_the_model_is_refused_but_where_the_model_was_identified_from_it():
    model = build([Coordinate("x", unit="m")], [], [("x_dot", "1", 1.0), (None, "x", 2.0)])
    t = np.arange(20) / 10
    log = {"t": t, "x (mm)": np.exp(-2.0 * t)}
    with pytest.raises(InputError, match=r"x of the model is in m, and the heading 'x \(mm\)' says mm: convert"):
        records_for(model, log)
    read = replace(model, provenance={"columns": {"x": "x (mm)"}})  # the study said m, whatever the heading says
    np.testing.assert_array_equal(records_for(read, log).runs[0].column("x"), log["x (mm)"])
    assert records_for(model, {"time (sec)": t, "x (meters)": np.exp(-2.0 * t)}).runs[0].column("x")[0] == 1.0
    assert records_for(model, {"t": t, "x (m)": np.exp(-2.0 * t)}).runs[0].column("x")[0] == 1.0


@pytest.mark.parametrize(
    ("column", "says"),
    [("torque [V]", "torque of the model is in N m, .* says V"), ("phi (m)", "phi of the model is in rad, .* says m")],
)
def test_a_column_of_another_quantity_is_refused(column, says):
    law = [("phi_ddot", "1", 1.0), (None, "sin(phi)", 9.0), (None, "torque", -1.0)]
    model = build([Coordinate("phi", 2, angle=True)], [Input("torque", unit="N m")], law)
    t = np.arange(20) / 10
    log = {"t": t, "phi": np.cos(t), "torque": np.sin(t)}
    assert records_for(model, log).names == ("phi", "torque")
    log = {"t": t, "phi (deg)": np.cos(t), "torque (Nm)": np.sin(t)}
    assert records_for(model, log).names == ("phi", "torque")
    name = Heading.of(column).name
    with pytest.raises(InputError, match=says):
        records_for(
            model, {column: np.sin(t), **{n: log.get(n, np.cos(t)) for n in ("t", "phi", "torque") if n != name}}
        )
