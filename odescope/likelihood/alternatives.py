"""What may stand in the place of what is suspected: functions of a variable, chosen by the likelihood.

docs/method.md, Suspicion.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import chain

import numpy as np

from odescope.library.constants import Constant
from odescope.library.expression import ONE, Name, Term
from odescope.library.families import ACTIVATION
from odescope.library.product import Product
from odescope.library.readable import readable
from odescope.likelihood.add_and_drop import GAIN
from odescope.likelihood.beginnings import EVIDENT
from odescope.likelihood.budget import Budget
from odescope.likelihood.fit import Fit
from odescope.likelihood.function_space import FEW
from odescope.likelihood.held_out import thinned
from odescope.likelihood.imitation import Choice, Imitated, Placed
from odescope.likelihood.look_alikes import TEN_TO_ONE
from odescope.likelihood.noise_or_terms import cost_with_process_noise
from odescope.likelihood.process_noise import Noisy
from odescope.likelihood.refinement import Refinement
from odescope.likelihood.search import Outcome, search
from odescope.likelihood.settings import Start
from odescope.likelihood.sharing import Sharing
from odescope.likelihood.standing import Alternative, Standing
from odescope.likelihood.suspicion import JOINT, MEASURED, Suspicion

RIVALS = {0: 3, 1: 3, 2: 2}  # functions of a suspicion that are fitted, by number of their constants
FAR = 1e3  # times what the record does not know that a function may miss of what the model says, and be fitted
PASSES = 3  # through all suspicions, at most: what is best for one may depend on the others


@dataclass(frozen=True, eq=False)
class _Work(Sharing):
    """The choice of functions."""

    def holds_functions(self, fit: Fit) -> bool:
        """Say whether a model has functions beside the candidates of the one before."""
        return any(k >= self.own and self.space.mechanisms[k].parts for k in fit.present.tolist())

    def least_gain(self, fit: Fit) -> float:
        """Return what a model has to gain by its functions.

        Many functions are tried, and of most variables nothing says beforehand which is theirs. That rates go with
        temperature as Arrhenius has it is known, and a fraction of degrees Celsius, whose zero is anywhere, is no law.
        """
        functions = (self.space.mechanisms[k] for k in fit.present.tolist() if k >= self.own)
        known = (any(n.startswith(f"{ACTIVATION}_") for n in m.names) for m in functions if m.parts)
        return 0.0 if all(known) else EVIDENT

    def exchanged(self, standing: Standing) -> Standing:
        """Return the model with the functions that the likelihood prefers, each tried with the others as they are."""
        price = self.moves().penalised
        for _ in range(PASSES):
            before = standing
            for k in (k for k, s in enumerate(self.suspected) if s.reason not in JOINT):
                for trial in self.trials(standing, k):
                    # Of the functions of a speed Stribeck's curve is known beforehand.
                    least = EVIDENT if standing.placed[k].choice in {c.choice for c in self.curves(k)} else GAIN
                    if trial is not None and price(trial.fit) < price(standing.fit) - least:
                        standing = trial
                    if self.space.budget.over:
                        return standing
            if standing is before:
                break
        return standing

    def plainer(self, standing: Standing) -> Standing:
        """Return the model with variables for their sines, where the record hardly decides between the two.

        The sine of what moves little is a line; so is no other function without constants.
        """
        price = self.moves().penalised
        for k in [k for k in standing.fit.present.tolist() if k >= self.own and self.space.mechanisms[k].parts]:
            part = self.space.mechanisms[k].parts[0]
            for name in self.families:
                split = self.split(part.product.term, name)
                plain = None if split is None else Product(None, split[1] * Term(((Name(name), 1),)))
                other = self.number.get((part.relation, plain)) if plain is not None else None
                if split is None or split[0].term.text != f"sin({name})" or other is None:
                    continue
                theta = standing.fit.theta.copy()
                theta[other], theta[k] = theta[other] + theta[k], 0.0
                fit = self.fitted(theta, standing.fit)
                if fit is not None and price(fit) < price(standing.fit) + TEN_TO_ONE:
                    standing = replace(standing, fit=fit)
                    break
        return standing

    def trials(self, standing: Standing, k: int) -> Iterator[Standing | None]:
        """Yield the model with other functions for one suspicion, those that come nearest to what it says now.

        Beside a constant and the variable itself all smooth functions come near; beside neither the right one does. One
        that saturates soon is a constant but near nothing, where powers that imitate it have another shape: no ranking
        sees it, and beside the variable alone it is told from a constant.
        """
        suspected, fit, said = self.suspected[k], standing.fit, standing.said or standing.fit
        alone = {n for n in self.alone(suspected.relation, fit) if n != suspected.variable}
        wide, line, single = {ONE.text, suspected.variable, *alone}, {suspected.variable, *alone}, self.single(said)
        every, done = [Choice(), *self.linear(k), *self.choices[k]], list[list[int]]()
        for given in (wide.union(single), alone.union(single), wide, alone):
            base = self.base(suspected.relation, fit.theta, given)
            if base not in done:
                done.append(base)
                yield from self.trials_beside(standing, k, base, every)
        saturations = [c for c in self.choices[k] if c.saturates]
        bare = self.base(suspected.relation, fit.theta, line)
        if saturations and bare not in done:
            yield from self.trials_beside(standing, k, bare, saturations)

    def trials_beside(
        self, standing: Standing, k: int, base: list[int], choices: Sequence[Choice]
    ) -> Iterator[Standing | None]:
        """Yield the same beside given terms.

        Args:
            standing: the model as it is.
            k: number of the suspicion.
            base: numbers of the terms.
            choices: what is tried.
        """
        fit, relation = standing.fit, self.suspected[k].relation
        others = [
            self.now(p, fit)
            for j, p in enumerate(standing.placed)
            if j != k and self.suspected[j].relation == relation and self.there(p, relation, fit)
        ]
        imitated = self.imitated(relation, standing.said or fit, base, self.suspected[k].reason in MEASURED)
        if imitated is None:
            return
        bar, said = self.moves().penalised(fit), standing.said or fit
        far = FAR * self.unknown(said, relation, self.suspected[k].reason in MEASURED) if self.exact else np.inf
        plain = [Choice(), *self.linear(k)]
        near = [p for squares, p in imitated.ranked(choices, others) if squares <= far]
        functions = [p for p in near if p.choice not in plain]
        rivals = [[p for p in functions if len(p.choice.constants) == n][:m] for n, m in RIVALS.items()]
        known = [p for p in functions if p.choice.saturates and not any(p in found for found in rivals)]
        for rival in (*(p for p in near if p.choice in plain), *chain.from_iterable(rivals), *known, *self.curves(k)):
            if rival.choice != standing.placed[k].choice:
                yield self.with_rival(standing, k, rival, others, (base, imitated, bar))

    def with_rival(
        self,
        standing: Standing,
        k: int,
        rival: Placed,
        others: Sequence[Placed],
        around: tuple[list[int], Imitated, float],
    ) -> Standing | None:
        """Return the model with a rival for one suspicion, None where it cannot be better.

        Args:
            standing: the model as it is.
            k: number of the suspicion.
            rival: that is tried.
            others: functions that stand in the same relation.
            around: what else stands there, what the relation says by now, and the penalised cost to be below.
        """
        (base, imitated, bar), fit, relation = around, standing.fit, self.suspected[k].relation
        theta = self.written(relation, fit.theta, base, [*others, rival], imitated)
        if theta is None:
            return None
        loose = self.space.segments.spread * np.inf
        trial = self.space.fit(theta, np.flatnonzero(theta), fit.x0, loose, iterations=FEW)
        if trial is None or trial.cost + self.least(trial, relation) > bar:
            return None  # in open segments nothing costs more
        trial = self.tightened(trial.theta, bar + self.space.price(trial) - self.least(trial, relation))
        if trial is None or trial.cost + self.least(trial, relation) > bar:
            return None
        placed = (*standing.placed[:k], rival, *standing.placed[k + 1 :])
        return Standing(self.pruned(trial), placed, standing.said)

    def least(self, fit: Fit, relation: int) -> float:
        """Return the least price that a fit may have without terms of a relation that are no functions."""
        space = self.space
        plain = [k for k in fit.free if k < self.own and relation in space.mechanisms[k].relations]
        return space.price(fit) - float(space.penalty[plain].sum())

    def there(self, placed: Placed, relation: int, fit: Fit) -> bool:
        """Say whether a function is in a relation of the model."""
        return any(self.number[relation, Product(None, t)] in fit.present for t in placed.choice.terms)

    def now(self, placed: Placed, fit: Fit) -> Placed:
        """Return a function with its constants as they were fitted."""
        space = self.space
        return Placed(
            placed.choice,
            {n: space.frame.constants[n].at(float(fit.theta[space.needed[n]])) for n in placed.values},
        )

    def searched(self, standing: Standing) -> Outcome | None:
        """Return where a search with the functions that were chosen ends, over all candidates."""
        theta, mechanisms = standing.fit.theta, self.space.mechanisms
        functions = self.everywhere(standing.fit)
        named = frozenset[str]().union(*(mechanisms[k].names for k in functions))
        constants = [k for name, k in self.space.needed.items() if name in named and k >= self.own]
        kept = np.array([*range(self.own), *functions, *constants])
        space = self.space.among([mechanisms[k] for k in kept])
        outcome = search(replace(space, frame=replace(space.frame, constants=self._constants(named))), theta[kept])
        return None if outcome is None else outcome.padded(kept, len(mechanisms))

    def gain_under_noise(self, process: Noisy, fit: Fit) -> float | None:
        """Return by how much a model with functions is likelier than one without, both with noise of the process.

        Args:
            process: the one without.
            fit: of the one with functions, in segments without it.
        """
        space = self.space.on(thinned(process.space.segments))
        before, after = (cost_with_process_noise(space, t) for t in (self.padded(process.fit.theta), fit.theta))
        return before - after if np.isfinite(before) else None

    def told(
        self, fit: Fit, outcome: Outcome | None, gain: float | None, plain: int, budgets: Sequence[Budget]
    ) -> Alternative:
        """Return what came of it.

        Args:
            fit: the model with functions.
            outcome: of the search with them, where there was one.
            gain: over the model without.
            plain: number of its candidates; what else may be present are settings.
            budgets: of which it was found.
        """
        mechanisms, constants = self.space.mechanisms, self.space.frame.constants
        chosen = self.everywhere(fit)
        held = frozenset[str]().union(*(mechanisms[k].names for k in chosen))
        asked = {n: k for n, k in self.space.needed.items() if k < self.own or n in held}
        return Alternative(
            mechanisms=tuple(mechanisms[k] for k in chosen),
            constants=tuple(constants[n] for n, k in asked.items() if k >= self.own),
            start=Start(
                (fit.theta * self.space.sizes(fit.theta))[[*range(plain), *chosen]],
                {n: constants[n].at(float(fit.theta[k])) for n, k in asked.items()},
            ),
            outcome=outcome,
            gain=gain,
            least=self.least_gain(fit),
            tried=self.tried,
            spent=sum(b.spent for b in dict.fromkeys(budgets)),
        )

    @property
    def tried(self) -> tuple[tuple[str, ...], ...]:
        """The functions that were compared, by number of the suspicion, those of other relations last."""
        candidates = [(r, p.term) for (r, p), k in self.number.items() if k >= self.own]
        found = list[tuple[str, ...]]()
        for s, choices in zip(self.suspected, self.choices, strict=True):
            shared = (t for r, t in candidates if r == s.relation and self.split(t, s.variable) is not None)
            found.append(tuple(dict.fromkeys(map(readable, (*(t for c in choices for t in c.terms), *shared)))))
        return tuple(found)

    def _constants(self, named: Collection[str]) -> dict[str, Constant]:
        """Return the constants of the model, and of new ones those that are named."""
        own = {m.place for m in self.space.mechanisms[: self.own] if m.kind == "constant"}
        return {n: c for n, c in self.space.frame.constants.items() if n in own or n in named}


def alternative(
    refinement: Refinement,
    suspected: Sequence[Suspicion],
    candidates: int,
    limit: float,
    units: Mapping[str, str | None],
) -> Alternative | None:
    """Return what a model becomes with functions in the place of what is suspected; None where it cannot be followed.

    Args:
        refinement: the end of a likelihood stage, of plain candidates.
        suspected: what is suspected of its model.
        candidates: number of these; what else may be present are settings.
        limit: units of budget that may be spent.
        units: of states and inputs, as far as they are known.
    """
    work = _Work.of(refinement, suspected, limit, units)
    found = replace(refinement.fit, theta=work.padded(refinement.fit.theta))
    plain = work.tightened(found.theta)
    standing = work.first(found if refinement.exact or plain is None else plain, plain)
    if standing is None:
        return None
    budgets = [work.space.budget]
    work, standing = work.pooled(work.exchanged(standing))
    budgets.append(work.space.budget)
    shared = work.together(standing)
    if shared is not standing:
        # Beside an imitation another is as far from its function as that is. Functions that are shared are none.
        work, shared = work.pooled(work.exchanged(shared))
        budgets.append(work.space.budget)
    standing, price = work.plainer(shared), work.moves().penalised
    before = plain if refinement.exact else None
    gain = None if before is None else price(before) - price(standing.fit)
    if gain is not None and gain > work.least_gain(standing.fit) and work.holds_functions(standing.fit):
        return work.told(standing.fit, None, gain, candidates, budgets)
    outcome = work.searched(standing)
    if outcome is None:
        return None
    if refinement.process is not None:
        gain = work.gain_under_noise(refinement.process, outcome.fit)
    if before is not None and np.isfinite(outcome.width) and work.holds_functions(outcome.fit):
        gain = price(before) - price(outcome.fit)
    return work.told(outcome.fit, outcome, gain, candidates, budgets)
