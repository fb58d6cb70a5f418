"""What a column of a record stands for: a coordinate with the order of its equation, or an input."""

from __future__ import annotations

import keyword
import math
from collections.abc import Collection, Sequence
from typing import Literal, get_args

import msgspec
import numpy as np

from odescope.arrays import IntArray
from odescope.errors import InputError

Hold = Literal["linear", "zero", "band-limited"]

TIME = "t"  # the name of the time in a library and among the inputs of a model
LONGEST_NAME = 64
HIGHEST_ORDER = 8


def check_name(name: str, what: str) -> None:
    """Refuse a name that is not a plain identifier; `what` says whose name it is.

    Raises:
        InputError: the name is not an ASCII Python identifier, is a keyword, or is longer than 64 characters.
    """
    plain = isinstance(name, str) and name.isascii() and name.isidentifier() and not keyword.iskeyword(name)
    plain = plain and name != "__debug__"  # a constant to Python's compiler, whatever its syntax says
    if not plain or len(name) > LONGEST_NAME:
        shown = repr(name) if len(str(name)) <= LONGEST_NAME else f"{str(name)[:20]!r}... ({len(str(name))} characters)"
        raise InputError(
            f"{what} {shown} is not a plain name: expected an ASCII letter or underscore followed by letters, digits "
            f"or underscores, no Python keyword, at most {LONGEST_NAME} characters"
        )


def free_name(name: str, taken: Collection[str]) -> str:
    """Return a name, with the first number from 2 on that makes it one that is not taken."""
    found, number = name, 1
    while found in taken:
        number += 1
        found = f"{name}_{number}"
    return found


class Coordinate(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A measured quantity and the order of its equation: a position has order 2, a concentration order 1.

    `angle`: in radians, unwrapped, enters the basis as sin and cos; `cyclic`: does not itself enter the equations. What
    is read of it is `offset` more than the coordinate itself.
    """

    name: str
    order: int = 1
    angle: bool = False
    cyclic: bool = False
    unit: str | None = None
    offset: float = 0.0

    def __post_init__(self) -> None:
        check_name(self.name, "coordinate")
        if isinstance(self.order, bool) or self.order not in range(1, HIGHEST_ORDER + 1):
            raise InputError(
                f"coordinate {self.name!r}: order must be a whole number from 1 to {HIGHEST_ORDER}, got {self.order!r}"
            )
        if not math.isfinite(self.offset):
            raise InputError(f"coordinate {self.name!r}: offset must be a number, got {self.offset!r}")

    def derivative(self, k: int) -> str:
        """Return the name of the k-th derivative: x, x_dot, x_ddot, x_dddot."""
        return f"{self.name}_{'d' * k}ot" if k else self.name

    @property
    def states(self) -> tuple[str, ...]:
        """The names of the derivatives below the order."""
        return tuple(self.derivative(k) for k in range(self.order))

    @property
    def target(self) -> str:
        """The name of the derivative that the equation gives."""
        return self.derivative(self.order)


class Input(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A quantity that drives the system, and how it runs between samples: linearly, held ("zero" order), band-limited.

    It acts `delay` seconds after it was recorded.
    """

    name: str
    hold: Hold = "linear"
    unit: str | None = None
    delay: float = 0.0

    def __post_init__(self) -> None:
        check_name(self.name, "input")
        if self.hold not in get_args(Hold):
            expected = ", ".join(map(repr, get_args(Hold)))
            raise InputError(f"input {self.name!r}: hold must be one of {expected}, got {self.hold!r}")
        if not math.isfinite(self.delay):
            raise InputError(f"input {self.name!r}: delay must be a number of seconds, got {self.delay!r}")

    @property
    def is_time(self) -> bool:
        """Whether this is the time itself, of a library that names it."""
        return self.name == TIME and self.unit == "s"


def state_names(coordinates: Sequence[Coordinate]) -> tuple[str, ...]:
    """Return the states of these coordinates: values first, then first derivatives, and so on."""
    highest = max(c.order for c in coordinates)
    return tuple(c.derivative(k) for k in range(highest) for c in coordinates if c.order > k)


def state_chain(coordinates: Sequence[Coordinate]) -> dict[str, str]:
    """Return of every state, in the order of `state_names`, the name of its derivative: a state, or a target."""
    after = {c.derivative(k): c.derivative(k + 1) for c in coordinates for k in range(c.order)}
    return {state: after[state] for state in state_names(coordinates)}


def following_states(coordinates: Sequence[Coordinate]) -> IntArray:
    """Return `state_chain` in numbers: for each state that of its derivative, or -1 - (number of its target)."""
    chain = state_chain(coordinates)
    number = {state: k for k, state in enumerate(chain)} | {c.target: -1 - k for k, c in enumerate(coordinates)}
    return np.array([number[name] for name in chain.values()], dtype=np.int64)
