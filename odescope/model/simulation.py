"""Free-run simulation of any model by one compiled kernel: Dormand-Prince 5(4), steps ending on the samples.

Between two samples an input is linear or held, so no step runs over a kink. A blow-up, a pole or a stiff stretch that
would take for ever ends the run and is reported: an outcome, not an exception and never a hang.
"""

from __future__ import annotations

from dataclasses import dataclass

import numba
import numpy as np

from odescope.arrays import FloatArray, IntArray
from odescope.errors import InputError
from odescope.model.model import Model
from odescope.recordings.coordinate import following_states

STEPS_A_SAMPLE = 2000  # more between two samples than this and the run has ended
STEPS_ON_AVERAGE = 100  # and more than this on average over a long record
LARGEST = 1e12  # times the largest initial state, or 1


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

    def column(self, name: str) -> FloatArray:
        """Return one state (K,)."""
        return self.states[:, self.names.index(name)]


_A = np.array(
    [
        [0, 0, 0, 0, 0, 0],
        [1 / 5, 0, 0, 0, 0, 0],
        [3 / 40, 9 / 40, 0, 0, 0, 0],
        [44 / 45, -56 / 15, 32 / 9, 0, 0, 0],
        [19372 / 6561, -25360 / 2187, 64448 / 6561, -212 / 729, 0, 0],
        [9017 / 3168, -355 / 33, 46732 / 5247, 49 / 176, -5103 / 18656, 0],
        [35 / 384, 0, 500 / 1113, 125 / 192, -2187 / 6784, 11 / 84],
    ]
)
_C = np.array([0, 1 / 5, 3 / 10, 4 / 5, 8 / 9, 1, 1])
_E = np.array([71 / 57600, 0, -71 / 16695, 71 / 1920, -17253 / 339200, 22 / 525, -1 / 40])


def simulate(
    model: Model, t: FloatArray, inputs: FloatArray, initial: FloatArray, rtol: float = 1e-8, atol: float = 1e-10
) -> Trajectory:
    """Return the free run of a model under sampled inputs.

    Args:
        model: what to integrate.
        t: (N,) ascending sample times in seconds.
        inputs: (N, inputs) in the order of `model.inputs`.
        initial: (n,) states at t[0], in the order of `model.states`.
        rtol: relative tolerance of a step.
        atol: absolute tolerance of a step.

    Raises:
        InputError: a shape does not fit the model, a number is not finite, or time does not ascend.
    """
    expected = (len(t), len(model.inputs))
    if inputs.shape != expected or initial.shape != (len(model.states),):
        raise InputError(
            f"the model takes inputs of shape {expected} and {len(model.states)} initial states; shapes"
            f" {inputs.shape} and {initial.shape} came"
        )
    if not (np.all(np.isfinite(inputs)) and np.all(np.isfinite(initial)) and np.all(np.isfinite(t))):
        raise InputError("time, inputs and initial states must be finite")
    if len(t) == 0 or np.any(np.diff(t) <= 0.0):
        raise InputError("sample times must ascend, and there must be at least one")
    tape, following = model.tape, following_states(model.coordinates)
    held = np.array([i.hold == "zero" for i in model.inputs], dtype=np.bool_)
    states = np.empty((len(t), len(model.states)))
    # The tolerance is relative to the run, not to a value that happens to pass zero.
    reached, code = _integrate(
        tape.code,
        tape.left,
        tape.right,
        tape.constant,
        tape.outputs,
        following,
        held,
        np.ascontiguousarray(t, dtype=np.float64),
        np.ascontiguousarray(inputs, dtype=np.float64),
        np.ascontiguousarray(initial, dtype=np.float64),
        states,
        _A,
        _C,
        _E,
        rtol,
        atol,
    )
    reasons = (
        None,
        "the states grew without bound or met a pole",
        "the equations became too stiff to follow",
    )
    ended = reasons[code]
    if ended is not None:
        ended = f"{ended} after t = {float(t[reached - 1])!r} s"
    return Trajectory(t[:reached].copy(), states[:reached].copy(), model.states, ended)


@numba.njit(cache=True, nogil=True, error_model="numpy")
def run_tape_once(
    code: IntArray, left: IntArray, right: IntArray, constant: FloatArray, work: FloatArray, first: int
) -> None:
    """Run a tape on one sample: `run_tape` without lanes."""
    for k in range(code.shape[0]):
        op, a = code[k], work[left[k]]
        if op == 0:
            value = constant[k]
        elif op == 1:
            value = a + work[right[k]]
        elif op == 2:
            value = a * work[right[k]]
        elif op == 3:
            value = constant[k] * a
        elif op == 4:
            value = a
            for _ in range(abs(right[k]) - 1):
                value *= a
            if right[k] < 0:
                value = 1.0 / value
        elif op == 5:
            value = a ** constant[k]
        elif op == 6:
            value = np.sin(a)
        elif op == 7:
            value = np.cos(a)
        elif op == 8:
            value = np.tan(a)
        elif op == 9:
            value = np.exp(a)
        elif op == 10:
            value = np.log(a) if a >= 0.0 else np.nan
        elif op == 11:
            value = np.sqrt(a) if a >= 0.0 else np.nan
        elif op == 12:
            value = abs(a)
        elif op == 13:
            value = np.sign(a)
        else:
            value = np.tanh(a)
        work[first + k] = value


@numba.njit(cache=True, nogil=True, error_model="numpy")
def solve_small(a: FloatArray, b: FloatArray) -> None:
    """Solve a x = b in place of b, by elimination with partial pivoting; a singular matrix gives not-finite values."""
    n = b.shape[0]
    for k in range(n):
        pivot = k
        for i in range(k + 1, n):
            if abs(a[i, k]) > abs(a[pivot, k]):
                pivot = i
        if pivot != k:
            for j in range(n):
                a[k, j], a[pivot, j] = a[pivot, j], a[k, j]
            b[k], b[pivot] = b[pivot], b[k]
        for i in range(k + 1, n):
            factor = a[i, k] / a[k, k]
            for j in range(k, n):
                a[i, j] -= factor * a[k, j]
            b[i] -= factor * b[k]
    for k in range(n - 1, -1, -1):
        for j in range(k + 1, n):
            b[k] -= a[k, j] * b[j]
        b[k] /= a[k, k]


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _derivative(code, left, right, constant, outputs, following, x, work, a, b, out):
    n, targets = x.shape[0], b.shape[0]
    for i in range(n):
        work[i] = x[i]
    run_tape_once(code, left, right, constant, work, work.shape[0] - code.shape[0])
    for i in range(targets):
        for j in range(targets):
            a[i, j] = work[outputs[i * targets + j]]
        b[i] = work[outputs[targets * targets + i]]
    solve_small(a, b)
    for i in range(n):
        out[i] = x[following[i]] if following[i] >= 0 else b[-1 - following[i]]


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _integrate(code, left, right, constant, outputs, following, held, t, u, initial, states, A, C, E, rtol, atol):
    n, targets = initial.shape[0], 0
    while targets * targets + targets < outputs.shape[0]:
        targets += 1
    drive = u.shape[1]
    work = np.empty(n + drive + code.shape[0])
    a, b = np.empty((targets, targets)), np.empty(targets)
    x, y, k, scale = initial.copy(), np.empty(n), np.empty((7, n)), np.abs(initial)
    states[0] = x
    h, total_steps = 0.0, 0
    budget = STEPS_A_SAMPLE * 10 + STEPS_ON_AVERAGE * t.shape[0]
    largest = LARGEST * max(1.0, np.abs(initial).max())
    for sample in range(t.shape[0] - 1):
        span = t[sample + 1] - t[sample]
        done, fresh = 0.0, True
        if h <= 0.0 or h > span:
            h = span
        steps = 0
        while done < span:
            step = span - done if span - done < h * (1.0 + 1e-9) else h
            for s in range(7):
                if s == 0 and not fresh:
                    for i in range(n):
                        k[0, i] = k[6, i]
                    continue
                fraction = (done + C[s] * step) / span
                for j in range(drive):
                    rise = 0.0 if held[j] else u[sample + 1, j] - u[sample, j]
                    work[n + j] = u[sample, j] + fraction * rise
                for i in range(n):
                    total = 0.0
                    for r in range(s):
                        total += A[s, r] * k[r, i]
                    y[i] = x[i] + step * total
                _derivative(code, left, right, constant, outputs, following, y, work, a, b, k[s])
            error = 0.0
            for i in range(n):
                estimate = 0.0
                for r in range(7):
                    estimate += E[r] * k[r, i]
                limit = atol + rtol * max(scale[i], abs(y[i]))
                error += (step * estimate / limit) ** 2
            error = np.sqrt(error / n)
            steps += 1
            total_steps += 1
            if error <= 1.0:
                done = span if step == span - done else done + step
                fresh = False
                for i in range(n):
                    x[i] = y[i]
                    scale[i] = max(scale[i], abs(x[i]))
                    if not abs(x[i]) < largest:
                        return sample + 1, 1
                grown = 5.0 if error < 1e-4 else min(5.0, 0.9 * error**-0.2)
                # A step cut short by the sample says nothing of how long the next may be.
                h = max(h, step * grown) if step < h else step * grown
            else:
                fresh = True
                h = step * (max(0.1, 0.9 * error**-0.2) if error < 1e300 else 0.1)
                if not h > 1e-12 * span:
                    return sample + 1, 1
            if steps > STEPS_A_SAMPLE or total_steps > budget:
                return sample + 1, 2
        states[sample + 1] = x
    return t.shape[0], 0
