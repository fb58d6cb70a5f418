"""What logs of machines suffer: one defect of each kind, or all of them, sizes drawn by seed.

| defect | what it does, and its size, drawn uniformly |
|---|---|
| clock jitter | stamps are read with a normal error of 0.02 to 0.2 periods; sampling is regular |
| sampling jitter | sampling is off a regular grid by up to 0.05 to 0.3 periods; stamps are true |
| first interval | is 1.4 to 3 periods long |
| late reads | 0.5 to 2 % of the rows repeat all measured channels of the row before or, by chance of the log, of the |
| | row after (the value then belongs to the last stamp of a burst) |
| dropped rows | 4 to 6 % of the rows are missing, here and there |
| gap | a stretch of 2 to 8 % of the recording is missing |
| quantisation | positions are rounded to 1 to 4 of the finest encoder steps, with no other noise |
| input delay | inputs act 1 to 4 periods late |
| held input | inputs are held for 3 to 8 samples, and recorded at every sample |
| offsets | the zero of every angle is 0.05 to 0.15 rad off; beside every input a constant of 3 to 10 % of its size |
| outliers | 0.8 to 1.2 % of the samples of every channel are 10 to 50 standard deviations of the noise off |
| process noise | a white torque beside every input, drawn anew at every sample, of 5 to 20 % of the input's size |
| all | all of these |

Delay, hold, offsets and process noise are the machine's, and the rest is the log's. Recordings to be judged on keep
what is the machine's but its process noise, and suffer nothing else.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from rigs import LEVELS, Rig
from travel import travel

RANGES: Mapping[str, Mapping[str, tuple[float, float]]] = {
    "clean": {},
    "clock jitter": {"clock": (0.02, 0.2)},
    "sampling jitter": {"sampling": (0.05, 0.3)},
    "first interval": {"first": (1.4, 3.0)},
    "late reads": {"late": (0.005, 0.02)},
    "dropped rows": {"dropped": (0.04, 0.06)},
    "gap": {"gap": (0.02, 0.08)},
    "quantisation": {"steps": (1.0, 4.0)},
    "input delay": {"delay": (1.0, 4.0)},
    "held input": {"held": (3.0, 8.0)},
    "offsets": {"zero": (0.05, 0.15), "beside": (0.03, 0.1)},
    "outliers": {"outliers": (0.008, 0.012)},
    "process noise": {"torque": (0.05, 0.2)},
}
DEFECTS = (*RANGES, "all")
FAR = (10.0, 50.0)  # standard deviations of the noise that an outlier is off


@dataclass(frozen=True)
class Defects:
    """Sizes of defects, each of which is none by default; units as in the table above.

    `zero` (of every coordinate) and `beside` (of every input) have signs and units of their own.
    """

    zero: tuple[float, ...]
    beside: tuple[float, ...]
    clock: float = 0.0
    sampling: float = 0.0
    first: float = 1.0
    late: float = 0.0
    dropped: float = 0.0
    gap: float = 0.0
    steps: float = 0.0
    delay: float = 0.0
    held: int = 0
    outliers: float = 0.0
    torque: float = 0.0


@dataclass(frozen=True, eq=False)
class Run:
    """A run without any error of reading.

    Shapes: t (N,) when it was sampled, states (N, n) by the zeros of its sensors, inputs (N, m) as they were commanded.
    """

    t: np.ndarray
    states: np.ndarray
    inputs: np.ndarray


def drawn(name: str, rig: Rig, rng: np.random.Generator) -> Defects:
    """Return a defect of the table above for a rig."""
    ranges = {k: v for one in RANGES.values() for k, v in one.items()} if name == "all" else dict(RANGES[name])
    zeros, constants = ranges.pop("zero", None), ranges.pop("beside", None)
    sizes = {k: float(rng.uniform(*v)) for k, v in ranges.items()}
    if "held" in sizes:
        sizes["held"] = round(sizes["held"])

    def signed(limits: tuple[float, float] | None) -> float:
        return float(rng.choice((-1.0, 1.0)) * rng.uniform(*limits)) if limits else 0.0

    zero = tuple(signed(zeros) if c.angle else 0.0 for c in rig.coordinates.values())
    beside = tuple(size * signed(constants) for size in rig.strength.values())
    return Defects(zero, beside, **sizes)


def sampled(rig: Rig, defects: Defects, samples: int, rng: np.random.Generator) -> np.ndarray:
    """Return when the samples are taken (N,)."""
    t = np.arange(samples) + rng.uniform(-defects.sampling, defects.sampling, samples)
    t[1:] += defects.first - 1.0
    return (t - t[0]) * rig.period


def ride(rig: Rig, defects: Defects, t: np.ndarray, rng: np.random.Generator) -> Run:
    """Return a run sampled at t, with the defects that are the machine's."""
    strength = np.array(list(rig.strength.values()))
    beside = defects.beside + defects.torque * strength * rng.standard_normal((len(t), len(strength)))
    drive, start = rig.drive(rng, np.arange(len(t)) * rig.period), np.array(rig.start)
    states, inputs = travel(rig.rate, t, drive, start, beside, defects.delay * rig.period, defects.held)
    states[:, : len(defects.zero)] += defects.zero
    return Run(t, states, inputs)


def logged(rig: Rig, defects: Defects, run: Run, level: int, rng: np.random.Generator) -> dict[str, np.ndarray]:
    """Return the table that is logged of a run, with the defects that are the log's."""
    count, channels = len(run.t), len(rig.coordinates)
    sigma = LEVELS[level] * np.array(rig.noise)
    read = run.states[:, :channels] + (0.0 if defects.steps else sigma * rng.standard_normal((count, channels)))
    wrong = rng.random((count, channels)) < defects.outliers
    read = read + wrong * sigma * rng.choice((-1.0, 1.0), read.shape) * rng.uniform(*FAR, read.shape)
    if defects.steps:
        steps = defects.steps * np.array(rig.step)
        read = np.round(read / steps) * steps
    fresh = np.ones(count, dtype=bool)
    fresh[rng.choice(np.arange(1, count - 1), round(defects.late * count), replace=False)] = False
    # A late row repeats the last fresh one before it or, taken backwards, after it.
    order = slice(None, None, int(rng.choice((-1, 1))))
    read = read[order][np.maximum.accumulate(np.where(fresh[order], np.arange(count), 0))][order]
    stamps = run.t + rig.period * np.clip(defects.clock * rng.standard_normal(count), -0.45, 0.45)
    kept = rng.random(count) >= defects.dropped
    begin, length = rng.uniform(0.2, 0.7), defects.gap
    kept[round(begin * count) : round((begin + length) * count)] = False
    kept[[0, -1]] = True
    columns = {"t": stamps, **dict(zip(rig.coordinates, read.T, strict=True))}
    columns |= dict(zip(rig.strength, run.inputs.T, strict=True))
    return {name: np.ascontiguousarray(column[kept]) for name, column in columns.items()}
