"""odescope reads sparse, possibly rational, ordinary differential equations off noisy recorded measurements."""

from __future__ import annotations

from importlib import import_module
from typing import Any

__version__ = "0.1.0"

# Heavy modules load when a name of theirs is first used, so that importing odescope stays quick. Type checkers read
# __init__.pyi instead, which is drawn from this table: ./run python .ci/stub.py.
_HOMES = {
    "errors": ("InputError", "NoModelError", "OdescopeError", "Stopped", "WorkersLostError"),
    "recordings.record": ("Record", "Records"),
    "recordings.coordinate": ("Coordinate", "Input"),
    "recordings.layout": ("Layout",),
    "recordings.readers": ("read_records", "records_from"),
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
    "regression.problem": ("Problem", "pose"),
    "selection.sweep": ("Sweep", "nested_libraries", "sweep"),
    "selection.ranking": ("Ranking", "rank"),
    "model.model": ("Model",),
    "model.relation": ("Relation", "RelationTerm"),
    "model.coefficients": ("CoefficientRow",),
    "model.explicit": ("explicit",),
    "model.simulation": ("Trajectory", "simulate"),
    "model.initial_state": ("initial_state",),
    "likelihood.search": ("LikelihoodSearch",),
    "observer.estimate": ("StateEstimates", "estimate_states"),
    "observer.run": ("StateEstimate",),
    "validation.validate": ("Validation", "ValidationRow", "validate"),
    "export.languages.latex": ("to_latex",),
    "export.languages.mathml": ("to_mathml",),
    "export.languages.python": ("to_python",),
    "export.languages.text": ("to_text",),
    "export.program_files": ("ProgramFiles",),
    "export.programs.antimony": ("to_antimony",),
    "export.programs.c": ("to_c",),
    "export.programs.casadi": ("to_casadi",),
    "export.programs.fmu": ("to_fmu",),
    "export.programs.julia": ("to_julia",),
    "export.programs.matlab": ("to_matlab",),
    "export.programs.modelica": ("to_modelica",),
    "export.model_file": ("from_json", "read_model", "to_json", "write_model"),
    "study.library_options": ("Candidates",),
    "study.options": ("Data", "Driven", "Filtering", "Measured", "Random", "Regression", "Study"),
    "study.toml": ("read_study",),
    "pipeline.joint_models": ("Search", "to_relation"),
    "pipeline.identification": ("Identification", "identify"),
    "commands.results": ("save_result", "write_report"),
}
_HOME = {name: module for module, names in _HOMES.items() for name in names}

__all__ = ["__version__", *sorted(_HOME)]


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        raise AttributeError(f"module 'odescope' has no attribute {name!r}")
    return getattr(import_module(f"odescope.{_HOME[name]}"), name)


def __dir__() -> list[str]:
    return list(__all__)
