"""What a Lagrangian says of energy, and whether that can be: inertia, dissipation, and the balance over a record."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from odescope.arrays import FloatArray
from odescope.errors import InputError
from odescope.library.derivative import slope
from odescope.library.expansion import expanded
from odescope.library.expression import Combination, Name, Term
from odescope.library.mechanism import FORCE_ON, Kind
from odescope.library.parse import Scope, parse_term
from odescope.library.tape import evaluate, write_tape
from odescope.model.relation import FoundMechanism
from odescope.model.scores import EnergyScore
from odescope.recordings.coordinate import Coordinate, Input, state_names


@dataclass(frozen=True)
class Energies:
    """Kinetic energy, potential, dissipation function and the force on every coordinate, as found.

    The coefficients are those of the mechanisms, so all of it is in their scale.
    """

    rates: tuple[str, ...]
    kinetic: Combination
    potential: Combination
    dissipation: Combination
    forces: tuple[Combination, ...]

    @property
    def mass_matrix(self) -> list[list[Combination]]:
        """The second derivatives of the kinetic energy by the rates, written out."""
        momenta = [slope(self.kinetic, rate) for rate in self.rates]
        return [[expanded(slope(momentum, rate)) for rate in self.rates] for momentum in momenta]

    @property
    def energy(self) -> Combination:
        """What is conserved without forces and dissipation: the sum of q' T_q', less T, plus V; T + V for most."""
        moving = [_times(slope(self.kinetic, rate), rate) for rate in self.rates]
        kinetic = [(-c, t) for c, t in self.kinetic.parts]
        return Combination.of([*(p for m in moving for p in m.parts), *kinetic, *self.potential.parts])

    @property
    def driving_power(self) -> Combination:
        """What the forces put in."""
        return _sum([_times(f, rate) for f, rate in zip(self.forces, self.rates, strict=True)])

    @property
    def dissipated_power(self) -> Combination:
        """What the dissipation takes out: the sum of R_q' q'."""
        return _sum([_times(slope(self.dissipation, rate), rate) for rate in self.rates])


def energies_of(
    coordinates: Sequence[Coordinate], inputs: Sequence[Input], mechanisms: Sequence[FoundMechanism]
) -> Energies | None:
    """Return the energies that mechanisms add up to; None where they are no Lagrangian, or ties hide what they are.

    Args:
        coordinates: of the model.
        inputs: of the model.
        mechanisms: of the model; a force says in its name on which coordinate it acts.
    """
    kinds = {m.kind for m in mechanisms}
    if "kinetic" not in kinds or not kinds <= {"kinetic", "potential", "dissipation", "force"}:
        return None
    if any(c.order != 2 for c in coordinates) or not _on_coordinates(mechanisms, coordinates):
        return None
    scope = Scope.of([*state_names(coordinates), *(i.name for i in inputs)])
    try:
        terms = [parse_term(m.term, scope) for m in mechanisms]
    except InputError:  # of a file that anyone may have written
        return None

    def total(kind: Kind, name: str = "") -> Combination:
        chosen = zip(mechanisms, terms, strict=True)
        return Combination.of((m.coefficient, t) for m, t in chosen if m.kind == kind and m.name.endswith(name))

    return Energies(
        rates=tuple(c.derivative(1) for c in coordinates),
        kinetic=total("kinetic"),
        potential=total("potential"),
        dissipation=total("dissipation"),
        forces=tuple(total("force", FORCE_ON + c.name) for c in coordinates),
    )


def _on_coordinates(mechanisms: Sequence[FoundMechanism], coordinates: Sequence[Coordinate]) -> bool:
    """Say whether every force acts on a coordinate."""
    ends = tuple(FORCE_ON + c.name for c in coordinates)
    return all(m.name.endswith(ends) for m in mechanisms if m.kind == "force")


def mass_matrix(
    coordinates: Sequence[Coordinate], inputs: Sequence[Input], mechanisms: Sequence[FoundMechanism]
) -> list[list[Combination]] | None:
    """Return what multiplies the accelerations, by coordinates; None where mechanisms are no Lagrangian.

    Args:
        coordinates: of the model.
        inputs: of the model.
        mechanisms: of the model.
    """
    energies = energies_of(coordinates, inputs, mechanisms)
    try:
        return None if energies is None else energies.mass_matrix
    except InputError:  # too long to write out
        return None


def energy_scores(
    energies: Energies,
    mechanisms: Sequence[FoundMechanism],
    names: Sequence[str],
    columns: Sequence[FloatArray],
    h: float,
) -> EnergyScore:
    """Return how a Lagrangian stands the data.

    Args:
        energies: what its mechanisms add up to.
        mechanisms: those of the model.
        names: of the rows of the columns: states and inputs.
        columns: one a recording, (names, N).
        h: sampling period of the columns, in seconds.
    """
    joined = np.concatenate(columns, axis=1)
    power = _values(names, [energies.dissipated_power], joined)[0]
    size = float(np.abs(power).max(initial=0.0))
    return EnergyScore(
        least_inertia=float(_least_eigenvalues(energies, names, joined).min()),
        least_dissipation=float(power.min()) / size if size > 0.0 else None,
        imbalance=_imbalance(energies, names, columns, h),
        loosest=loosest(mechanisms),
    )


def loosest(mechanisms: Sequence[FoundMechanism]) -> float | None:
    """Return the largest standard error of a kinetic mechanism over its coefficient; None where none is stated.

    Beyond 1 the record tells the inertia from nothing: another Lagrangian, with this part of it gone or doubled, fits
    as well.
    """
    ratios = [
        m.std_error / abs(m.coefficient)
        for m in mechanisms
        if m.kind == "kinetic" and m.std_error is not None and m.coefficient
    ]
    return max(ratios, default=None)


def _least_eigenvalues(energies: Energies, names: Sequence[str], columns: FloatArray) -> FloatArray:
    """Return the smallest eigenvalue of the mass matrix at every sample, (N,)."""
    count = len(energies.rates)
    entries = _values(names, [entry for row in energies.mass_matrix for entry in row], columns)
    matrices = np.moveaxis(entries.reshape(count, count, -1), -1, 0)
    return np.asarray(np.linalg.eigvalsh(matrices)[:, 0], dtype=np.float64)


def _imbalance(energies: Energies, names: Sequence[str], columns: Sequence[FloatArray], h: float) -> float | None:
    """Return what is missing between the energy, what came in and what was dissipated, over what was turned over.

    Root mean square over all recordings, each about its mean; what was turned over is the largest range of the three,
    and of the kinetic energy: where nothing comes in or goes, that is turned into potential energy and back.
    """
    # Imported here: commands that score nothing need not wait for it.
    from scipy.integrate import cumulative_trapezoid

    missing, turned = list[FloatArray](), 0.0
    wanted = [energies.energy, energies.kinetic, energies.driving_power, energies.dissipated_power]
    for x in columns:
        energy, kinetic, driving, dissipated = _values(names, wanted, x)
        came, went = (cumulative_trapezoid(power, dx=h, initial=0.0) for power in (driving, dissipated))
        error = energy - came + went
        missing.append(error - error.mean())
        turned = max(turned, *(float(np.ptp(part)) for part in (energy, kinetic, came, went)))
    if not 0.0 < turned < np.inf:
        return None
    return float(np.sqrt(np.mean((np.concatenate(missing) / turned) ** 2)))  # energies of a wrong model may be any size


def _values(names: Sequence[str], combinations: Sequence[Combination], columns: FloatArray) -> FloatArray:
    return evaluate(write_tape(names, combinations), np.ascontiguousarray(columns))


def _times(combination: Combination, name: str) -> Combination:
    factor = Term(((Name(name), 1),))
    return Combination.of((c, t * factor) for c, t in combination.parts)


def _sum(combinations: Sequence[Combination]) -> Combination:
    return Combination.of(part for combination in combinations for part in combination.parts)
