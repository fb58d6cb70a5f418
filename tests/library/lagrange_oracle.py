"""Lagrange's equations a second time: by sympy, from functions of time."""

import numpy as np
import sympy
from mechanics import names_of
from sympy.calculus.euler import euler_equations
from term_oracle import SYMPY, read

TIME = sympy.Symbol("t")


def euler_lagrange(coordinates, kinetic, potential, columns):
    """d/dt T_q' - T_q + V_q, (relations, points), of sums of (weight, text)."""
    motion = {c.name: sympy.Function(c.name, real=True)(TIME) for c in coordinates}
    names = motion | {c.derivative(1): motion[c.name].diff(TIME) for c in coordinates}
    energy = sum(w * read(text, names, SYMPY) for w, text in kinetic)
    energy -= sum(w * read(text, names, SYMPY) for w, text in potential)
    symbols = _symbols(coordinates)
    # The highest derivatives first, before what they are derivatives of is replaced.
    flat = [(motion[c.name].diff(TIME, k), symbols[c.derivative(k)]) for k in (2, 1, 0) for c in coordinates]
    equations = euler_equations(energy, list(motion.values()), TIME)
    return _values([-e.lhs.subs(flat) for e in equations], symbols, columns)


def friction(coordinates, dissipation, columns):
    """R_q', (relations, points), of a sum of (weight, text)."""
    symbols = _symbols(coordinates)
    whole = sum(w * read(text, symbols, SYMPY) for w, text in dissipation)
    return _values([whole.diff(symbols[c.derivative(1)]) for c in coordinates], symbols, columns)


def _symbols(coordinates):
    return {name: sympy.Symbol(name, real=True) for name in names_of(coordinates)}


def _values(expressions, symbols, columns):
    rows = [sympy.lambdify(list(symbols.values()), e, "numpy")(*columns) for e in expressions]
    return np.array([row * np.ones(columns.shape[1]) for row in rows])
