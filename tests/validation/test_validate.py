"""Models judged on simulated data: the true one, one that is wrong, one that is not told its noise."""

from dataclasses import asdict, replace

import numpy as np
import pandas
import pytest
from built_models import build

from odescope.errors import InputError
from odescope.model.simulation import simulate
from odescope.recordings.coordinate import Coordinate, Input
from odescope.recordings.record import Record
from odescope.validation.validate import ALL, validate

PERIOD, NOISE = 0.02, 0.01


def oscillator(stiffness, offset=0.0):
    model = build(
        [Coordinate("x", order=2, unit="m", offset=offset)],
        [Input("u")],
        [("x_ddot", "1", 1.0), (None, "x", stiffness), (None, "x_dot", 0.3), (None, "u", -1.0)],
    )
    domain = {"x": (-1.5, 1.5), "x_dot": (-2.5, 2.5), "u": (-1.0, 1.0)}
    return replace(model, domain=domain, provenance={"channels": {"x": {"noise": NOISE}}})


TRUE, WRONG = oscillator(4.0), oscillator(4.6)


def record(seed, samples, size=1.0, offset=0.0):
    rng = np.random.default_rng(seed)
    t = PERIOD * np.arange(samples)
    u = size * np.sin(1.3 * t + seed)
    x = simulate(TRUE, t, u[:, None], np.array([1.0, 0.5])).states[:, 0] + NOISE * rng.standard_normal(samples)
    return Record(t, np.column_stack([x + offset, u]), ("x", "u"), source=f"run {seed}")


def of(found, **wanted):
    (row,) = [r for r in found.rows if all(getattr(r, k) == v for k, v in wanted.items())]
    return row


def test_the_true_model_predicts_to_within_the_noise_and_a_wrong_one_does_not():
    records = [record(0, 1000), record(1, 600)]
    found = validate({"true": TRUE, "wrong": WRONG}, records)
    spread = np.sqrt(np.mean(np.concatenate([r.column("x") - r.column("x").mean() for r in records]) ** 2))
    for prediction in ("free run", "many starts", "one step"):
        true, wrong = (of(found, model=m, recording=ALL, prediction=prediction) for m in ("true", "wrong"))
        assert true.rmse == pytest.approx(NOISE, rel=0.1)
        # One-step predictions do not count until the observer knows the state: what is left varies otherwise.
        slack = 0.2 if prediction == "one step" else 1e-9
        assert true.fit == pytest.approx(100.0 * (1.0 - true.rmse / spread), abs=slack)
        assert true.unit == "m"
        assert wrong.rmse > 1.1 * true.rmse
    free = of(found, model="true", recording="run 0", prediction="free run")
    assert free.valid_time == free.duration == pytest.approx(999 * PERIOD)
    assert of(found, model="wrong", recording="run 0", prediction="free run").valid_time < 15.0
    # A run that begins anew every few seconds cannot go as far astray.
    many, once = (of(found, model="wrong", recording=ALL, prediction=p).rmse for p in ("many starts", "free run"))
    assert many < 0.7 * once
    assert found.notes == ()


def test_rows_are_those_of_a_dataframe_and_the_table_fits_a_screen():
    found = validate(TRUE, record(0, 400))
    frame = pandas.DataFrame(found.rows)
    assert list(frame.columns) == list(asdict(found.rows[0]))
    assert list(frame["prediction"]) == ["free run", "many starts", "one step"]
    lines = repr(found).splitlines()
    assert len(lines) == 4
    assert max(map(len, lines)) < 100


def test_an_offset_of_the_model_is_part_of_its_predictions():
    found = validate(oscillator(4.0, offset=0.7), record(0, 600, offset=0.7))
    assert all(row.rmse == pytest.approx(NOISE, rel=0.15) for row in found.rows)


def test_data_beyond_the_domain_are_told():
    (of_input, *_) = notes = validate(TRUE, record(0, 800, size=3.0)).notes
    assert any(note.startswith("model: u is from -3 to 3") for note in notes)
    assert "outside" in of_input
    assert any("x_dot" in note for note in notes)


def test_a_model_that_is_not_told_its_noise_has_no_one_step_predictions():
    blank = replace(TRUE, provenance={})
    found = validate(blank, record(0, 400))
    assert {row.prediction for row in found.rows} == {"free run", "many starts"}
    assert any("no one-step predictions" in note and "--noise x=" in note for note in found.notes)
    told = validate(blank, record(0, 400), {"x": NOISE})
    assert of(told, prediction="one step").rmse == pytest.approx(NOISE, rel=0.15)
    with pytest.raises(InputError, match="no coordinate"):
        validate(blank, record(0, 400), {"y": NOISE})


def test_a_run_that_ends_early_has_no_fit():
    bursting = build([Coordinate("x")], [], [("x_dot", "1", 1.0), (None, "x**2", -1.0)])
    t = 0.01 * np.arange(400)
    found = validate(bursting, Record(t, np.cos(0.3 * t)[:, None], ("x",)))
    free = of(found, prediction="free run")
    assert (free.fit, free.rmse) == (None, None)
    assert free.valid_time < 1.5
    assert any("ended early" in note for note in found.notes)


def test_no_model_is_refused():
    with pytest.raises(InputError, match="no model"):
        validate({}, record(0, 100))


def with_outliers(run, rows):
    values = run.values.copy()
    values[rows, 0] += 0.8
    return replace(run, values=values)


def test_outliers_of_a_new_log_do_not_count_and_are_told():
    runs = [record(0, 1000), record(1, 600)]
    plain = validate({"true": TRUE, "wrong": WRONG}, runs)
    found = validate({"true": TRUE, "wrong": WRONG}, [with_outliers(runs[0], [3, 200, 201, 640]), runs[1]])
    for prediction in ("free run", "many starts", "one step"):
        clean, gated = (of(v, model="true", recording=ALL, prediction=prediction) for v in (plain, found))
        assert gated.rmse == pytest.approx(clean.rmse, rel=0.1)
    free = of(found, model="true", recording="run 0", prediction="free run")
    assert free.valid_time == free.duration
    (told,) = [note for note in found.notes if "do not count" in note]
    assert told.startswith("4 samples of x do not count: 4 are outliers")
    assert plain.notes == ()


def test_a_model_that_was_identified_with_all_samples_is_judged_on_all():
    kept = replace(TRUE, provenance={**TRUE.provenance, "outliers": "keep"})
    found = validate(kept, with_outliers(record(0, 1000), [200]))
    assert found.notes == ()
    assert of(found, prediction="free run").rmse > 2.0 * NOISE


def test_of_a_log_of_few_samples_all_count():
    run = record(2, 200)
    assert validate(TRUE, with_outliers(run, [100])).notes == ()


def test_records_of_which_half_are_far_off_count_as_they_are():
    rng = np.random.default_rng(5)
    t = PERIOD * np.arange(400)
    saturated = Record(
        t, np.column_stack([np.clip(3.0 * np.sin(2.0 * t), -1.0, 1.0), rng.standard_normal(400)]), ("x", "u")
    )
    assert any(note.startswith("all samples count: ") for note in validate(TRUE, saturated).notes)


def test_stretches_without_a_sample_of_a_coordinate_have_no_part():
    whole = record(0, 2000)
    counts = np.ones(whole.values.shape)
    counts[300:700, 0] = 0.0  # a sensor that said nothing for longer than a piece lasts
    found = validate({"true": TRUE}, [replace(whole, counts=counts)])
    many = of(found, recording=ALL, prediction="many starts")
    assert many.rmse == pytest.approx(NOISE, rel=0.1)
    assert many.valid_time == pytest.approx(many.duration)


def test_a_recording_without_a_sample_of_a_coordinate_has_no_row_of_it():
    first, second = record(0, 600), record(1, 600)
    lost = replace(second, counts=np.column_stack([np.zeros(600), np.ones(600)]))
    found = validate({"true": TRUE}, [first, lost])
    assert {r.recording for r in found.rows if r.prediction == "free run"} == {"run 0", ALL}
    assert of(found, recording=ALL, prediction="free run").rmse == pytest.approx(NOISE, rel=0.1)
