"""One compiled kernel for every expression: terms become a short tape of instructions that runs over lanes of samples.

Nothing is compiled for a model or a library: the kernel is generic and cached, so the cost of a new expression is
that of writing its tape. Common subexpressions share a slot.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import reduce
from typing import NamedTuple

import numpy as np

from odescope.arrays import FloatArray, IntArray
from odescope.library.expression import Combination, Power, Term
from odescope.library.functions import FUNCTIONS, call, code_of
from odescope.library.printer import Language, print_combination, print_term
from odescope.library.waves import waves
from odescope.parallel.kernels import kernel

LANES = 512  # samples a pass: with 100 slots the work array stays in a second-level cache


# Codes of instructions; those of functions follow (see functions.py).
CONSTANT, ADD, MULTIPLY, SCALE, INTEGER_POWER, REAL_POWER = range(6)
SIN, COS = FUNCTIONS["sin"].code, FUNCTIONS["cos"].code


class Instructions(NamedTuple):
    """What a tape does, step by step, as compiled kernels take it; step k writes the k-th slot after the inputs'.

    Shapes: all (K,). `left` and `right` are slots, but for an integer power `right` is the exponent.
    """

    code: IntArray
    left: IntArray
    right: IntArray
    constant: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class Tape:
    """Instructions, before whose slots come `inputs` slots for the values of names; outputs (terms,) are slots."""

    inputs: int
    instructions: Instructions
    outputs: IntArray

    @property
    def slots(self) -> int:
        """Number of slots: inputs and instructions."""
        return self.inputs + len(self.instructions.code)


class _Writer:
    """Collects instructions, each once."""

    def __init__(self, names: Sequence[str]) -> None:
        self.names = {name: k for k, name in enumerate(names)}
        self.rows: dict[tuple[int, int, int, float], int] = {}

    def emit(self, code: int, left: int = 0, right: int = 0, constant: float = 0.0) -> int:
        return self.rows.setdefault((code, left, right, constant), len(self.names) + len(self.rows))

    def sum(self, parts: Iterable[tuple[float, int]]) -> int:
        slots = [slot if c == 1.0 else self.emit(SCALE, slot, 0, c) for c, slot in parts]
        return reduce(lambda total, slot: self.emit(ADD, total, slot), slots) if slots else self.emit(CONSTANT)

    def product(self, factors: Iterable[int]) -> int:
        slots = list(factors)
        if not slots:
            return self.emit(CONSTANT, 0, 0, 1.0)
        return reduce(lambda product, slot: self.emit(MULTIPLY, product, slot), slots)

    def power(self, slot: int, power: Power) -> int:
        if power == 1:
            return slot
        if isinstance(power, int):
            return self.emit(INTEGER_POWER, slot, power)
        return self.emit(REAL_POWER, slot, 0, power)

    @property
    def language(self) -> Language[int]:
        """Instructions as a language, in which what is said of a part is the slot that holds its value."""
        return Language(
            name=lambda name, power: self.power(self.names[name], power),
            call=lambda function, slot, power: self.power(self.emit(code_of(function), slot), power),
            group=self.power,
            product=self.product,
            sum=self.sum,
        )


def write_tape(names: Sequence[str], expressions: Sequence[Term | Combination]) -> Tape:
    """Return the tape that computes `expressions` from the values of `names`."""
    writer = _Writer(names)
    language = writer.language
    outputs = [print_term(language, e) if isinstance(e, Term) else print_combination(language, e) for e in expressions]
    rows = list(writer.rows)
    code, left, right = (np.array([row[k] for row in rows], dtype=np.int64) for k in range(3))
    constant = np.array([row[3] for row in rows], dtype=np.float64)
    return Tape(len(names), Instructions(code, left, right, constant), np.array(outputs, dtype=np.int64))


@kernel(inline=True)
def run_tape(instructions: Instructions, work: FloatArray, lanes: int) -> None:
    """Run the instructions over work (slots, >= lanes), whose first rows hold the inputs: the one interpreter.

    Args:
        instructions: or a plain tuple of the same four arrays.
        work: (slots, >= lanes); one row is one slot, one column one sample. One column is as fast as scalars.
        lanes: columns to compute.
    """
    code, left, right, constant = instructions
    first = work.shape[0] - code.shape[0]
    for k in range(code.shape[0]):
        op, a, out = code[k], left[k], first + k
        if op == CONSTANT:
            for i in range(lanes):
                work[out, i] = constant[k]
        elif op == ADD:
            b = right[k]
            for i in range(lanes):
                work[out, i] = work[a, i] + work[b, i]
        elif op == MULTIPLY:
            b = right[k]
            for i in range(lanes):
                work[out, i] = work[a, i] * work[b, i]
        elif op == SCALE:
            for i in range(lanes):
                work[out, i] = constant[k] * work[a, i]
        elif op == INTEGER_POWER:
            n = abs(right[k])
            for i in range(lanes):
                value = work[a, i]
                for _ in range(n - 1):
                    value *= work[a, i]
                work[out, i] = value if right[k] > 0 else 1.0 / value
        elif op == REAL_POWER:
            for i in range(lanes):
                work[out, i] = work[a, i] ** constant[k]
        elif lanes > 1 and op in (SIN, COS):  # one at a time, the C library's are as fast
            waves(work, a, out, lanes, 1.0 if op == COS else 0.0)
        else:
            for i in range(lanes):
                work[out, i] = call(op, work[a, i])


@kernel()
def run_blocks(
    instructions: Instructions, outputs: IntArray, columns: FloatArray, result: FloatArray, block: int
) -> None:
    """Write the values of a tape's expressions to result (terms, N).

    Args:
        instructions: of the tape.
        outputs: (terms,) slots of the expressions.
        columns: (names, N) values of the names.
        result: to be overwritten.
        block: samples a pass.
    """
    first, samples = columns.shape
    work = np.empty((first + instructions[0].shape[0], block))
    for start in range(0, samples, block):
        lanes = min(block, samples - start)
        for j in range(first):
            for i in range(lanes):
                work[j, i] = columns[j, start + i]
        run_tape(instructions, work, lanes)
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
    run_blocks(tape.instructions, tape.outputs, contiguous, result, LANES)
    return result
