"""What an input does between its samples: band-limited interpolation, and commands that are held over several rows."""

from __future__ import annotations

import numpy as np

from odescope.arrays import BoolArray, FloatArray

REACH = 32  # samples to each side that a value between samples is made of
WINDOW = 8.0  # of Kaiser: what lies below 0.9 of half the sampling rate is kept to 1e-4
FINER = 4  # nodes a sample of a band-limited input that is laid out
LEVELS = 20  # jumps, at least, that say that a command is held over several rows
ALONE = 0.9  # of the jumps: so many stand between samples that do not change
JUMP = 0.1  # standard deviations of the input: smaller jumps may be steps of a converter


def shifted(samples: FloatArray, late: float) -> FloatArray:
    """Return a band-limited input (N,) as it was so many samples ago: windowed-sinc interpolation.

    Beyond its ends an input is taken to go on point-symmetrically about its first or last sample, for what is within
    the record, and to stay at that sample, for what is not.
    """
    at = np.arange(len(samples)) - late
    below = np.floor(at).astype(np.int64)
    between = _later(samples, float(np.median(at - below)))
    found: FloatArray = between[np.clip(below, 0, len(samples) - 1)]
    found[at <= 0.0], found[at >= len(samples) - 1.0] = samples[0], samples[-1]
    return found


def laid_out(samples: FloatArray) -> FloatArray:
    """Return nodes (FINER N,) of a polygon that stands for a band-limited input (N,): FINER a sample, the first at it.

    A polygon through an input of frequency w lies inside its bends and loses w^2/12 of it, w in radians a node. The
    nodes are moved outwards by that much, a twelfth of the second difference, so that means over intervals are right to
    fourth order. After the last sample the input stays.
    """
    fine = np.stack([_later(samples, k / FINER) for k in range(FINER)], axis=1).ravel()
    fine[-FINER:] = samples[-1]
    within = fine[: len(fine) - FINER + 1]
    within[1:-1] -= np.diff(within, 2) / 12.0
    return fine


def _later(samples: FloatArray, fraction: float) -> FloatArray:
    """Return a band-limited input (N,) a fraction of a sample after each sample."""
    if fraction == 0.0:
        return samples.copy()
    away = fraction + np.arange(REACH, -REACH, -1) - 1.0  # of the sample from the place between two, in samples
    weights = np.sinc(away) * np.i0(WINDOW * np.sqrt(1.0 - (away / REACH) ** 2))
    padded = np.pad(samples, (REACH - 1, REACH), mode="reflect", reflect_type="odd")
    found: FloatArray = np.correlate(padded, weights / weights.sum(), mode="valid")
    return found


def looks_held(samples: FloatArray) -> bool:
    """Say whether an input (N,) is seen to be held over several rows: runs of equal values between large jumps.

    A slow signal after a coarse converter has runs, too, but its jumps are small.
    """
    changes = np.diff(samples)
    jumps = changes != 0.0
    if np.count_nonzero(jumps) < LEVELS:
        return False
    still: BoolArray = ~jumps
    alone = still[:-2] & jumps[1:-1] & still[2:]
    large = float(np.median(np.abs(changes[jumps]))) > JUMP * float(samples.std())
    return large and int(np.count_nonzero(alone)) > ALONE * int(np.count_nonzero(jumps))
