"""What holds of a model beside its equations: the energies of a Lagrangian, and sums that stay constant."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from odescope.arrays import FloatArray
from odescope.library.conservation import conserved, constant_sums
from odescope.library.expression import signed_sum
from odescope.library.mechanism import Mechanism
from odescope.model.energy import energies_of, energy_scores
from odescope.model.model import Model
from odescope.model.scores import Conserved, EnergyScore
from odescope.pipeline.joint_models import samples_of
from odescope.recordings.record import Records
from odescope.signals.estimate import Signals
from odescope.signals.noise import noise_levels
from odescope.signals.spectral import Spectrum

BLOCKS = 16  # a recording: what varies slowly shows in their means, where there is little noise
SURE = 3.0  # standard deviations of a variance: what is within them may be noise
MOST_SPECIES = 16  # of more, sums of four are too many to look at


def energy_of(model: Model, signals: Signals) -> EnergyScore | None:
    """Return how the model stands the data as a Lagrangian; None where it is none.

    Args:
        model: what was found.
        signals: what it was found in.
    """
    energies = energies_of(model.coordinates, model.inputs, model.mechanisms)
    if energies is None:
        return None
    return energy_scores(energies, model.mechanisms, model.variables, samples_of(signals, model), signals.period)


def constants_of(records: Records, signals: Signals, mechanisms: Sequence[Mechanism]) -> tuple[Conserved, ...]:
    """Return the sums of coordinates of order 1 that stay constant, in the data and by the mechanisms of the model.

    Args:
        records: as measured.
        signals: the noise that was found in them.
        mechanisms: those that are in the model; none where they are not known.
    """
    names = tuple(c.name for c in signals.coordinates)
    if any(c.order != 1 for c in signals.coordinates) or not 2 <= len(names) <= MOST_SPECIES:
        return ()
    columns = [np.array([run.column(name) for name in names]) for run in records]
    noise = _noises(columns, np.array([c.noise for c in signals.channels]))
    reacting = any(m.kind == "reaction" for m in mechanisms)
    laws = conserved(signals.coordinates, mechanisms) if reacting else ()
    seen = constant_sums(columns, names, noise)
    found = [Conserved(str(s), s.values, _follows(s.weights, laws, names) if reacting else None) for s in seen]
    weights = [s.weights for s in seen]
    hidden = [law for law in laws if not _follows(law, weights, names)]
    drifts = [_drift(columns, np.array([law.get(n, 0.0) for n in names]), noise) for law in hidden]
    told = [signed_sum((w, n) for n, w in law.items()) for law in hidden]
    return (*found, *(Conserved(s, (), True, drift) for s, drift in zip(told, drifts, strict=True)))


def _noises(columns: Sequence[FloatArray], noise: FloatArray) -> FloatArray:
    """Return the noise of every species as each recording has it (recordings, c), the same where none clearly differs.

    Args:
        columns: (c, N) of every recording.
        noise: (c,) standard deviations over all of them.
    """
    levels = np.array([noise_levels([Spectrum.of(row) for row in rows]) for rows in zip(*columns, strict=True)]).T
    whole = np.sqrt(np.average(levels**2, axis=0, weights=[x.shape[1] for x in columns]))
    found: FloatArray = noise * np.divide(levels, whole, out=np.ones_like(levels), where=whole > 0.0)
    return found


def _drift(columns: Sequence[FloatArray], weights: FloatArray, noise: FloatArray) -> float:
    """Return how far a sum moves within recordings, over the member that moves most; what noise may do counts as none.

    Args:
        columns: (c, N) of every recording.
        weights: (c,) of the sum.
        noise: (recordings, c) standard deviations.
    """
    moved, most, by_chance, means = 0.0, 0.0, 0.0, 0
    for x, own in zip(columns, noise, strict=True):
        blocks = np.array_split(x * weights[:, None], min(BLOCKS, x.shape[1]), axis=1)
        mean = np.array([block.mean(axis=1) for block in blocks])
        moved += float(mean.sum(axis=1).var() * len(mean))
        most = max(most, float(mean.var(axis=0).max()))
        by_chance += float(np.sum((weights * own) ** 2)) * sum(1.0 / block.shape[1] for block in blocks)
        means += len(mean)
    beyond = moved - (1.0 + SURE * np.sqrt(2.0 / means)) * by_chance
    return float(np.sqrt(max(beyond, 0.0) / means / most)) if most > 0.0 else 0.0


def _follows(law: Mapping[str, float], laws: Sequence[Mapping[str, float]], names: Sequence[str]) -> bool:
    """Say whether a sum is a combination of others, whose constancy is then its own."""
    rows = np.array([[w.get(n, 0.0) for n in names] for w in (*laws, law)])
    return bool(np.linalg.matrix_rank(rows) == np.linalg.matrix_rank(rows[:-1])) if laws else False
