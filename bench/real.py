"""Models of real recordings with and without the likelihood stage, judged on recordings that neither has seen.

    ./run python bench/real.py FOLDER

FOLDER holds actuated_pendulum, single_pendulum and double_pendulum as `docs/real-data.md` says where to find them.
Identification sees what is not marked validation (the first two thirds where nothing is); the rest is simulated freely
from its first sample, and its filtered targets are predicted.
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path

import msgspec
import numpy as np
import pandas as pd

from odescope import Candidates, Identification, LikelihoodSearch, Study, identify
from odescope.model.initial_state import initial_state
from odescope.model.model import Model
from odescope.model.simulation import simulate
from odescope.recordings.readers import records_from
from odescope.recordings.record import Records
from odescope.report.at_work import predicted
from odescope.signals.estimate import Signals, estimate_signals
from odescope.study.toml import read_study
from odescope.validation.agreement import VALID_ERROR

STUDIES = Path(__file__).parents[1] / "docs" / "studies"
CASES = (
    ("actuated pendulum", "actuated_pendulum", "direct_collocation.csv", False),
    ("single pendulum, default library", "single_pendulum", "free_swing_250Hz.csv", True),
    ("single pendulum, dry friction named", "single_pendulum", "free_swing_250Hz.csv", False),
    ("double pendulum, Lagrange form", "double_pendulum", "free_swing_250Hz.csv", False),
)


def split(frame: pd.DataFrame, study: Study) -> tuple[Records, Records]:
    """Return what identification sees, and what it does not."""
    if "validation" in frame:
        seen, unseen = frame[frame.validation == 0], frame[frame.validation == 1]
    else:
        seen, unseen = frame[: 2 * len(frame) // 3], frame[2 * len(frame) // 3 :]
    layout = study.layout()
    return records_from(seen, layout), records_from(unseen, layout)


def signals_of(study: Study, records: Records) -> Signals:
    return estimate_signals(
        records, study.measured(), study.driven(), study.signals.differentiator, margin=0.0, decimate=False
    )


def target_r2(model: Model, signals: Signals) -> list[float]:
    """Return the share of each filtered target's variance that the model predicts from filtered states."""
    joined = signals.joined()
    truth = joined[[signals.row(t) for t in model.targets]]
    error = predicted(model, joined[[signals.row(v) for v in model.variables]]) - truth
    return [float(1.0 - e.var() / t.var()) for e, t in zip(error, truth, strict=True)]


def valid_times(model: Model, records: Records, signals: Signals) -> tuple[list[float], list[float]]:
    """Return valid time, in seconds, and RMS error of the measured coordinates, of a free run of every recording."""
    spread = np.array([signals.joined()[signals.row(s)].std() for s in model.states])
    times, errors = [], []
    for run, columns in zip(records, signals.columns, strict=True):
        states = columns[[signals.row(s) for s in model.states]].T
        inputs = np.array([run.column(i.name) for i in model.inputs]).reshape(len(model.inputs), len(run)).T
        free = simulate(model, run.t, np.ascontiguousarray(inputs), initial_state(model, run))
        off = (free.states - states[: len(free.t)]) / spread
        late = np.flatnonzero(np.sqrt(np.mean(off**2, axis=1)) > VALID_ERROR)
        times.append(float(run.t[late[0] if late.size else len(free.t) - 1] - run.t[0]))
        errors.append(float(np.sqrt(np.mean(off**2))))
    return times, errors


def row(case: str, kind: str, result: Identification, unseen: Records, seconds: float) -> str:
    signals = signals_of(result.study, unseen)
    times, errors = valid_times(result.model, unseen, signals)
    r2 = ", ".join(f"{v:.6f}" for v in target_r2(result.model, signals))
    terms = sum(len(relation.terms) - 1 for relation in result.model.relations)
    length = sum(float(run.t[-1] - run.t[0]) for run in unseen)
    valid, error = f"{sum(times):.2f} of {length:.2f}", f"{np.mean(errors):.4f}"
    return f"| {case} | {kind} | {terms} | {valid} | {error} | {r2} | {seconds:.1f} |"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path)
    folder = parser.parse_args().folder
    print("| recording | model | terms | valid time, s | error of the free run | target R² | s |")
    print("|---|---|---:|---:|---:|---|---:|")
    details = []
    for case, name, file, plain in CASES:
        study = read_study(STUDIES / f"{name}.toml")
        if plain:
            study = msgspec.structs.replace(study, library=Candidates())
        seen, unseen = split(pd.read_csv(folder / name / file), study)
        for kind, enabled in (("regression", False), ("likelihood", True)):
            asked = msgspec.structs.replace(study, likelihood=LikelihoodSearch(enabled=enabled))
            begin = time.perf_counter()
            result = identify(asked, seen)
            print(row(case, kind, result, unseen, time.perf_counter() - begin), flush=True)
            details.append(f"\n{case}, {kind}:")
            for relation in result.model.relations:
                details += [
                    f"    {(t.factor + '*' if t.factor else '') + t.term.text:40s} {t.coefficient:.6g}"
                    + (f" ± {t.std_error:.2g}" if t.std_error else "")
                    for t in relation.terms
                ]
            details += [f"  note: {note}" for note in result.notes]
    print("\n".join(details))


if __name__ == "__main__":
    main()
