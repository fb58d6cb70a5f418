"""odescope reads sparse, possibly rational, ordinary differential equations off noisy recorded measurements."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

__version__ = "0.1.0"

# Heavy modules load when a name of theirs is first used, so that importing odescope stays quick.
_HOMES = {
    "errors": ("InputError", "NoModelError", "OdescopeError", "Stopped", "WorkersLostError"),
    "records": ("Coordinate", "Input", "Record", "Records"),
    "readers": ("Layout", "read_records", "records_from"),
    "signals.estimate": ("Signals", "estimate_signals"),
    "signals.cutoff": ("FixedCutoff", "LeastRisk", "NoiseCeiling"),
    "signals.differentiators": ("Derivatives", "SavitzkyGolay", "SmoothingSpline", "Spectral"),
    "library.parse": ("Definition", "Scope", "parse_term"),
    "library.expression": ("Term",),
    "library.candidates": ("Library",),
    "library.rules": ("Exclusive", "Identity", "MaximumDegree", "MaximumFactors"),
    "regression.factor": ("Factor", "factorise", "merge"),
    "regression.proposers": (
        "BackwardElimination",
        "CoefficientThreshold",
        "EnergyThreshold",
        "MatchingPursuit",
        "NullSpace",
    ),
    "regression.rows": ("NoiseWeighted", "PlainRows"),
    "selection.problem": ("Problem", "pose"),
    "selection.sweep": ("Sweep", "nested_libraries", "sweep"),
    "selection.rank": ("Ranking", "rank"),
    "model.model": ("Model", "Relation", "RelationTerm"),
    "model.explicit": ("explicit",),
    "model.simulate": ("Trajectory", "simulate"),
    "model.initial": ("initial_state",),
    "likelihood.search": ("LikelihoodSearch",),
    "export.text": ("to_latex", "to_text"),
    "export.code": ("to_python",),
    "export.mathml": ("to_mathml",),
    "export.modelfile": ("from_json", "read_model", "to_json"),
    "study": ("Candidates", "Data", "Driven", "Filtering", "Measured", "Regression", "Study", "read_study"),
    "proposals": ("Search", "to_relation"),
    "identification": ("Identification", "identify"),
}
_HOME = {name: module for module, names in _HOMES.items() for name in names}

__all__ = ["__version__", *sorted(_HOME)]

if TYPE_CHECKING:
    from odescope.identification import identify as identify


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        raise AttributeError(f"module 'odescope' has no attribute {name!r}")
    return getattr(import_module(f"odescope.{_HOME[name]}"), name)


def __dir__() -> list[str]:
    return list(__all__)
