"""One compiled kernel for every expression: terms become a short tape of instructions that runs over lanes of samples.

Nothing is compiled for a model or a library: the kernel is generic and cached, so the cost of a new expression is
that of writing its tape. Common subexpressions share a slot.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numba
import numpy as np

from odescope.arrays import FloatArray, IntArray
from odescope.library.expression import Atom, Combination, Name, Power, Term
from odescope.library.functions import ADD, CONSTANT, FUNCTIONS, INTEGER_POWER, MULTIPLY, REAL_POWER, SCALE

LANES = 512  # samples a pass: with 100 slots the work array stays in a second-level cache


@dataclass(frozen=True, slots=True, eq=False)
class Tape:
    """Instructions; the first slots are the inputs, instruction k writes slot `inputs + k`.

    Shapes: code, left, right (K,) integers, constant (K,); outputs (terms,) slots.
    """

    inputs: int
    code: IntArray
    left: IntArray
    right: IntArray
    constant: FloatArray
    outputs: IntArray

    @property
    def slots(self) -> int:
        """Number of slots: inputs and instructions."""
        return self.inputs + len(self.code)


class _Writer:
    """Collects instructions, each once."""

    def __init__(self, names: Sequence[str]) -> None:
        self.names = {name: k for k, name in enumerate(names)}
        self.rows: dict[tuple[int, int, int, float], int] = {}

    def emit(self, code: int, left: int = 0, right: int = 0, constant: float = 0.0) -> int:
        return self.rows.setdefault((code, left, right, constant), len(self.names) + len(self.rows))

    def combination(self, combination: Combination) -> int:
        slots = []
        for c, t in combination.parts:
            slot = self.term(t)
            slots.append(slot if c == 1.0 else self.emit(SCALE, slot, 0, c))
        if not slots:
            return self.emit(CONSTANT)
        total = slots[0]
        for slot in slots[1:]:
            total = self.emit(ADD, total, slot)
        return total

    def term(self, term: Term) -> int:
        if not term.factors:
            return self.emit(CONSTANT, 0, 0, 1.0)
        slots = [self.power(atom, power) for atom, power in term.factors]
        product = slots[0]
        for slot in slots[1:]:
            product = self.emit(MULTIPLY, product, slot)
        return product

    def power(self, atom: Atom, power: Power) -> int:
        if isinstance(atom, Name):
            slot = self.names[atom.name]
        else:
            slot = self.combination(atom.argument)
            if atom.function:
                slot = self.emit(FUNCTIONS[atom.function].code, slot)
        if power == 1:
            return slot
        if isinstance(power, int):
            return self.emit(INTEGER_POWER, slot, power)
        return self.emit(REAL_POWER, slot, 0, power)


def write_tape(names: Sequence[str], expressions: Sequence[Term | Combination]) -> Tape:
    """Return the tape that computes `expressions` from the values of `names`."""
    writer = _Writer(names)
    outputs = [writer.term(e) if isinstance(e, Term) else writer.combination(e) for e in expressions]
    rows = list(writer.rows)
    code, left, right = (np.array([row[k] for row in rows], dtype=np.int64) for k in range(3))
    constant = np.array([row[3] for row in rows], dtype=np.float64)
    return Tape(len(names), code, left, right, constant, np.array(outputs, dtype=np.int64))


@numba.njit(cache=True, nogil=True, error_model="numpy")
def run_tape(
    code: IntArray, left: IntArray, right: IntArray, constant: FloatArray, work: FloatArray, first: int, lanes: int
) -> None:
    """Run the tape over work (slots, >= lanes), whose first `first` rows hold the inputs."""
    for k in range(code.shape[0]):
        op, a, out = code[k], work[left[k]], work[first + k]
        if op == 0:
            for i in range(lanes):
                out[i] = constant[k]
        elif op == 1:
            b = work[right[k]]
            for i in range(lanes):
                out[i] = a[i] + b[i]
        elif op == 2:
            b = work[right[k]]
            for i in range(lanes):
                out[i] = a[i] * b[i]
        elif op == 3:
            for i in range(lanes):
                out[i] = constant[k] * a[i]
        elif op == 4:
            n = abs(right[k])
            for i in range(lanes):
                value = a[i]
                for _ in range(n - 1):
                    value *= a[i]
                out[i] = value if right[k] > 0 else 1.0 / value
        elif op == 5:
            for i in range(lanes):
                out[i] = a[i] ** constant[k]
        elif op == 6:
            for i in range(lanes):
                out[i] = np.sin(a[i])
        elif op == 7:
            for i in range(lanes):
                out[i] = np.cos(a[i])
        elif op == 8:
            for i in range(lanes):
                out[i] = np.tan(a[i])
        elif op == 9:
            for i in range(lanes):
                out[i] = np.exp(a[i])
        elif op == 10:
            for i in range(lanes):
                out[i] = np.log(a[i]) if a[i] >= 0.0 else np.nan
        elif op == 11:
            for i in range(lanes):
                out[i] = np.sqrt(a[i]) if a[i] >= 0.0 else np.nan
        elif op == 12:
            for i in range(lanes):
                out[i] = abs(a[i])
        elif op == 13:
            for i in range(lanes):
                out[i] = np.sign(a[i])
        else:
            for i in range(lanes):
                out[i] = np.tanh(a[i])


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _run_blocks(
    code: IntArray,
    left: IntArray,
    right: IntArray,
    constant: FloatArray,
    outputs: IntArray,
    columns: FloatArray,
    result: FloatArray,
    block: int,
) -> None:
    first, samples = columns.shape
    work = np.empty((first + code.shape[0], block))
    for start in range(0, samples, block):
        lanes = min(block, samples - start)
        for j in range(first):
            for i in range(lanes):
                work[j, i] = columns[j, start + i]
        run_tape(code, left, right, constant, work, first, lanes)
        for j in range(outputs.shape[0]):
            row = work[outputs[j]]
            for i in range(lanes):
                result[j, start + i] = row[i]


def evaluate(tape: Tape, columns: FloatArray) -> FloatArray:
    """Return the values of the tape's expressions, (terms, N), from columns (names, N).

    Domain errors give NaN or infinity, never an exception; the caller decides what they mean.
    """
    result = np.empty((len(tape.outputs), columns.shape[1]))
    contiguous = np.ascontiguousarray(columns, dtype=np.float64)
    _run_blocks(tape.code, tape.left, tape.right, tape.constant, tape.outputs, contiguous, result, LANES)
    return result
