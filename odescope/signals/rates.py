"""Velocities that are measured beside positions: which quantity is the rate of which, and what to do about it."""

from __future__ import annotations

from collections.abc import Iterator

from odescope.arrays import FloatArray
from odescope.errors import InputError
from odescope.recordings.coordinate import Coordinate
from odescope.signals.estimate import Signals

CERTAIN = 0.02  # of the slope, and of the variance: a rate that is so near is no quantity of its own


def slope_and_share(rate: FloatArray, given: FloatArray) -> tuple[float, float]:
    """Return the slope of a rate (n,) on a quantity (n,), and the part of its variance that this explains."""
    slope = float(rate @ given) / max(float(given @ given), 1e-300)
    return slope, explained(rate, slope * given)


def explained(values: FloatArray, prediction: FloatArray) -> float:
    """Return the part of the variance of values (n,) that a prediction (n,) explains."""
    spread = values - values.mean()
    power, left = float(spread @ spread), values - prediction
    return 1.0 - float(left @ left) / power if power > 0.0 else 0.0


def rates_given(signals: Signals, near: float) -> Iterator[tuple[Coordinate, Coordinate]]:
    """Yield each coordinate with one that is its rate, in the same unit, to within a part of it."""
    joined = signals.joined()
    for c in signals.coordinates:
        rate = joined[signals.row(c.derivative(1))]
        for other in signals.coordinates:
            if other.name != c.name:
                slope, share = slope_and_share(rate, joined[signals.row(other.name)])
                if abs(slope - 1.0) < near and share > 1.0 - near:
                    yield c, other


def refuse_rates(signals: Signals) -> None:
    """Refuse a coordinate that is the velocity of another whose equation has velocities of its own.

    Raises:
        InputError: there is one.
    """
    for c, other in rates_given(signals, CERTAIN):
        if c.order > 1:
            raise InputError(f"{other.name} is the rate of {c.name}: {how_to_give(other.name, c.name, c.order)}")


def how_to_give(rate: str, name: str, order: int) -> str:
    """Return what to write where a quantity of some order is measured with its rate.

    Args:
        rate: what its column is called.
        name: of the quantity.
        order: of its equation.
    """
    return (
        f"of order {order}, {name} has its rate for a state already, found with the model, and coordinates alone are"
        f" compared with the log. Leave {rate} out; or, so that both measurements count, give both order = 1"
    )
