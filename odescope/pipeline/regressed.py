"""What regression on relations found, and where the likelihood may begin with it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import zip_longest

import numpy as np

from odescope.errors import NoModelError
from odescope.library.mechanism import Mechanism
from odescope.likelihood.settings import Start
from odescope.model.assembled import coefficients_of
from odescope.model.model import Model
from odescope.model.relation import Relation
from odescope.pipeline.constants import Substituted
from odescope.pipeline.joint_models import Search, by_target_term, forward, of_degree, plain, rival
from odescope.pipeline.reduce import Whole
from odescope.regression.problem import Problem
from odescope.selection.ranking import Candidate, criteria

LOW = (0, 1, 2)  # degrees of libraries that few rows may still decide between
SHORT = 3  # terms of a forward selection that a search adds to


@dataclass(frozen=True, eq=False)
class Regressed:
    """What regression on relations found: problems, searches and proposals, empty where no relation is looked for.

    `substituted` are the constants of all candidates, and the numbers that they had here; `elsewhere` is the same at
    other numbers. `failure` says why there are no proposals where some were wanted; the searches are then `in_vain`.
    """

    substituted: Substituted
    problems: tuple[Problem, ...] = ()
    searches: tuple[Search, ...] = ()
    proposals: tuple[tuple[tuple[Candidate, ...], Model], ...] = ()
    whole: Whole | None = None
    failure: NoModelError | None = None
    in_vain: tuple[Search, ...] = ()
    elsewhere: tuple[Regressed, ...] = ()

    @property
    def criterion(self) -> float:
        """What ranks the best proposal, infinite where there is none."""
        return sum(c.criterion for c in self.proposals[0][0]) if self.proposals else np.inf

    @property
    def model(self) -> Model | None:
        """The best proposal."""
        return self.proposals[0][1] if self.proposals else None

    @property
    def relations(self) -> tuple[Relation, ...]:
        """Those of the best proposal, none where there is none."""
        return () if self.model is None else self.model.relations

    @property
    def plain(self) -> list[Relation]:
        """The best relations that hold their targets bare."""
        return [plain(s, c) for s, c in zip(self.searches, self.proposals[0][0], strict=True)]

    @property
    def rival(self) -> list[Relation] | None:
        """Relations that promise more than the proposals."""
        pairs = zip_longest(self.problems, self.searches)
        rivals = [rival(p, s.ranked.candidates if s else ()) for p, s in pairs]
        first = self.relations or self.forward
        return [r or begun for r, begun in zip(rivals, first, strict=True)] if any(rivals) else None

    @cached_property
    def forward(self) -> list[Relation]:
        """A forward selection for every target."""
        return [forward(p) for p in self.problems]

    @property
    def explicit(self) -> float:
        """What ranks the forward selections, which hold their targets bare."""
        return self.worth(self.forward)

    def worth(self, relations: Sequence[Relation]) -> float:
        """Return what ranks relations, one a target, on the rows of these problems: others weigh theirs otherwise.

        Infinite where a term is no candidate here, as what others add up to is none.

        Args:
            relations: of this library or another.
        """
        places = [{term: k for k, term in enumerate(p.terms)} for p in self.problems]
        if not all(t.product in known for known, r in zip(places, relations, strict=True) for t in r.terms):
            return np.inf
        supports = [
            tuple(sorted(known[t.product] for t in r.terms)) for known, r in zip(places, relations, strict=True)
        ]
        return sum(float(criteria(p, [s])[0]) for p, s in zip(self.problems, supports, strict=True))

    @property
    def implicit(self) -> float:
        """What ranks the best that regression finds, proposed or selected beside whatever term of the target."""
        selected = sum(min(found for found, _ in by_target_term(p)) for p in self.problems)
        return min(self.criterion, selected)

    @property
    def short(self) -> list[Relation]:
        """The first terms of it."""
        return [forward(p, SHORT) for p in self.problems]

    @property
    def of_low_degree(self) -> list[list[Relation]]:
        """Plain candidates of low degree for every target, where rows are too few to decide between more."""
        found = ([of_degree(p, degree) for p in self.problems] for degree in LOW)
        return [list(relations) for each in found for relations in zip(*each, strict=False)]

    def start(self, mechanisms: Sequence[Mechanism], relations: Sequence[Relation]) -> Start:
        """Return where the likelihood may begin.

        Args:
            mechanisms: the candidates.
            relations: that regression found, with these numbers.
        """
        named = [self.substituted.relation(r) for r in relations]
        return Start(coefficients_of(mechanisms, named), self.substituted.values)
