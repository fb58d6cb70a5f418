"""States of a machine by the equations of a model file: the filter command."""

from __future__ import annotations

import csv
import io
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from odescope.commands.model_data import (
    Sensors,
    TimeCells,
    column_units,
    given_noise,
    label_of,
    named_numbers,
    units_read,
    units_told,
)
from odescope.export.model_file import read_model
from odescope.model.model import Model
from odescope.model.recorded import TimeColumns, read_for, recording_column
from odescope.observer.estimate import StateEstimates, estimate_states
from odescope.observer.noise import FIT, ObserverNoise, ProcessNoise, measurement_noise
from odescope.recordings.record import Records


@dataclass(frozen=True)
class NoiseOptions:
    """NAME=NUMBER of coordinates and of targets as they are given; in place of targets "fit" asks for a fit.

    They are in the units of the columns: of an angle that was recorded in degrees, degrees.
    """

    noise: tuple[str, ...] = ()
    process: tuple[str, ...] = ()

    def measurement(self, model: Model) -> dict[str, float]:
        """Return the noise of coordinates, as far as it is given."""
        return given_noise(model, self.noise)

    def of_targets(self, model: Model) -> ProcessNoise:
        """Return the process noise of targets, None where nothing is given."""
        if self.process == (FIT,):
            return FIT
        if not self.process:
            return None
        given, units = named_numbers("--process-noise", self.process, model.targets, "target"), column_units(model)
        return {target: number * units[target] for target, number in given.items()}


def filtered(
    model_path: Path, data_path: Path, columns: TimeColumns, options: NoiseOptions, smooth: bool
) -> tuple[str, tuple[str, ...]]:
    """Return the states of recordings with standard deviations as CSV text, and what there is to say of them.

    States are as sensors would read them.

    Args:
        model_path: a model file.
        data_path: recordings of its coordinates and inputs.
        columns: where the time is.
        options: noise that is given.
        smooth: whether a state rests on later samples, too.

    Raises:
        InputError: a file cannot be read, columns are missing, or it is not known how noisy the coordinates are.
    """
    model = read_model(model_path)
    noise, process = measurement_noise(model, options.measurement(model)), options.of_targets(model)
    names = [c.name for c in model.coordinates] + [i.name for i in model.inputs]
    columns = replace(columns, recording=recording_column(model, data_path, columns))
    records = read_for(model, [data_path], columns, names)
    found = estimate_states(model, records, noise, process, smooth)
    time_cells = TimeCells.of(model, data_path, columns)
    text = _csv(model, data_path, columns, time_cells, found, records)
    told = replace(_in_columns(found, column_units(model)), units=units_read(model))
    return text, (*told.lines, *units_told(model, time_cells))


def _in_columns(found: StateEstimates, units: Mapping[str, float]) -> StateEstimates:
    """Return estimates whose noise and innovations are in the units of the columns, for what is said of them.

    Args:
        found: in the units of the model.
        units: of the columns, in these.
    """
    measured, left_out = (
        {name: number / units[name] for name, number in noise.items()}
        for noise in (found.noise.measurement, found.noise.process)
    )
    checked = tuple(replace(w, rms=w.rms / units[w.coordinate]) for w in found.consistency.coordinates)
    consistency = replace(found.consistency, coordinates=checked)
    return replace(found, noise=ObserverNoise(measured, left_out), consistency=consistency)


def _csv(
    model: Model, data: Path, columns: TimeColumns, time_cells: TimeCells, found: StateEstimates, records: Records
) -> str:
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    labels = () if columns.recording is None else (columns.recording,)
    readings = [f"{c.name}_innovation{of}" for of in ("", "_std") for c in model.coordinates]
    std = [f"{s}_std" for s in model.states]
    writer.writerow((*labels, time_cells.label, *model.states, *std, *readings, "innovations_squared"))
    sensors = Sensors.of(model)
    unit = sensors.unit[[model.states.index(c.name) for c in model.coordinates]]
    for record, run in zip(records, found.runs, strict=True):
        label = () if columns.recording is None else (label_of(record, [data], columns.recording),)
        states, innovations = (sensors.read(run.states), run.std / sensors.unit), (run.innovations, run.expected)
        table = np.column_stack([*states, *(i / unit for i in innovations), run.squared])
        for t, row in zip(time_cells.written(run.t), table.tolist(), strict=True):
            writer.writerow((*label, t, *("" if v != v else repr(v) for v in row)))
    return out.getvalue()
