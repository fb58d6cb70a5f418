"""A study and the headings of its data."""

import msgspec
import numpy as np
import pandas as pd
import pytest

from odescope.errors import InputError
from odescope.study.columns import converted, doubted_headings, settled_columns, with_labels
from odescope.study.options import Data, Driven, Measured, Study
from odescope.study.toml import parse_study, study_toml

LABELS = ("time (ms)", "x (m)", "Angle [deg]", "u [V]", "run no.")
STUDY = Study(
    data=Data(time="time", recording="run_no"),
    coordinates={"x": Measured(order=2), "phi": Measured(column="Angle", angle=True)},
    inputs={"u": Driven()},
)


def test_labels_and_units_are_taken_over():
    found = with_labels(STUDY, LABELS, "run.csv")
    assert (found.data.time, found.data.time_unit, found.data.recording) == ("time (ms)", "ms", "run no.")
    assert found.coordinates["x"] == Measured(column="x (m)", order=2, unit="m")
    assert found.coordinates["phi"] == Measured(column="Angle [deg]", angle=True, unit="deg")
    assert found.inputs["u"] == Driven(column="u [V]", unit="V")
    assert found.degrees == {"phi"}
    assert found.layout().time_unit == "ms"
    assert with_labels(found, LABELS, "run.csv") == found
    assert parse_study(study_toml(found)) == found


@pytest.mark.parametrize(
    ("x", "u", "time", "said"),
    [
        ("m", "V", "ms", []),
        (None, None, None, []),
        ("M", "volts/2", "ms", []),
        ("mm", "V", "ms", ["'x (m)' says m, and the study mm"]),
        ("m", "mV", "s", ["'time (ms)' says ms, and the study s", "'u [V]' says V, and the study mV"]),
    ],
)
def test_a_study_that_contradicts_a_heading_is_pointed_out(x, u, time, said):
    study = Study(
        data=Data(time="time", time_unit=time),
        coordinates={"x": Measured(order=2, unit=x), "phi": Measured(column="Angle", angle=True, unit="°")},
        inputs={"u": Driven(unit=u)},
    )
    found = doubted_headings(with_labels(study, LABELS, "run.csv"))
    assert len(found) == len(said)
    assert all(part in sentence for part, sentence in zip(said, found, strict=True))


@pytest.mark.parametrize("label", ["time_hours", "time (ticks)", "time (m/s)", "time (ft)"])
def test_a_unit_of_time_that_nobody_knows_is_pointed_out_until_the_study_says_which(label):
    labels = (label, "x")
    study = Study(data=Data(time=label), coordinates={"x": Measured()})
    (found,) = doubted_headings(with_labels(study, labels, "run.csv"))
    assert found.startswith(f"the heading {label!r} says {label[5:].strip('()')}, which is taken for no unit of time")
    meant = 'as "h" if it means that, or "s" (or head the column time (h))' if "hours" in label else "one of s, ms, us"
    assert f"time_unit in [data], or --time-unit, {meant}" in found
    for unit in ("s", "h"):
        own = Study(data=Data(time=label, time_unit=unit), coordinates={"x": Measured()})
        assert doubted_headings(with_labels(own, labels, "run.csv")) == ()


def test_either_spelling_of_a_column_is_the_same():
    spelled = Study(
        data=Data(time="time (ms)", recording="run no."),
        coordinates={"x": Measured(order=2, column="x (m)"), "phi": Measured(column="Angle [deg]", angle=True)},
        inputs={"u": Driven(column="u [V]")},
    )
    assert with_labels(spelled, LABELS, "run.csv") == with_labels(STUDY, LABELS, "run.csv")


def test_what_a_study_says_of_units_stays():
    own = Study(
        data=Data(time="time", time_unit="s"),
        coordinates={"x": Measured(unit="mm"), "phi": Measured(column="Angle", angle=True, unit="rad")},
    )
    found = with_labels(own, LABELS, "run.csv")
    assert (found.data.time_unit, found.coordinates["x"].unit, found.degrees) == ("s", "mm", frozenset())


def test_what_the_data_lack_stays_as_the_study_says():
    """Reading the data tells what is missing, and what there is."""
    assert with_labels(STUDY, ("a", "b"), "run.csv") == STUDY


def test_columns_that_are_meant_twice_are_refused():
    with pytest.raises(InputError, match=r"'x' may be 'x \(m\)' or 'x \(mm\)' in run.csv"):
        with_labels(STUDY, (*LABELS, "x (mm)"), "run.csv")
    twice = Study(data=Data(time="time"), coordinates={"x": Measured(), "y": Measured(column="x (m)")})
    with pytest.raises(InputError, match=r"'x' and 'y' both read the column 'x \(m\)' in run.csv: leave one out"):
        with_labels(twice, LABELS, "run.csv")


def test_labels_come_from_the_first_file_or_table(tmp_path):
    frame = pd.DataFrame({label: np.arange(3.0) for label in LABELS})
    path = tmp_path / "run.csv"
    frame.to_csv(path, index=False)
    of_files = Study(data=Data(time="time", files=(str(path),)), coordinates=STUDY.coordinates)
    assert settled_columns(of_files, None)[0].data.time == "time (ms)"
    for data in (frame, [frame, frame], {label: [0.0] for label in LABELS}):
        assert settled_columns(STUDY, data)[0] == with_labels(STUDY, LABELS, "the data")


@pytest.mark.parametrize(
    "label",
    ["time (UTC)", "time [GMT+2]", "time (CEST)", "Date (yyyy-mm-dd HH:MM:SS)", "time (hh:mm:ss)", "time (local)"],
)
def test_the_zone_or_the_form_of_dates_is_no_unit_of_time(label):
    study = Study(data=Data(time=label), coordinates={"x": Measured()})
    assert doubted_headings(with_labels(study, (label, "x"), "run.csv")) == ()


def test_what_stays_in_degrees_beside_a_converted_angle_is_told():
    heading = {"heading_deg": Measured(angle=True)}
    inputs = {
        "rudder_deg": Driven(),
        "wind": Driven(unit="deg"),
        "speed": Driven(unit="m/s"),
        "tilt_deg": Driven(unit="1"),
    }
    study = Study(data=Data(time="t"), coordinates=heading | {"trim_deg": Measured()}, inputs=inputs)
    settled = with_labels(study, ("t", "heading_deg", "trim_deg", *inputs), "run.csv")
    first, second = converted(settled)
    assert first == "heading_deg was recorded in degrees: here it is in radians"
    assert second == ("trim_deg, rudder_deg, wind stay in degrees: only coordinates that are angles are converted")
    plain = msgspec.structs.replace(study, coordinates={"heading_deg": Measured()})
    assert converted(with_labels(plain, ("t", "heading_deg", *inputs), "run.csv")) == []
