"""Forms that compete for one record: relations, Lagrange's equations, reactions; each with candidates and starts."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from odescope.arrays import FloatArray
from odescope.library.constants import Constant, mechanism_at
from odescope.library.mechanism import Mechanism, candidates_of
from odescope.library.tape import evaluate, write_tape
from odescope.library.ties import tied
from odescope.likelihood.settings import Start
from odescope.model.relation import Relation
from odescope.pipeline.regressed import Regressed
from odescope.recordings.record import Record, Records
from odescope.regression.linear_elimination import explained
from odescope.regression.mechanisms import SIMPLE, MechanismProblem, proposed
from odescope.signals.estimate import Signals, signals_like
from odescope.study.library_options import Form
from odescope.study.options import LeftOut, Mechanisms, Study

RUBBING = 0.1  # of the deviation of a target: what friction makes of it in a start


@dataclass(frozen=True, eq=False)
class Posed:
    """A form: its candidates, their constants, those left out as combinations of others, and where to begin.

    `plain` are relations that hold their targets bare, where there are any, `rival` those that promise more than all
    `starts`, with other target terms. `regression` gives what regression on all
    relations together proposes, where that is not among the starts; it is asked for late, because it takes as long as a
    search. `again` gives what regression proposes at other values of the constants.
    """

    form: Form
    mechanisms: tuple[Mechanism, ...]
    constants: tuple[Constant, ...]
    left_out: LeftOut
    starts: tuple[Start, ...]
    plain: Start | None = None
    rival: Start | None = None
    regression: Callable[[], FloatArray | None] = lambda: None
    again: Callable[[Mapping[str, float]], Start | None] = lambda _: None

    @cached_property
    def at_nominal(self) -> tuple[Mechanism, ...]:
        """The candidates with numbers for constants, as regression takes them."""
        return tuple(mechanism_at(m, {c.name: c.nominal for c in self.constants}) for m in self.mechanisms)

    def further(self, values: Mapping[str, float]) -> Start | None:
        """Return one more start: what regression says where constants have these values, or of all relations together.

        Of the latter constants are nominal.
        """
        there = self.again(values) if values else None
        if there is not None:
            return there
        return None if self.proposal is None else Start(self.proposal)

    @cached_property
    def proposal(self) -> FloatArray | None:
        """What regression on all relations together proposes, computed once."""
        return self.regression()


def relations_form(
    study: Study, tried: Sequence[Regressed], again: Callable[[Mapping[str, float]], Regressed]
) -> Posed:
    """Return the plain candidates of all targets, begun from what regression proposes and from a forward selection.

    Args:
        study: whose ties hold.
        tried: what regression says, at the best numbers for constants first.
        again: gives what it says at others.
    """
    best = tried[0]
    products = [
        tuple(dict.fromkeys(p.substituted.product(t) for p in tried for t in p.problems[r].with_dependent))
        for r in range(len(best.problems))
    ]
    candidates = candidates_of(products, [p.target for p in best.problems])
    mechanisms = tied(candidates, study.library.ties, study.scope())
    starts = [best.start(mechanisms, model.relations) for _, model in best.proposals]
    starts += [best.start(mechanisms, relations) for relations in (best.forward, *best.of_low_degree)]
    for other in tried if len(tried) > 1 else ():
        proposals = [other.relations, other.plain] if other.proposals else []
        starts += [other.start(mechanisms, relations) for relations in (*proposals, other.forward, other.short)]
    if len(tried) > 1:
        starts.append(best.start(mechanisms, [Relation(r.terms[:1]) for r in best.forward]))

    def further(values: Mapping[str, float]) -> Start | None:
        found = again(values)
        return found.start(mechanisms, found.relations) if found.proposals else None

    rivals, bare = best.rival, None
    if best.proposals and not any(len(m.parts) > 1 for m in mechanisms):
        bare = best.start(mechanisms, best.plain)
    return Posed(
        "relations",
        mechanisms,
        best.substituted.constants,
        (),
        tuple(starts),
        bare,
        None if rivals is None else best.start(mechanisms, rivals),
        again=further,
    )


def mechanisms_form(
    study: Study,
    form: Form,
    library: Mechanisms,
    constants: tuple[Constant, ...],
    records: Records,
    signals: Signals,
) -> Posed:
    """Return Lagrange's equations or reactions, begun from what noise explains, from little, or from regression.

    Args:
        study: how signals are filtered, and the seed.
        form: which of the two.
        library: the candidates, and those left out.
        constants: that the candidates name.
        records: what the signals were found in.
        signals: noise, cutoffs and values.
    """
    mechanisms, left_out = library
    plain = [mechanism_at(m, {c.name: c.nominal for c in constants}) for m in mechanisms]
    problem, little = MechanismProblem.of(signals, plain), _little(mechanisms, signals)
    starts = [little]
    if np.any((rubbing := _with_friction(little, plain, signals)) != little):
        starts.append(rubbing)
    if (theta := explaining(study, problem, records)) is not None:
        starts.insert(0, theta)
    own = tuple(map(Start, starts))
    return Posed(
        form,
        mechanisms,
        constants,
        left_out,
        own,
        regression=lambda: proposed(problem, _noisy(study, records, signals)),
    )


def explaining(study: Study, problem: MechanismProblem, records: Records) -> FloatArray | None:
    """Return coefficients (mechanisms,) of the few that leave no more than noise does, None where there are none.

    Args:
        study: how signals are filtered, and the seed.
        problem: the mechanisms, with numbers for constants, on signals.
        records: what the signals were found in.
    """
    return None if problem.linear else explained(problem, _noisy(study, records, problem.signals))


def _noisy(study: Study, records: Records, signals: Signals) -> Signals:
    """Return the signals of the same records with as much noise once more."""
    rng = np.random.default_rng(study.random.seed)
    noise = {c.name: c.noise for c in signals.channels}
    twice = Records(tuple(_with_noise(run, noise, rng) for run in records))
    return signals_like(signals, twice.stretches, study.signals.differentiator, study.signals.margin)


def _with_noise(run: Record, noise: dict[str, float], rng: np.random.Generator) -> Record:
    """Return a record with as much noise once more."""
    size = np.array([noise.get(name, 0.0) for name in run.names])
    return replace(run, values=run.values + size * rng.standard_normal(run.values.shape))


def _little(mechanisms: Sequence[Mechanism], signals: Signals) -> FloatArray:
    """Return what is known, the simplest kinetic term of every coordinate, and forces of the size they seem.

    All kinetic terms begin with the same energy, so that the units of coordinates do not matter: with that of one that
    is known, else such that the largest coefficient is 1.
    """
    theta, joined = np.zeros(len(mechanisms)), signals.joined()
    simplest, driven = _simplest(mechanisms, signals), {i.name for i in signals.inputs}
    energies = list[float]()
    for r, (k, _) in simplest.items():
        rate = joined[signals.row(signals.coordinates[r].derivative(1))]
        theta[k] = 1.0 / max(float(np.mean(rate**2)), 1e-300)
        energies += [known / theta[k] for known in (mechanisms[k].known,) if known]
    theta *= energies[0] if energies else 1.0 / theta.max(initial=1e-300)
    for k, m in enumerate(mechanisms):
        first = m.parts[0]
        if m.known is not None:
            theta[k] = m.known
        elif m.kind == "force" and first.product.term.names and first.product.term.names <= driven:
            y = joined[signals.row(signals.targets[first.relation])]
            u = evaluate(write_tape(signals.names, [first.product.term]), joined)[0]
            kinetic, share = simplest.get(first.relation, (k, 0.0))
            theta[k] = theta[kinetic] * share * float(y @ u) / max(float(u @ u), 1e-300) / -first.share
    return theta


def _simplest(mechanisms: Sequence[Mechanism], signals: Signals) -> dict[int, tuple[int, float]]:
    """Return, by relation, the number of the simplest kinetic term of its coordinate, and its share there.

    The squares of the rates of several coordinates together are simpler than each by itself.
    """
    found = dict[int, tuple[int, float]]()
    for r, target in enumerate(signals.targets):
        own = [
            (m.size, -len(m.parts), m.term != f"{signals.coordinates[r].derivative(1)}**2", k, p.share)
            for k, m in enumerate(mechanisms)
            for p in m.parts
            if m.kind == "kinetic" and p.relation == r and p.product.factor == target
        ]
        if own:
            found[r] = min(own)[3:]
    return found


def _with_friction(little: FloatArray, mechanisms: Sequence[Mechanism], signals: Signals) -> FloatArray:
    """Return a start with dry and viscous friction of every coordinate alone, each a share of what moves it.

    Where friction is most of what is lacking, a search that adds one mechanism at a time takes others for it.

    Args:
        little: (mechanisms,) coefficients of the start without.
        mechanisms: the candidates, with numbers for constants.
        signals: to tell sizes.
    """
    theta, joined, simplest = little.copy(), signals.joined(), _simplest(mechanisms, signals)
    for k, m in enumerate(mechanisms):
        if m.kind == "dissipation" and m.known is None and len(m.parts) == 1 and m.size <= SIMPLE:
            (part,) = m.parts
            target = joined[signals.row(signals.targets[part.relation])]
            column = evaluate(write_tape(signals.names, [part.product.term]), joined)[0]
            size = RUBBING * float(target.std()) / max(float(column.std()), 1e-300) / part.share
            theta[k] = size * (little[simplest[part.relation][0]] if part.relation in simplest else 1.0)
    return theta
