"""The end of a likelihood stage: the model that the trajectory supports, and how it was found."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from odescope.arrays import FloatArray
from odescope.likelihood.evidence import Evidence
from odescope.likelihood.fit import Fit
from odescope.likelihood.held_out import free_run_errors, stretches
from odescope.likelihood.holds import holds_of
from odescope.likelihood.noise_or_terms import cost_without_process_noise
from odescope.likelihood.path import LOST, VERY, ModelPath
from odescope.likelihood.process_noise import Noisy, white
from odescope.likelihood.search import CHANCE, WHITE, Outcome, full
from odescope.likelihood.search_space import SearchSpace
from odescope.likelihood.searches import FOLLOWED, joined
from odescope.likelihood.settings import FoundSettings
from odescope.model.relation import FoundMechanism, Relation
from odescope.recordings.coordinate import Hold


@dataclass(frozen=True, eq=False)
class Refinement:
    """The relations at the end of the likelihood stage, the mechanisms that they add up from, and how it went.

    `outcome` is the search for a model that follows the record to within its noise. Where there is none, or process
    noise is likelier, `process` is the model with it, or `rejected`, where that is no better than what it would
    replace. `fit` and `space` are those of the relations, `covariance` (p, p) that of the fit's parameters, `evidence`
    what the record says of every candidate, `path` the models from theirs to the shortest. Not `finished` if the budget
    ended a search, `late` if the clock did; `spent` is in units of the budget. `hold_gains` are those of `HoldChoice`,
    `undecided` the holds that inputs may as well have, `steps` the number of steps between samples, by input, `bursts`
    the share of the record that was too quick to look at, `unknown` that in which late inputs were not known. `scale`
    is the residual variance over the noise variance: more than that of the search where fewer terms were asked for.
    """

    relations: tuple[Relation, ...]
    mechanisms: tuple[FoundMechanism, ...]
    settings: FoundSettings
    outcome: Outcome
    scale: float
    process: Noisy | None
    rejected: Noisy | None
    fit: Fit
    covariance: FloatArray
    space: SearchSpace
    evidence: Evidence | None
    path: ModelPath | None
    starts: int
    finished: bool
    late: bool
    spent: float
    hold_gains: Mapping[str, float]
    undecided: Mapping[str, Hold]
    steps: Mapping[str, int] = field(default_factory=dict)
    bursts: float = 0.0
    unknown: float = 0.0

    @property
    def follows(self) -> bool:
        """Whether the model, with process noise if it has any, describes the record: its errors can then be stated."""
        return self.process is not None or joined(self.outcome)

    @property
    def exact(self) -> bool:
        """Whether the search found a model that follows the record to within its noise, without any of the process."""
        return self.process is None and joined(self.outcome)

    @property
    def clear(self) -> bool:
        """Whether it is exact, what it leaves is white, and no term of it is in doubt."""
        return self.process is None and self.outcome.clear

    @property
    def says_all(self) -> bool:
        """Whether what it leaves to noise of the process is white: what lacks in a law would show between blocks."""
        return (
            self.process is not None and self.free_run_error < LOST and white(self.process.fit, self.process.evidence)
        )

    @property
    def truncated(self) -> bool:
        """Whether fewer terms were asked for than it takes to follow the record to within its noise."""
        return self.exact and self.scale >= FOLLOWED

    @property
    def lacks_nothing(self) -> bool:
        """Whether some model of its candidates leaves no more than the noise and chance, if with more terms."""
        return leaves_noise(self.space, self.outcome)

    @property
    def wanting(self) -> bool:
        """Whether the model leaves more than noise, or has so many terms that it imitates what is not there."""
        return not self.lacks_nothing or full(self.space, self.fit)

    @property
    def free_run_error(self) -> float:
        """Error of free runs over what is held out, in standard deviations; infinite where none were made."""
        return np.inf if self.path is None else self.path.choice.error

    @property
    def hardly_off(self) -> bool:
        """Whether free runs stay so near to all of the record that what noise of the process takes up moves nothing.

        So are the errors of a solver with its usual tolerance: they go with this and that, and no law is behind them.
        """
        if self.process is None:
            return False
        return float(free_run_errors(self.space, self.fit.theta, stretches(self.space.segments)).mean()) < VERY**2

    def gained_over(self, before: Refinement | None) -> float | None:
        """Return by how much the deviance is less than that of another model, noise of the process counted.

        None where these do not compare: one does not follow the record, or only the other without such noise; averages
        of other numbers of samples, as other holds of inputs ask for, have other densities, as have other inputs under
        such noise, and where pieces of the record are joined less closely more is left to chance.
        """
        if before is None or not (self.follows and before.follows):
            return None
        own, there = self.space.segments, before.space.segments
        if own.block != there.block or own.samples != there.samples:
            return None
        if before.process is None:
            like = self.process is None and self.outcome.width == before.outcome.width
            return float(before.outcome.deviance - self.outcome.deviance) if like else None
        if holds_of(self.space) != holds_of(before.space):
            return None
        if self.process is not None:
            return float(before.process.penalised - self.process.penalised)
        # Its steps come when this model has them.
        there = replace(there, inputs=own.inputs, cuts=own.cuts, driven=own.driven)
        pieces = replace(there, noise=own.noise, spread=own.spread, decorrelation=None)
        return float(before.process.penalised - cost_without_process_noise(self.space.on(pieces), self.outcome))


def leaves_noise(space: SearchSpace, outcome: Outcome) -> bool:
    """Say whether what a model leaves of the record that it follows is no more than white noise and chance."""
    return joined(outcome) and outcome.scale <= WHITE + CHANCE * float(np.sqrt(2.0 / space.segments.samples))
