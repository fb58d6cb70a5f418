"""A model with functions in the place of what is suspected, on the way to it and at its end.

docs/method.md, Suspicion.
"""

from __future__ import annotations

from dataclasses import dataclass

from odescope.library.constants import Constant
from odescope.library.mechanism import Mechanism
from odescope.likelihood.fit import Fit
from odescope.likelihood.imitation import Placed
from odescope.likelihood.search import Outcome
from odescope.likelihood.settings import Start


@dataclass(frozen=True, eq=False)
class Alternative:
    """A model with functions in the place of what is suspected.

    `mechanisms` are the functions in all relations, candidates beside those of the model, none where the search
    dropped all, and `constants` theirs; `start` holds their coefficients. `gain` is the fall of the penalised cost,
    at prices that count all functions that were tried, both with noise of the process where the model has some,
    None where one of the two does not follow the record, and `least` what it has to be above; `tried` are these, by
    number of the suspicion. `outcome` is that of a search with them: there is none where functions alone are better
    by so much. `spent` is in units of the budget.
    """

    mechanisms: tuple[Mechanism, ...]
    constants: tuple[Constant, ...]
    start: Start
    outcome: Outcome | None
    gain: float | None
    least: float
    tried: tuple[tuple[str, ...], ...]
    spent: float


@dataclass(frozen=True, eq=False)
class Standing:
    """A fit, what stands for every suspicion in it, and the model that says what functions have to (None: the fit)."""

    fit: Fit
    placed: tuple[Placed, ...]
    said: Fit | None
