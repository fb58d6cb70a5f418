"""States of a machine from a log of some of them: the model's own equations as an observer."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

from odescope.errors import InputError, check_kind, said
from odescope.model.gate import counting_for
from odescope.model.model import Model
from odescope.model.quantity_units import quantity_units, shown
from odescope.model.recorded import records_for
from odescope.observer.coefficient_errors import noise_of_coefficients
from odescope.observer.consistency import Consistency, consistency
from odescope.observer.noise import (
    FIT,
    ObserverNoise,
    ProcessNoise,
    measurement_noise,
    needs_process_noise,
    process_noise,
)
from odescope.observer.process_noise_fit import fit_process_noise
from odescope.observer.run import ReadyRecord, StateEstimate, run_filter
from odescope.recordings.record import Recorded


@dataclass(frozen=True, eq=False)
class StateEstimates:
    """The states of all recordings, the noise that was assumed, and whether the innovations bear it out.

    `notes` say which samples did not count, `units` are those of coordinates and targets, as far as they are known.
    """

    runs: tuple[StateEstimate, ...]
    noise: ObserverNoise
    consistency: Consistency
    smoothed: bool
    notes: tuple[str, ...] = ()
    units: Mapping[str, str] = field(default_factory=dict)

    @property
    def lines(self) -> list[str]:
        """What there is to say, line by line."""
        process = {name: value for name, value in self.noise.process.items() if value}
        return [
            f"measurement noise: {self._listed(self.noise.measurement)}",
            f"process noise, times the root of a second: {self._listed(process) or 'none'}",
            *self.consistency.lines,
            *self.notes,
            *(f"{run.source or 'the record'}: {run.ended}" for run in self.runs if run.ended),
        ]

    def _listed(self, noise: Mapping[str, float]) -> str:
        return ", ".join(f"{name} {value:.3g} {self.units.get(name, '')}".rstrip() for name, value in noise.items())

    def __repr__(self) -> str:
        what, samples = "smoothed" if self.smoothed else "filtered", sum(len(run.t) for run in self.runs)
        recordings = "1 recording" if len(self.runs) == 1 else f"{len(self.runs)} recordings"
        head = f"{what} states {', '.join(self.runs[0].names)} of {recordings}, {samples} samples"
        return "\n".join([head, *self.lines])


def estimate_states(
    model: Model,
    data: Recorded,
    noise: Mapping[str, float] | None = None,
    process: ProcessNoise = None,
    smooth: bool = False,
) -> StateEstimates:
    """Return the states behind recordings, with standard deviations: extended Kalman filter, or smoother.

    Samples may be irregular; one that was not measured (`Record.counts` is 0) updates nothing, and of regular ones none
    that is an outlier, read late or saturated, as when the model was identified: `notes` say which. States are the
    coordinates themselves, without what their sensors read more (the model's offsets).

    Args:
        model: whose equations are integrated.
        data: with the coordinates and the inputs of the model: records, tables or paths of files, see `validate`.
        noise: standard deviation of a sample, by coordinate; by default as the model was identified.
        process: standard deviation of what the equations leave out, by target, times the root of a second; "fit" for
            what makes the innovations most likely. By default what stands for the standard errors of the coefficients
            where the model follows its own record, else "fit", and no less than that.
        smooth: whether a state rests on later readings, too.

    Raises:
        InputError: a column is missing, a name is none of the model's, or the noise of a coordinate is not known.
    """
    check_kind(model, Model, "the observer's model")
    if not (process is None or process == FIT or isinstance(process, Mapping)):
        raise InputError(f"process must be {FIT!r}, standard deviations by target, or None; {said(process)} came")
    measurement = measurement_noise(model, noise)
    given = process_noise(model, process if isinstance(process, Mapping) else {})
    counting, notes = counting_for(model, records_for(model, data))
    recordings = [ReadyRecord.of(model, record) for record in counting]
    if not isinstance(process, Mapping):
        fitted = process == FIT or needs_process_noise(model)
        given = fit_process_noise(recordings, measurement) if fitted else given
        errors = noise_of_coefficients(recordings)
        given = {target: max(given[target], errors[target]) for target in model.targets}
    units = {name: shown(unit) for name, unit in quantity_units(model).items()}
    return replace(observed(recordings, ObserverNoise(measurement, given), smooth), notes=notes, units=units)


def observed(recordings: Sequence[ReadyRecord], noise: ObserverNoise, smooth: bool = False) -> StateEstimates:
    """Return the states of recordings that are prepared, and how consistent they are.

    Args:
        recordings: of one model.
        noise: of sensors and equations.
        smooth: whether a state rests on later readings, too.
    """
    runs = tuple(run_filter(prepared, noise, smooth) for prepared in recordings)
    settled = [
        (run.innovations[run.settling :], run.expected[run.settling :], run.squared[run.settling :]) for run in runs
    ]
    innovations, expected, squared = zip(*settled, strict=True)
    names = [c.name for c in recordings[0].model.coordinates]
    return StateEstimates(runs, noise, consistency(names, innovations, expected, squared), smooth)
