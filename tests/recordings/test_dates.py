"""Times as dates: written so that they are read back as they were."""

import datetime
from dataclasses import replace

import numpy as np
import pyarrow as pa
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from odescope.errors import InputError
from odescope.recordings.columns import from_arrays
from odescope.recordings.dates import from_text, to_text
from odescope.recordings.layout import Layout
from odescope.recordings.readers import read_records, records_from


@settings(deadline=None)
@given(
    begin=st.integers(0, 2_000_000_000),
    steps=st.lists(st.integers(0, 10**9), max_size=8),
    scale=st.sampled_from([1, 1000, 10**6]),
    zoned=st.booleans(),
)
def test_dates_are_read_back_to_the_microsecond(begin, steps, scale, zoned):
    ticks = 10**6 * begin + scale * np.array([0, *steps], dtype=np.int64)
    written = to_text(1e-6 * ticks, zoned)
    column = from_text(from_arrays({"t": np.array(written, dtype=str)}, "the test")["t"], "t", "the test")
    assert (np.array(column.cast("int64").to_pylist()) // 1000).tolist() == ticks.tolist()


@pytest.mark.parametrize(
    ("seconds", "zoned", "texts"),
    [
        ([1706745599.5, 1706745600.0], False, ["2024-01-31 23:59:59.5", "2024-02-01 00:00:00.0"]),
        ([1706745599.0], True, ["2024-01-31 23:59:59Z"]),
        ([43200.0, 43200.125], False, ["12:00:00.000", "12:00:00.125"]),
        ([86399.0, 86400.0], False, ["1970-01-01 23:59:59", "1970-01-02 00:00:00"]),
        ([], False, []),
    ],
)
def test_as_many_decimals_as_it_takes_and_clocks_without_a_day(seconds, zoned, texts):
    assert to_text(np.array(seconds), zoned) == texts


CLOCK = [f"{k // 3600 % 24:02}:{k // 60 % 60:02}:{k % 60:02}.5" for k in range(23 * 3600 + 3550, 23 * 3600 + 3650)]
APART = Layout(time="time", date="Day", columns=(("x", "x"),))


def days(form):
    return [form.format(31, 1) if clock.startswith("23") else form.format(1, 2) for clock in CLOCK]


@pytest.mark.parametrize("form", ["2024-{1:02}-{0:02}", "{:02}.{:02}.2024", "2024/{1:02}/{0:02}"])
def test_a_clock_goes_over_midnight_with_the_day_beside_it(tmp_path, form):
    rows = [f"{day},{clock},{k}" for k, (day, clock) in enumerate(zip(days(form), CLOCK, strict=True))]
    (tmp_path / "apart.csv").write_text("\n".join(["Day,time,x", *rows]) + "\n")
    (run,) = read_records([tmp_path / "apart.csv"], APART)
    assert run.t == pytest.approx(1706745550.5 + np.arange(100), abs=1e-6)
    with pytest.raises(InputError, match="time goes back"):
        read_records([tmp_path / "apart.csv"], replace(APART, date=None))
    (tmp_path / "bad.csv").write_text("\n".join(["Day,time,x", *rows[:50], "soon,23:59:59,3"]) + "\n")
    with pytest.raises(InputError, match=r"'Day' in bad\.csv holds text that is no time, such as"):
        read_records([tmp_path / "bad.csv"], APART)


def test_days_of_a_table_stand_beside_a_clock_and_beside_nothing_else():
    day = pa.array([datetime.date.fromisoformat(text) for text in days("2024-{1:02}-{0:02}")])
    table = pa.table({"Day": day, "time": CLOCK, "x": np.arange(100.0)})
    (run,) = records_from(table, APART)
    assert run.t == pytest.approx(1706745550.5 + np.arange(100), abs=1e-6)
    with pytest.raises(InputError, match="'Day' holds the day of a clock, and 'x' in the data holds no clock"):
        records_from(table, replace(APART, time="x"))


STEPS = 20 * np.arange(40)  # milliseconds
NOW = 1_700_000_000_123_456_789
CELLS = {
    "epoch nanoseconds": (pa.array(NOW + STEPS * 1_000_000), "ns", 1e-9 * NOW),
    "durations": (pa.array(STEPS, pa.duration("ms")), "s", 0.0),
    "durations of a unit that their heading says otherwise": (pa.array(STEPS * 1000, pa.duration("us")), "ms", 0.0),
    "clocks": (pa.array((43_200_000 + STEPS).astype(np.int32)).cast(pa.time32("ms")), "s", 43200.0),
    "fine clocks": (pa.array(1_000_000 * STEPS).cast(pa.time64("ns")), "s", 0.0),
    "dates in views of text": (
        pa.array([f"2023-11-14 22:13:20.{k:03}" for k in STEPS.tolist()], pa.string_view()), "s", 1.7e9,
    ),
}  # fmt: skip


@pytest.mark.parametrize("kind", CELLS)
def test_times_of_every_kind_of_arrow_are_in_seconds(kind):
    cells, unit, begin = CELLS[kind]
    layout = Layout(time="t", time_unit=unit, columns=(("x", "x"),))
    (run,) = records_from(pa.table({"t": cells, "x": np.sin(1e-3 * STEPS)}), layout)
    np.testing.assert_allclose(run.t - begin, 1e-3 * STEPS, atol=1e-6)


def test_days_and_timedeltas_of_numpy_are_times():
    days = np.datetime64("2024-02-20") + np.arange(20)
    (run,) = records_from({"t": days, "x": np.arange(20.0)}, Layout(time="t", columns=(("x", "x"),)))
    np.testing.assert_allclose(np.diff(run.t), 86400.0)
    passed = STEPS.astype("timedelta64[ms]")
    (run,) = records_from({"t": passed, "x": STEPS}, Layout(time="t", columns=(("x", "x"),)))
    np.testing.assert_allclose(run.t, 1e-3 * STEPS, atol=1e-12)


def test_labels_of_recordings_may_be_views_of_text():
    table = pa.table({"t": STEPS, "x": np.sin(STEPS), "run": pa.array(["a"] * 20 + ["b"] * 20, pa.string_view())})
    found = records_from(table, Layout(time="t", columns=(("x", "x"),), recording="run"))
    assert [len(run) for run in found] == [20, 20]


@pytest.mark.parametrize("cells", [[f"12:00:{k:02}" for k in range(40)], np.arange(40).astype("timedelta64[s]")])
def test_dates_are_no_variable(cells):
    table = {"time": np.array(cells), "x": np.arange(40.0)}
    with pytest.raises(InputError, match=r"'t' is the time as a variable, .* add a column with the seconds"):
        records_from(table, Layout(time="time", columns=(("x", "x"), ("t", "time"))))


@pytest.mark.parametrize("jitter", [0.0, 0.2])
def test_a_record_knows_whether_its_times_are_dates(jitter):
    rng = np.random.default_rng(0)
    t = 1.7e9 + np.arange(100) + jitter * rng.uniform(-1.0, 1.0, 100)
    dates = np.array(np.rint(1e3 * t), dtype=np.int64).astype("datetime64[ms]")
    layout = Layout(time="time", columns=(("x", "x"),))
    for times, dated in ((t, False), (dates, True), (to_text(t, False), True)):
        (run,) = records_from({"time": np.asarray(times), "x": np.sin(0.1 * t)}, layout)
        assert (run.dated, run.part(0, 10).dated) == (dated, dated)
