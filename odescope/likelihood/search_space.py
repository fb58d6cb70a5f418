"""What a structure search works on: data, candidate mechanisms, their penalties, and fits of some of them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from odescope.arrays import FloatArray, IntArray
from odescope.library.constants import Constant, mechanism_at
from odescope.library.expression import Term
from odescope.library.mechanism import Mechanism, Part, scale_groups
from odescope.library.product import Product
from odescope.library.tape import evaluate, write_tape
from odescope.likelihood.budget import Budget
from odescope.likelihood.evaluator import Evaluator
from odescope.likelihood.fit import CONVERGED, ITERATIONS, Fit, fit
from odescope.likelihood.gauge import held_of, rechosen
from odescope.likelihood.layers import MOST_STEPS, STABLE
from odescope.likelihood.program import Frame, Program
from odescope.likelihood.segments import Segments
from odescope.likelihood.settings import FoundSettings, settings_of, values_of
from odescope.model.assembled import relations_of, stated, sureness
from odescope.model.relation import FoundMechanism, Relation
from odescope.selection.criterion import penalty

RARER = 2.0  # a product with one factor more is half as likely
GROWN = 10.0  # times as large: coefficients that run off beside one that is held and may be nothing
GAUGES = 3  # fits, at most, each with what the one before knew best held
BARE = 10.0  # times as large in all: a bare target is held at first unless what multiplies the target otherwise is so


@dataclass(frozen=True)
class Move:
    """One step of the trail: the score or Wald statistic that asked for it, the penalty of its mechanism, the cost.

    `width` is the size of the defects that the step was made at, in smoothing errors of each state.
    """

    width: float
    action: str
    mechanism: Mechanism
    statistic: float
    penalty: float
    cost: float


@dataclass(frozen=True, eq=False)
class SearchSpace:
    """Everything a search needs that does not change on the way.

    `zeros_are_off` says whether the zeros of inputs are as likely off as not: under noise of the process, which hides
    them. Elsewhere a constant is a term like any other. With `no_poles` no model counts whose denominators pass zero.
    """

    evaluator: Evaluator
    mechanisms: tuple[Mechanism, ...]
    frame: Frame
    zeros_are_off: bool = False
    no_poles: bool = False

    @property
    def segments(self) -> Segments:
        """The data."""
        return self.evaluator.segments

    @property
    def budget(self) -> Budget:
        """What the search may cost."""
        return self.evaluator.budget

    @property
    def relations(self) -> int:
        """Number of relations."""
        return len(self.frame.targets)

    @cached_property
    def known(self) -> IntArray:
        """Mechanisms whose coefficients are given: present throughout, and no parameters."""
        return np.array([k for k, m in enumerate(self.mechanisms) if m.known is not None], dtype=np.int64)

    @cached_property
    def shared(self) -> bool:
        """Whether mechanisms stand in several relations: what regression says of one by itself is then little."""
        return any(len(m.relations) > 1 for m in self.mechanisms)

    def stays(self, k: int) -> bool:
        """Say whether a mechanism is there by default: what is known, or a relation's own target, bare."""
        return self.mechanisms[k].known is not None or self.frame.own(self.mechanisms[k])

    @cached_property
    def zeros(self) -> IntArray:
        """Constants where an input may stand by itself: its zero."""
        parts = (p for m in self.mechanisms for p in m.parts)
        driven = {p.relation for p in parts if p.product.text in self.frame.inputs}
        constant = (m.relations <= driven and {p.product for p in m.parts} == {Product(None)} for m in self.mechanisms)
        return np.array([k for k, zero in enumerate(constant) if zero], dtype=np.int64)

    @cached_property
    def penalty(self) -> FloatArray:
        """What each mechanism has to earn as a parameter (mechanisms,), see `selection.criterion`.

        Every factor of a product divides the prior by RARER: noise often leaves it to a hair which of two look-alikes
        fits better, and laws are simple. All shares together are 1 but for the bare targets, one of which is there
        anyway, so the penalty is 2 ln(candidates) on the whole.
        """
        share = RARER ** -np.array([m.size for m in self.mechanisms], dtype=np.float64)
        choice = [not self.stays(k) for k in range(len(self.mechanisms))]
        share /= share[choice].sum()
        if self.zeros_are_off:
            share[self.zeros] = 0.5  # off or not
        found: FloatArray = penalty(self.segments.samples, share)
        found[self.known] = 0.0
        return found

    @cached_property
    def _least(self) -> float:
        """The penalty of the simplest mechanism that can hold the scale of a group."""
        return min((float(self.penalty[k]) for k in self._scaling if k not in self.known), default=0.0)

    @cached_property
    def _scaling(self) -> list[int]:
        """Mechanisms that hold a target."""
        return [k for k, m in enumerate(self.mechanisms) if any(p.product.factor is not None for p in m.parts)]

    def price(self, found: Fit) -> float:
        """Return the penalties of a fit, that of one mechanism a scale group apart: its coefficient is no parameter."""
        groups = len(np.setdiff1d(found.held, self.known))
        return float(self.penalty[found.present].sum()) - groups * self._least

    @cached_property
    def whole(self) -> Program:
        """The program of all mechanisms."""
        return Program.of(self.mechanisms, self.frame)

    def free(self, found: Fit) -> IntArray:
        """Return the mechanisms whose coefficients are or may become parameters beside those that a fit holds."""
        return np.setdiff1d(np.arange(len(self.mechanisms)), np.union1d(found.held, self.known))

    def on(self, segments: Segments) -> SearchSpace:
        """Return the space for other segments."""
        return replace(self, evaluator=Evaluator(segments, self.evaluator.substeps, self.budget))

    def among(self, mechanisms: Sequence[Mechanism]) -> SearchSpace:
        """Return the space with other candidates."""
        return replace(self, mechanisms=tuple(mechanisms))

    def within(self, budget: Budget) -> SearchSpace:
        """Return the space with another budget."""
        return replace(self, evaluator=Evaluator(self.segments, self.evaluator.substeps, budget))

    def finer(self, substeps: int) -> SearchSpace:
        """Return the space with so many steps of RK4 a sample."""
        return replace(self, evaluator=Evaluator(self.segments, substeps, self.budget))

    def fixed_constants(self, found: Fit) -> list[str]:
        """Return the constants within functions that a fit depends on and does not adjust, by name."""
        present = [self.mechanisms[k] for k in found.present]
        free = {m.place for m in present if m.kind == "constant"}
        return [name for name in self.frame.constants if name not in free and any(name in m.names for m in present)]

    def with_constants(self, constants: Mapping[str, Constant]) -> SearchSpace:
        """Return the space with others in the place of some constants."""
        return replace(self, frame=replace(self.frame, constants={**self.frame.constants, **constants}))

    def program(self, present: IntArray) -> Program:
        """Return the program of these mechanisms alone."""
        return Program.of(tuple(self.mechanisms[k] for k in present), self.frame)

    def too_narrow(self, found: Fit) -> bool:
        """Return whether dry friction stops what slides faster than the steps of RK4 can be made short."""
        decay = self.program(found.present).decay(found.theta[found.present])
        return decay * self.evaluator.segments.step / STABLE >= MOST_STEPS

    def move(self, width: float, action: str, k: int, statistic: float, after: Fit) -> Move:
        """Return the step of the trail that did something to mechanism k.

        Args:
            width: of the defects, in smoothing errors.
            action: what was done.
            k: the mechanism's number.
            statistic: that asked for it.
            after: the fit after it.
        """
        return Move(width, action, self.mechanisms[k], statistic, float(self.penalty[k]), after.cost)

    def fit(
        self,
        theta: FloatArray,
        present: IntArray,
        x0: FloatArray,
        defect_std: FloatArray,
        strength: FloatArray | None = None,
        iterations: int = ITERATIONS,
        tolerance: float = CONVERGED,
        limit: float = np.inf,
    ) -> Fit | None:
        """Return the fit of the present mechanisms; only they are on the tape.

        Args:
            theta: (mechanisms,) coefficients to begin with.
            present: numbers of the mechanisms in the model, ascending: an absent one may become present at 0.
            x0: (J, n) initial states to begin with.
            defect_std: (n,) standard deviations of the defects between segments.
            strength: (mechanisms,) which coefficients are to be held first; by default those of large contributions.
            iterations: steps at most.
            tolerance: fall of the cost that ends it.
            limit: a cost above which the fit is of no use.
        """
        present = self.alive(present, theta)
        held = held_of(self.mechanisms, present, self._size(theta) if strength is None else strength)
        program, found = self.program(present), None
        for _ in range(GAUGES):
            places = np.searchsorted(present, held)
            there = fit(self.evaluator, program, theta[present], places, x0, defect_std, iterations, tolerance, limit)
            if there is None:
                break  # beside a pole rounding decides whether the same relations can be followed in another gauge
            whole = np.zeros(len(self.mechanisms))
            whole[present] = there.theta
            found = replace(there, theta=whole, present=present, held=held)
            grown = np.abs(there.theta).max() > GROWN * np.abs(theta[present]).max()
            if iterations > 0 and not (found.converged or grown):
                break  # on its way: what it says of how well coefficients are known is about to change
            better = rechosen(self.mechanisms, present, held, whole, found.information, self._size(whole))
            if np.array_equal(better, held):
                break
            theta, held, x0 = self._rescaled(whole, better), better, found.x0
        return found

    def alive(self, present: IntArray, theta: FloatArray) -> IntArray:
        """Return the present mechanisms with the constants that they need, less settings that say nothing any more.

        No present term names these, or a constant is where it would be without its mechanism.
        """
        names = frozenset[str]().union(*(self.mechanisms[k].names for k in present))
        needed = [k for name, k in self.needed.items() if name in names]
        alive = []
        for k in np.union1d(present, np.array(needed, dtype=np.int64)).tolist():
            mechanism = self.mechanisms[k]
            sharp = mechanism.kind == "constant" and mechanism.place not in self.needed and theta[k] < 0.0
            if mechanism.parts or (mechanism.place in names and not sharp):
                alive.append(k)
        return np.array(alive, dtype=np.int64)

    @cached_property
    def needed(self) -> dict[str, int]:
        """The mechanisms of the constants that are parameters wherever a term names them, by name."""
        return {
            m.place: k
            for k, m in enumerate(self.mechanisms)
            if m.kind == "constant" and not self.frame.constants[m.place].optional
        }

    def bound_to(self, found: Fit) -> FloatArray:
        """Return the penalties (p,) of the constants that would go with each parameter of a fit."""
        names = [self.mechanisms[k].names for k in found.present]
        own = np.zeros(len(found.free))
        for name, k in self.needed.items():
            holding = [j for j, named in zip(found.present.tolist(), names, strict=True) if name in named]
            if len(holding) == 1:
                own[found.free == holding[0]] += self.penalty[k]
        return own

    def _rescaled(self, theta: FloatArray, held: IntArray) -> FloatArray:
        """Return coefficients (mechanisms,) of the same relations, with the held ones at 1."""
        again = theta.copy()
        for group in scale_groups(self.mechanisms, np.flatnonzero(theta)):
            for k in set(group) & set(held.tolist()):
                if self.mechanisms[k].known is None:
                    again[list(group)] = theta[list(group)] / theta[k]
        return again

    def held_by_targets(self, found: Fit) -> Fit:
        """Return a fit with the bare targets held where they are present; what it says of others' errors is no more."""
        held, known = set(found.held.tolist()), set(self.known.tolist())
        for group in scale_groups(self.mechanisms, found.present):
            target = next((k for k in group if self.frame.own(self.mechanisms[k])), None)
            if target is not None and known.isdisjoint(group):
                held = (held - set(group)) | {target}
        ordered = np.array(sorted(held), dtype=np.int64)
        if np.array_equal(ordered, found.held):
            return found
        return replace(found, theta=self._rescaled(found.theta, ordered), held=ordered)

    def begin(self, theta: FloatArray, defect_std: FloatArray) -> Fit | None:
        """Return the fit of what has a coefficient, from the smoothed states.

        Args:
            theta: (mechanisms,) coefficients to begin with.
            defect_std: (n,) standard deviations of the defects between segments.
        """
        return self.fit(theta, np.flatnonzero(theta), self.segments.initial, defect_std)

    def again(self, found: Fit, x0: FloatArray, defect_std: FloatArray, iterations: int = ITERATIONS) -> Fit | None:
        """Return the fit of the same structure from other initial states or with other defects.

        Args:
            found: where it begins.
            x0: (J, n) initial states to begin with.
            defect_std: (n,) standard deviations of the defects between segments.
            iterations: steps at most.
        """
        return self.fit(found.theta, found.present, x0, defect_std, found.strength, iterations)

    @cached_property
    def _root_mean_squares(self) -> FloatArray:
        """Root mean squares of what multiplies a target in each mechanism, over the smoothed states (mechanisms,)."""
        found = np.zeros(len(self.mechanisms))
        parts = [(k, p) for k in self._scaling for p in self.mechanisms[k].parts if p.product.factor is not None]
        evaluated = self.evaluated([p.product.term for _, p in parts], np.zeros(len(self.mechanisms)))
        for (k, part), values in zip(parts, evaluated, strict=True):
            found[k] = max(found[k], abs(part.share) * float(np.sqrt(np.mean(values**2))))
        found[[k for k in self._scaling if self.frame.own(self.mechanisms[k])]] *= BARE
        return found

    def evaluated(self, terms: Sequence[Term], theta: FloatArray) -> FloatArray:
        """Return centred terms over the smoothed states (terms, N), constants as of coefficients (mechanisms,)."""
        segments, constants = self.segments, self.whole.constants(theta)
        centred = [self.frame.centring.centred(t) for t in terms]
        tape = write_tape([*self.frame.variables, *self.frame.constants], centred)
        fixed = np.tile(constants, (len(segments.filtered), 1))
        columns = np.ascontiguousarray(np.hstack([segments.filtered, segments.inputs[:, 0], fixed]).T)
        return evaluate(tape, columns)

    def _size(self, theta: FloatArray) -> FloatArray:
        """Return how much of the inertia each mechanism makes, (mechanisms,)."""
        size: FloatArray = np.abs(theta) * self._root_mean_squares
        return size

    @cached_property
    def numbers(self) -> dict[tuple[Part, ...], int]:
        """The number of every mechanism, by its parts."""
        return {m.parts: k for k, m in enumerate(self.mechanisms)}

    def relations_of(self, found: Fit, covariance: FloatArray) -> tuple[Relation, ...]:
        """Return the relations of a fit, with numbers for constants.

        Args:
            found: the fit.
            covariance: (p, p) of its parameters.
        """
        return relations_of(*self._with_numbers(found, covariance), self.frame.targets)

    def mechanisms_of(self, found: Fit, covariance: FloatArray) -> tuple[FoundMechanism, ...]:
        """Return the mechanisms of a fit, plain candidates left out.

        Args:
            found: the fit.
            covariance: (p, p) of its parameters.
        """
        return stated(*self._with_numbers(found, covariance))

    def sureness_of(self, found: Fit, covariance: FloatArray) -> tuple[float | None, ...]:
        """Return how many standard errors each present mechanism is from zero, as it is stated to people.

        None where no error is stated. In a scale other than that of the statement the number would be another.

        Args:
            found: the fit.
            covariance: (p, p) of its parameters.
        """
        present, theta, whole = self._as_found(found, covariance)
        values = values_of(present, theta, whole, self.frame.constants)
        return sureness([mechanism_at(m, values) for m in present], theta, whole, self.frame.targets)

    def settings_of(self, found: Fit, covariance: FloatArray) -> FoundSettings:
        """Return the offsets, delays, constants and holds of a fit.

        Args:
            found: the fit.
            covariance: (p, p) of its parameters.
        """
        driven = self.segments.driven
        holds = {} if driven is None else dict(zip(self.frame.inputs, driven.holds, strict=True))
        return settings_of(*self._as_found(found, covariance), self.frame.constants, holds)

    @np.errstate(invalid="ignore")  # of coefficients of which the data say nothing: their variances are infinite
    def _with_numbers(self, found: Fit, covariance: FloatArray) -> tuple[list[Mechanism], FloatArray, FloatArray]:
        """Return what `_as_found` does, with numbers for constants, and coefficients that are not centred."""
        present, theta, whole = self._as_found(found, covariance)
        values = values_of(present, theta, whole, self.frame.constants)
        centring, known = self.frame.centring, {name: v for name, v in values.items() if v is not None}
        sizes, slopes = centring.sizes(present, known), centring.slopes(present, self.frame.constants, known)
        change = sizes[:, None] * (np.eye(len(present)) + theta[:, None] * slopes)
        return [mechanism_at(m, values) for m in present], sizes * theta, change @ whole @ change.T

    def sizes(self, theta: FloatArray) -> FloatArray:
        """Return by what coefficients (mechanisms,) are multiplied to be those of terms that are not centred."""
        values = dict(zip(self.frame.constants, self.whole.constants(theta).tolist(), strict=True))
        return self.frame.centring.sizes(self.mechanisms, values)

    def _as_found(self, found: Fit, covariance: FloatArray) -> tuple[list[Mechanism], FloatArray, FloatArray]:
        """Return the present mechanisms, their coefficients, and the covariance of all of these."""
        among = np.searchsorted(found.present, found.free)
        whole = np.zeros((len(found.present), len(found.present)))
        whole[np.ix_(among, among)] = covariance
        return [self.mechanisms[k] for k in found.present], found.theta[found.present], whole
