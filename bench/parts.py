"""Standard errors on real recordings: the same few terms identified from parts of a record, compared with each other.

    ./run python bench/parts.py FOLDER

FOLDER holds the recordings that `docs/real-data.md` names. A part is a stretch of the one recording, or every so many
recordings of several. The candidates are the terms that the whole record has, and of the models of parts those are
compared that have the same terms, those that most have. Were standard errors right, and the machine the same all the
time, the ratio in the last column would be 1: deviations from the weighted mean over all parts, root mean square, in
standard errors, for their number. In the last row stands how often a part is within 1.96 standard errors of the mean of
the others.
"""

from __future__ import annotations

import argparse
import time
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import msgspec
import numpy as np

from odescope import Candidates, NoModelError, identify
from odescope.model.model import Model
from odescope.recordings.readers import read_records
from odescope.recordings.record import Records
from odescope.study.toml import read_study

STUDIES = Path(__file__).parents[1] / "docs" / "studies"
HEADER = (
    "| record | parts | term | mean | standard error of a part | spread of parts / standard error |\n"
    "|---|---:|---|---:|---:|---:|"
)


@dataclass(frozen=True)
class Case:
    """A study under docs/studies, whose data lie in the folder of that name or another, and the candidates."""

    study: str
    parts: int
    library: Candidates


CASES = {
    "emps": Case("emps", 8, Candidates(terms=("1", "force", "q_dot", "sign(q_dot)"))),
    "silverbox": Case("silverbox", 16, Candidates(terms=("u", "y", "y_dot", "y**3"))),
    "single_pendulum": Case(
        "single_pendulum", 6, Candidates(terms=("sin(theta)", "cos(theta)", "theta_dot", "sign(theta_dot)"))
    ),
    "double_pendulum": Case(
        "double_pendulum", 6,
        Candidates(
            form="lagrangian", kinetic=("phi1_dot**2", "phi1_dot*phi2_dot*cos(phi1 - phi2)", "phi2_dot**2"),
            potential=("cos(phi1)", "cos(phi2)"),
            dissipation=("abs(phi1_dot)", "abs(phi2_dot - phi1_dot)", "phi1_dot**2", "(phi2_dot - phi1_dot)**2"),
        ),
    ),
    "driven_double_pendulum": Case(
        "driven_double_pendulum", 3,
        Candidates(
            form="lagrangian",
            kinetic=("q1_dot**2", "q1_dot**2*cos(q2)", "q1_dot*q2_dot", "q1_dot*q2_dot*cos(q2)", "q2_dot**2"),
            potential=("cos(q1)", "cos(q1 + q2)"), dissipation=("abs(q1_dot)", "abs(q2_dot)"),
            forces={"q1": ("tau1",), "q2": ("tau2",)},
        ),
    ),
}  # fmt: skip


def parts_of(records: Records, count: int) -> list[Records]:
    """Return stretches of the one recording, or every so many of several."""
    if len(records.runs) > 1:
        return [Records(records.runs[k::count]) for k in range(count)]
    run = records.runs[0]
    cuts = np.linspace(0, len(run), count + 1).astype(int)
    return [Records((run.part(int(a), int(b)),)) for a, b in pairwise(cuts)]


def coefficients(model: Model) -> Mapping[str, tuple[float, float]]:
    """Return estimate and standard error of each term, by equation and term; those that set the scale have none."""
    return {
        c.term if c.equation is None else f"{c.term} in {c.equation}": (c.coefficient, c.std_error)
        for c in model.coefficients
        if c.std_error
    }


def scatter(found: Sequence[tuple[float, float]]) -> tuple[float, float, np.ndarray, np.ndarray]:
    """Return the weighted mean, the median standard error, and the deviations of parts in standard errors.

    The last are those from the weighted mean, scaled to a variance of one, and those of every part from the mean of
    the others, in the standard error of that difference.
    """
    c, s = np.array(found).T
    weight = 1.0 / s**2
    mean = float(weight @ c / weight.sum())
    left = weight.sum() - weight
    others = (weight @ c - weight * c) / left
    scale = np.sqrt(1.0 - weight / weight.sum())
    return mean, float(np.median(s)), (c - mean) / s / scale, (c - others) / np.sqrt(s**2 + 1.0 / left)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--only", nargs="+", choices=CASES, default=list(CASES))
    args = parser.parse_args()
    print(HEADER)
    for name in args.only:
        case = CASES[name]
        study = msgspec.structs.replace(read_study(STUDIES / f"{case.study}.toml"), library=case.library)
        files = sorted(f for pattern in study.data.files for f in (args.folder / name).glob(pattern))
        begin, models = time.process_time(), list[Mapping[str, tuple[float, float]]]()
        for part in parts_of(read_records(files, study.layout()), case.parts):
            try:
                models.append(coefficients(identify(study, part).model))
            except NoModelError as error:
                print(f"{name}: no model of a part: {error}")
        terms, alike = Counter(map(frozenset, models)).most_common(1)[0]
        pooled, held = list[float](), list[float]()
        same = [m for m in models if terms == set(m)] if alike > 1 else []
        for term in same[0] if same else ():
            mean, error, off, apart = scatter([m[term] for m in same])
            pooled += list(off)
            held += list(np.abs(apart) < 1.96)
            print(
                f"| {name} | {alike} | {term} | {mean:.5g} | {error:.2g} | {np.sqrt(np.mean(off**2)):.2f} |", flush=True
            )
        print(
            f"| {name} | {alike} of {case.parts} | all | | | {np.sqrt(np.mean(np.square(pooled))):.2f};"
            f" {np.mean(held):.0%} of {len(held)} within 1.96; {time.process_time() - begin:.0f} s |",
            flush=True,
        )


if __name__ == "__main__":
    main()
