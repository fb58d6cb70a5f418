"""Free-run simulation of any model under sampled inputs, each of which acts when its delay says."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from odescope.arrays import FloatArray, IntArray
from odescope.errors import InputError, check_kind, nearest
from odescope.model.given import GivenInputs, GivenState, first_state, sample_times, sampled_inputs
from odescope.model.integration import GREW, STIFF, Drive, Equations, bends, integrate
from odescope.model.model import Model
from odescope.model.state_sizes import small_sizes
from odescope.recordings.between_samples import FINER, laid_out
from odescope.recordings.coordinate import Input, following_states

ATOL = 1e-10  # of a state of size 1
SAME = 1e-9  # of the shortest time between samples: kinks that are nearer to a sample are that sample

_REASONS = {
    GREW: "the states grew without bound or met a pole after {:.4g} s",
    STIFF: "the equations became too stiff, or moved too fast, to be followed after {:.4g} s",
}
_AT_GIVEN_TIMES = {
    **_REASONS,
    STIFF: "the equations became too stiff to follow after {:.4g} s, or move too fast for times so far apart: give more"
    " of these in between, or a larger rtol",
}


@dataclass(frozen=True, eq=False)
class Trajectory:
    """A simulated run.

    Shapes: t (K,) seconds, states (K, n) in the order of `names`; K is shorter than the input where the run ended
    early, and `ended` then says why.
    """

    t: FloatArray
    states: FloatArray
    names: tuple[str, ...]
    ended: str | None

    def __repr__(self) -> str:
        span = f"{len(self.t)} samples, {self.t[0]:.6g} to {self.t[-1]:.6g} s"
        ended = "" if self.ended is None else f"; {self.ended}"
        return f"Trajectory of {', '.join(self.names)}: {span}{ended}"

    def column(self, name: str) -> FloatArray:
        """Return one state (K,); InputError names the nearest state where there is none."""
        if name not in self.names:
            raise InputError(f"no state {name!r}; {nearest(name, self.names)}")
        return self.states[:, self.names.index(name)]


def simulate(
    model: Model,
    t: ArrayLike,
    inputs: GivenInputs,
    initial: GivenState,
    rtol: float = 1e-8,
    atol: float | None = None,
) -> Trajectory:
    """Return the free run of a model under sampled inputs.

    An input with a delay acts that much later than it was sampled: the model sees u(t - delay), and the first (last)
    sample where there is none so early (late).

    Dry friction, sign(v) with v a sum of states, holds at v = 0 for as long as less than all of it is needed, and has
    then the value that keeps v at zero.

    Args:
        model: what to integrate.
        t: (N,) ascending sample times in seconds.
        inputs: as they were recorded: by name, in a dict or dataframe, each of shape (N,) or one number throughout; or
            an array (N, inputs) in the order of `model.inputs`, (N,) for one; None where the model has none. The time,
            `t` of a model that names it, is `t` where it is not given.
        initial: states at t[0]: by name, velocities too, or (n,) in the order of `model.states`.
        rtol: relative tolerance of a step.
        atol: absolute tolerance of a step, in the units of the states; by default 1e-10, of states that are smaller
            than 1 times their sizes: in the data that the model came from, else at the first sample.

    Raises:
        InputError: a shape or a name does not fit the model, a number is not finite, or time does not ascend.
    """
    check_kind(model, Model, "what is simulated")
    t = sample_times(t)
    driving = sampled_inputs(inputs, model.inputs, t)
    start = first_state(initial, model.states)
    return follow(model, t, drive(model.inputs, t, driving), start, rtol, atol, given=True)


def follow(
    model: Model,
    t: FloatArray,
    driven: Drive,
    initial: FloatArray,
    rtol: float = 1e-8,
    atol: float | None = None,
    given: bool = False,
) -> Trajectory:
    """Return the free run of a model under inputs that have been laid out: `simulate` for many runs.

    Args:
        model: what to integrate.
        t: (N,) the sample times of `driven`, seconds.
        driven: the model's inputs.
        initial: (n,) states at t[0], in the order of `model.states`.
        rtol: relative tolerance of a step.
        atol: absolute tolerance of a step, see `simulate`.
        given: whether whoever asks chose the times and tolerances, and may be told to choose others.
    """
    tape, edges = model.switched.tape, model.switched.edges
    equations = Equations(tape.instructions, tape.outputs, following_states(model.coordinates), edges)
    states = np.empty((len(t), len(model.states)))
    start = np.array(initial, dtype=np.float64)
    tolerances = ATOL * small_sizes(model, start) if atol is None else np.full(len(start), float(atol))
    reached, ending = integrate(equations, driven, start, states, float(rtol), tolerances)
    reason = (_AT_GIVEN_TIMES if given else _REASONS).get(ending)
    ended = None if reason is None else reason.format(t[reached - 1] - t[0])
    return Trajectory(np.array(t[:reached], dtype=np.float64), states[:reached].copy(), model.states, ended)


def drive(inputs: Sequence[Input], t: FloatArray, values: FloatArray) -> Drive:
    """Return sampled inputs as they act: between nodes linear, with a node wherever one of them has a kink.

    A band-limited input is a polygon of some nodes a sample, see `laid_out`; where sampling is not uniform, it is
    band-limited in the number of the sample.

    Args:
        inputs: how each runs between samples, and how late it acts.
        t: (N,) ascending sample times in seconds.
        values: (N, inputs) as they were recorded.
    """
    # Copies: a kernel would be compiled once more for arrays that may not be written to.
    t, values = np.array(t, dtype=np.float64), np.array(values, dtype=np.float64, order="C")
    held = np.array([i.hold == "zero" for i in inputs], dtype=np.bool_)
    if not any(i.delay or i.hold == "band-limited" for i in inputs):
        begin, end = values[:-1], np.where(held, values[:-1], values[1:])
        return Drive(t, np.arange(len(t)), begin, end, np.diff(t), bends(t, begin, end))
    since = t - t[0]
    polygons = [_polygon(i, since, values[:, k]) for k, i in enumerate(inputs)]
    kinks = _kinks(t, [at for at, _ in polygons])
    order = np.argsort(np.concatenate([since, kinks]), kind="stable")
    nodes = np.concatenate([since, kinks])[order]
    middle = 0.5 * (nodes[:-1] + nodes[1:])
    begin, end = np.empty((len(middle), len(inputs))), np.empty((len(middle), len(inputs)))
    for k, i in enumerate(inputs):
        if held[k]:
            # The middle of an interval lies off every kink, so that rounding cannot pick the sample beside.
            begin[:, k] = values[_last_sample(since, middle - i.delay), k]
            end[:, k] = begin[:, k]
        else:
            at, corners = polygons[k]
            begin[:, k], end[:, k] = np.interp(nodes[:-1], at, corners), np.interp(nodes[1:], at, corners)
    period = np.diff(since)[_last_sample(since, middle)]
    return Drive(nodes, np.where(order < len(t), order, -1), begin, end, period, bends(nodes, begin, end))


def known_from(inputs: Sequence[Input], t: FloatArray) -> int:
    """Return the first sample at which all inputs that act late had been recorded when they began to act.

    Args:
        inputs: with their delays.
        t: (N,) ascending sample times in seconds.
    """
    latest = max((i.delay for i in inputs), default=0.0)
    return min(int(np.searchsorted(t - t[0], latest)), len(t) - 1) if latest > 0.0 else 0


def _polygon(i: Input, since: FloatArray, samples: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the times of an input's corners as they act, and its values there."""
    if i.hold != "band-limited":
        return since + i.delay, samples
    corners = laid_out(samples)[: FINER * (len(samples) - 1) + 1]
    return np.interp(np.arange(len(corners)) / FINER, np.arange(len(since)), since) + i.delay, corners


def _kinks(t: FloatArray, corners: Sequence[FloatArray]) -> FloatArray:
    """Return the times since t[0], ascending and between samples, at which some input has a corner."""
    since = t - t[0]
    same = max(SAME * float(np.min(np.diff(t), initial=np.inf)), 4.0 * float(np.spacing(np.abs(t).max())))
    late = np.unique(np.concatenate(corners))
    late = late[(late > 0.0) & (late < since[-1])]
    before = _last_sample(since, late)
    late = late[(late - since[before] > same) & (since[np.minimum(before + 1, len(t) - 1)] - late > same)]
    kept: FloatArray = late[np.diff(late, prepend=-np.inf) > same]
    return kept


def _last_sample(since: FloatArray, at: FloatArray) -> IntArray:
    """Return the number of the last sample that is not after each time; the first for those before it."""
    found: IntArray = np.clip(np.searchsorted(since, at, side="right") - 1, 0, len(since) - 1)
    return found
