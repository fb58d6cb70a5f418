"""Moves of a structure search: a mechanism is added, dropped, or gone round to see whether it holds another's place."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Protocol

import numpy as np

from odescope.arrays import FloatArray, IntArray
from odescope.library.mechanism import scale_groups
from odescope.likelihood.division import divided
from odescope.likelihood.evidence import project
from odescope.likelihood.exchange import foreseen, refitted, rise
from odescope.likelihood.expansion import Expansion
from odescope.likelihood.families import best_on_grid
from odescope.likelihood.fit import Fit
from odescope.likelihood.fit_without import fit_without
from odescope.likelihood.linear_relations import by_least_squares
from odescope.likelihood.search_space import Move, SearchSpace
from odescope.likelihood.smoothed_targets import singular
from odescope.likelihood.subsets import subsets

LOOK_ALIKE = 40.0  # times its penalty: a mechanism that earns more is in its place
DETOUR = 6  # additions and drops until a search without a mechanism has to be better than that with it
SHOWN = 2  # steps of a fit begun anew after which it is better
GAIN = 0.5  # fall of the penalised cost that makes it better: fits are no more accurate than this
FAR_FROM_DONE = 100.0  # times as much a delay or an offset has to earn as a term, where a model lacks most
UNEVEN = 3  # mechanisms, at most, that are tried at a time although their scores differ between blocks
POLE = 1e12  # more than any cost: what has a pole loses to all that has none
HOPELESS = 10.0  # times the cost before: a detour that stands there is given up


class Judge(Protocol):
    """Says by what statistics mechanisms come and go."""

    @property
    def trials(self) -> int:
        """Mechanisms tried by refitting before a move is given up."""

    @property
    def binding(self) -> bool:
        """Whether a statistic decides alone and once: what was dropped or refused does not come back.

        Otherwise the penalised cost of the refit decides.
        """

    def wald(self, here: Fit) -> FloatArray | None:
        """Return the Wald statistics (p,) of the parameters, None where there are none to be had."""

    def scores(self, here: Fit) -> FloatArray | None:
        """Return the score statistics (mechanisms,) of the absent mechanisms, 0 for the others."""


@dataclass(frozen=True, eq=False)
class Moves:
    """Moves at one size of the defects.

    Attributes:
        space: data and candidates.
        judge: see there.
        width: of the defects, in smoothing errors of each state.
        scale: residual variance, the unit of costs and statistics.
        trail: collects the moves that were made.
        barred: mechanisms that may not come (back).
        unsure: mechanisms that were not sure beside all others: in the place of one they may be.
    """

    space: SearchSpace
    judge: Judge
    width: float
    scale: float
    trail: list[Move]
    barred: set[int] = field(default_factory=set)
    unsure: set[int] = field(default_factory=set)

    @property
    def defect_std(self) -> FloatArray:
        """Standard deviations of the defects, (n,)."""
        return self.space.segments.spread * self.width

    def penalised(self, found: Fit) -> float:
        """Cost and the penalties of the parameters; of a pole where none may be, too."""
        pole = POLE if self.space.no_poles and singular(self.space, found) else 0.0
        return found.cost / self.scale + self.space.price(found) + pole

    def limit(self, here: Fit, present: IntArray, theta: FloatArray) -> float:
        """Return the cost above which a fit of other mechanisms is worth less than the one at hand.

        Infinite where a statistic decides, not the cost.

        Args:
            here: the fit at hand.
            present: numbers of the mechanisms.
            theta: (mechanisms,) coefficients to begin with.
        """
        if self.judge.binding:
            return np.inf
        penalty, alive = self.space.penalty, self.space.alive(present, theta)
        return here.cost + self.scale * float(penalty[here.present].sum() - penalty[alive].sum())

    def without(self, here: Fit, k: int, limit: float | None = None) -> Fit | None:
        """Return the fit without a present mechanism; it ends early where it will be of no use.

        Args:
            here: the fit with it.
            k: its number.
            limit: the cost above which it is of no use, where that is not what makes it worth less.
        """
        theta = here.theta.copy()
        theta[k] = 0.0
        limit = self.limit(here, here.present[here.present != k], theta) if limit is None else limit
        return fit_without(self.space, here, k, self.defect_std, limit=limit)

    def having(self, here: Fit, k: int, begin: Mapping[int, float]) -> Fit | None:
        """Return the fit with an absent mechanism; it ends early where it will be worth less than without.

        Args:
            here: the fit without it.
            k: its number.
            begin: coefficients to begin with, by number.
        """
        present: IntArray = np.union1d(here.present, [k])
        theta = here.theta.copy()
        theta[[*begin]] = [*begin.values()]
        limit = self.limit(here, present, theta)
        return self.space.fit(theta, present, here.x0, self.defect_std, here.strength, limit=limit)

    def begin_anew(self, here: Fit) -> Fit | None:
        """Fit from the coefficients that the linear relations have at the smoothed states, where that is better.

        Where it is, a step or two show it.
        """
        theta = by_least_squares(self.space, here)
        if theta is None:
            return None
        trial = self.space.fit(theta, here.present, self.space.segments.initial, self.defect_std, iterations=SHOWN)
        if trial is None or self.penalised(trial) >= self.penalised(here) - GAIN:
            return None
        return self.space.again(trial, trial.x0, self.defect_std)

    def divide(self, here: Fit) -> Fit | None:
        """Divide a relation by a function, or multiply it, where that makes it simpler and is no worse."""
        theta = divided(self.space, here)
        if theta is None:
            return None
        trial = self.space.fit(theta, np.flatnonzero(theta), here.x0, self.defect_std)
        if trial is None or self.penalised(trial) >= self.penalised(here):
            return None
        for k in np.setxor1d(trial.present, here.present).tolist():
            self._note("divide" if k in trial.present else "drop", k, 0.0, trial)
        return trial

    def drop(self, here: Fit) -> Fit | None:
        """Drop a mechanism that is not worth its penalty; of look-alikes that are worthless together, only one is."""
        wald = self._wald(here)
        if wald is None:
            return None
        penalty = self.space.penalty[here.free] + self.space.bound_to(here)
        for weak in np.argsort(wald - penalty)[: 1 if self.judge.binding else self.judge.trials]:
            if wald[weak] >= penalty[weak]:
                return None
            k = int(here.free[weak])
            trial = self.without(here, k)
            if trial is not None and (self.judge.binding or self.penalised(trial) <= self.penalised(here)):
                self._note("drop", k, float(wald[weak]), trial)
                if self.judge.binding:
                    self.barred.add(k)
                return trial
        return None

    def add(self, here: Fit) -> Fit | None:
        """Add a mechanism that is worth its penalty."""
        scores = self.judge.scores(here)
        if scores is None:
            return None
        on_grid, begin = best_on_grid(self.space, here, scores, self.defect_std)
        # Where a statistic decides alone it is checked against the spread between blocks, at nominal constants.
        scores = (np.minimum(scores, on_grid) if self.judge.binding else on_grid) / self.scale
        scores[[*self.barred, *self.space.needed.values()]] = 0.0
        earned = scores - self.space.penalty
        if self.scale > HOPELESS:  # a model that lacks most asks for delays and offsets that stand for terms
            earned[[k for k, m in enumerate(self.space.mechanisms) if not m.parts]] /= FAR_FROM_DONE
        for k in np.argsort(earned)[::-1][: self.judge.trials].tolist():
            if earned[k] < 0.0:
                return None
            trial = self.having(here, k, begin.get(k, {}))
            if trial is not None and self.penalised(trial) < self.penalised(here):
                self._note("add", k, float(scores[k]), trial)
                return trial
            if self.judge.binding:
                self.barred.add(k)
        return None

    def add_uneven(self, here: Fit, scores: FloatArray) -> Fit | None:
        """Add a mechanism that is worth its penalty but for the spread between blocks, if the refit is sure of it.

        What it would explain differs from block to block, as its size does: that is in the spread of its score, and no
        longer in that of its coefficient.

        Args:
            here: the fit with those that are present.
            scores: (mechanisms,) statistics of the absent ones that are not checked against blocks.
        """
        earned = scores / self.scale - self.space.penalty
        earned[[*self.barred, *self.unsure, *self.space.needed.values()]] = -np.inf
        for k in np.argsort(earned)[::-1][:UNEVEN].tolist():
            if earned[k] < 0.0:
                return None
            trial = self.having(here, k, {})
            if trial is not None and self.penalised(trial) < self.penalised(here) and not self._weak(trial):
                self._note("add", k, float(scores[k]), trial)
                return trial
            self.unsure.add(k)
        return None

    def leap(self, here: Fit, expansion: Expansion | None) -> Fit | None:
        """Make at once the additions and drops that the expansion of the cost foresees, where the refit is better.

        None where they are less than two: such a move is made by itself.

        Args:
            here: the fit with those that are present.
            expansion: of its cost with all candidates.
        """
        space, free = self.space, self.space.free(here)
        if expansion is None or not expansion.finite:
            return None
        # An offset turns sines into cosines: what imitates it would take several places.
        plain = [k for k, m in enumerate(space.mechanisms) if m.parts or m.kind == "offset"]
        able = np.array([k in plain and space.mechanisms[k].names.isdisjoint(space.needed) for k in free.tolist()])
        present, theta = np.isin(free, here.free), here.theta.copy()
        kept = foreseen(expansion, theta[free], present, able, space.penalty[free], self.scale)
        moved = free[kept != present]
        if len(moved) < 2:
            return None
        again = refitted(expansion, theta[free], np.flatnonzero(kept))
        if again is None:
            return None
        theta[free] = again
        trial = space.fit(theta, np.union1d(free[kept], here.held), here.x0, self.defect_std, here.strength)
        if trial is None or self.penalised(trial) >= self.penalised(here) - GAIN:
            return None
        self._note_all(here, trial)
        return trial

    def look_back(self, here: Fit) -> Fit | None:
        """Return the end of a search that a thin mechanism is barred from, if it is better.

        A mechanism that came early may hold the place of another, or with others that of several; once it is gone, the
        scores of the right ones stand out.
        """
        wald = self.judge.wald(here)
        if wald is None:
            return None
        held = [(self._together(here, wald, k), k) for k in here.held.tolist() if not self.space.stays(k)]
        free = zip((wald / self.scale).tolist(), here.free.tolist(), strict=True)
        for statistic, k in sorted([(w, k) for w, k in free if k not in self.space.needed.values()] + held):
            if statistic > LOOK_ALIKE * self.space.penalty[k]:
                return None
            detour = replace(self, trail=[], barred={k})
            there = detour.without(here, k, limit=HOPELESS * here.cost)
            if there is not None:
                detour._note("drop", k, statistic, there)
            for _ in range(DETOUR):
                if there is None or there.cost > HOPELESS * here.cost or self.space.budget.over:
                    break
                if self.penalised(there) < self.penalised(here) - GAIN:
                    self.trail.extend(detour.trail)
                    return there
                there = detour.drop(there) or detour.add(there)
        return None

    def exchange(self, here: Fit, expansion: Expansion | None) -> Fit | None:
        """Put an absent mechanism in the place of one or two present ones, where that is better.

        Two may add up to a third so nearly that beside each other they are sure and the third has no score. Where a
        statistic decides alone, it has to be for all that are then present.

        Args:
            here: the fit with those that are present.
            expansion: of its cost with all candidates.
        """
        space, free = self.space, self.space.free(here)
        if expansion is None or not expansion.finite:
            return None
        present = np.isin(free, here.free)
        rest = project(expansion.information, expansion.gradient[None], present)
        now, new = free[present], free[~present]
        prices = space.penalty[now] + space.bound_to(here)
        paid = prices[:, None] + prices - np.diag(prices)
        change = rise(rest, here.theta[now] * rest.scale[present]) / self.scale
        earned = paid - space.penalty[new][:, None, None] - change
        earned[np.isin(new, [*self.barred])] = -np.inf
        for place in np.argsort(earned, axis=None)[::-1][: self.judge.trials]:
            k, *pair = np.unravel_index(place, earned.shape)
            if not earned[(k, *pair)] > GAIN:
                return None
            trial = self.exchanged(here, expansion, now[pair], int(new[k]))
            if trial is not None and self.penalised(trial) < self.penalised(here) - GAIN:
                self._note_all(here, trial)
                return trial
        return None

    def exchanged(self, here: Fit, expansion: Expansion, gone: IntArray, came: int) -> Fit | None:
        """Return the fit with one mechanism in the place of others, None where it is lost or some statistic too small.

        Args:
            here: the fit with those that are present.
            expansion: of its cost with all candidates.
            gone: numbers of those that go.
            came: number of the one that comes.
        """
        space, free = self.space, self.space.free(here)
        kept = np.union1d(np.setdiff1d(here.free, gone), came)
        theta, again = here.theta.copy(), refitted(expansion, here.theta[free], np.searchsorted(free, kept))
        if again is None:
            return None
        theta[free] = again
        trial = space.fit(theta, np.union1d(kept, here.held), here.x0, self.defect_std, here.strength)
        return None if trial is None or (self.judge.binding and self._weak(trial)) else trial

    def substitute(self, here: Fit, expand: Callable[[Fit], Expansion | None]) -> Fit | None:
        """Put a few mechanisms in the place of all that a relation has beside its target, where that is better.

        Several may add up to one or two others so nearly that beside them these have no score. Where a statistic
        decides alone, it has to be sure of all that are then present.

        Args:
            here: the fit with those that are present.
            expand: returns the expansion of the cost about a fit, with all candidates.
        """
        space, found = self.space, self.space.held_by_targets(here)
        free, expansion = space.free(found), expand(found)
        if expansion is None or not expansion.finite:
            return None
        present = np.isin(free, found.free)
        for relation in range(space.relations):
            own = np.array([self._stands_alone(k, relation, here) for k in free.tolist()])
            sets = subsets(expansion, found.theta[free], present, own, space.penalty[free], self.scale)
            for among in (members for earned, members in sets[: self.judge.trials] if earned > GAIN):
                kept = np.union1d(np.flatnonzero(present & ~own), among)
                again = refitted(expansion, found.theta[free], kept)
                if again is None:
                    continue
                theta = found.theta.copy()
                theta[free] = again
                trial = space.fit(theta, np.union1d(free[kept], found.held), here.x0, self.defect_std)
                if trial is None or (self.judge.binding and self._weak(trial)):
                    continue
                if self.penalised(trial) < self.penalised(here) - GAIN:
                    self._note_all(here, trial)
                    return trial
        return None

    def _stands_alone(self, k: int, relation: int, here: Fit) -> bool:
        """Say whether a mechanism may be put in the place of a relation's, or go for others.

        Where a combination of states stays constant, the target times that is nothing: no such term comes.
        """
        mechanism = self.space.mechanisms[k]
        plain = all(p.product.factor is None for p in mechanism.parts) or k in here.present
        own = mechanism.relations == {relation} and mechanism.names.isdisjoint(self.space.needed)
        return own and plain and k not in self.barred

    def _wald(self, here: Fit) -> FloatArray | None:
        """Return the Wald statistics (p,) in units of the residual variance, infinite for what has to stay."""
        wald, needed = self.judge.wald(here), np.isin(here.free, [*self.space.needed.values()])
        return None if wald is None else np.where(needed, np.inf, wald / self.scale)

    def _weak(self, here: Fit) -> bool:
        """Say whether a mechanism is not worth its penalty, or there is no telling."""
        wald = self._wald(here)
        return wald is None or bool(np.any(wald < self.space.penalty[here.free] + self.space.bound_to(here)))

    def _together(self, here: Fit, wald: FloatArray, held: int) -> float:
        """Return the Wald statistic of a held coefficient: that of the best known of its group, which could be held."""
        group = next(g for g in scale_groups(self.space.mechanisms, here.present) if held in g)
        return float(wald[np.isin(here.free, group)].max(initial=0.0)) / self.scale

    def _note_all(self, before: Fit, after: Fit) -> None:
        """Note all that came and went, with what was or is known of it."""
        for action, one, other in (("drop", before, after), ("add", after, before)):
            for k in np.setdiff1d(one.present, other.present).tolist():
                self._note(action, k, float(one.strength[k]) / self.scale, after)

    def _note(self, action: str, k: int, statistic: float, after: Fit) -> None:
        self.trail.append(self.space.move(self.width, action, k, statistic, after))
