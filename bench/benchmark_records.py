"""Free runs of models of benchmark records, beside those of the parameters that were published for the same machines.

    ./run python bench/benchmark_records.py FOLDER --only arm emps silverbox --keep MODELS

FOLDER holds driven_double_pendulum, emps and silverbox as `docs/real-data.md` says where to find them; models that are
in MODELS already are not identified anew. The arm runs freely over recordings that identification has not seen: from
rest at their start, and from filtered states at many starts, because free runs of a double pendulum part. Whatever
model runs, it begins at the same state. The published arm gets the torques that were commanded and those that were
measured, either with a factor a joint that suits it best in the recordings for identification (`torque_factors`), and
the holds and delays that were found. EMPS runs over its own whole record, as published under the hold and with or
without the delay that suit it best; silverbox over the last rows of its record.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import msgspec
import numpy as np
from truths import lagrangian, relations

from odescope import Study, identify
from odescope.export.model_file import read_model, to_json
from odescope.model.initial_state import initial_state
from odescope.model.model import Model
from odescope.model.simulation import simulate
from odescope.recordings.layout import Layout
from odescope.recordings.readers import read_records
from odescope.recordings.record import Record, Records
from odescope.report.at_work import predicted
from odescope.signals.estimate import Signals, estimate_signals
from odescope.study.toml import read_study

STUDIES = Path(__file__).parents[1] / "docs" / "studies"
UNSEEN = ("run11.csv", "run12.csv", "run13.csv")
HORIZONS = (0.5, 1.0, 2.0)  # seconds of a free run
EVERY = 0.25  # seconds between starts
MARGIN = 0.5  # seconds at the ends of a recording, where filters are poor
LAST = 8192  # rows of silverbox that are simulated
GRAVITY = 9.81


@dataclass(frozen=True, eq=False)
class Rival:
    """A model under some columns of the recordings, each times a factor, in the order of its inputs."""

    name: str
    model: Model
    columns: tuple[str, ...]
    factors: tuple[float, ...]

    def errors(self, run: Record, first: int, stop: int, state: np.ndarray) -> np.ndarray:
        """Return what a free run is off the measured coordinates (K, c), NaN from where it ended early."""
        t = run.t[first:stop]
        driven = np.column_stack(
            [f * run.column(c)[first:stop] for c, f in zip(self.columns, self.factors, strict=True)]
        )
        free = simulate(self.model, t, driven, state)
        off = np.full((len(t), len(self.model.coordinates)), np.nan)
        for k, c in enumerate(self.model.coordinates):
            off[: len(free.t), k] = free.column(c.name) + c.offset - run.column(c.name)[first : first + len(free.t)]
        return off


def rms(off: np.ndarray) -> float:
    """Return the root mean square, infinite where a run ended early."""
    found = float(np.sqrt(np.mean(off**2)))
    return found if np.isfinite(found) else np.inf


def published_arm(like: Model) -> Model:
    """Return the two-link arm of the published parameters, q2 relative to the first link, driven as a model is."""
    m1, m2, l1, r1, r2, i1, i2 = 0.5594, 0.6043, 0.3, 0.3, 0.1838, 0.05347, 0.02392
    rotor, gear, rub, dry1, dry2 = 7.66e-5, 6.0, 0.001, 0.093, 0.078
    geared = gear**2 * rotor
    first, second = like.coordinates
    u1, u2 = (i.name for i in like.inputs)
    return lagrangian(
        tuple(msgspec.structs.replace(c, offset=0.0) for c in (first, second)),
        like.inputs,
        {
            "q1_dot**2": 0.5 * (i1 + i2 + m2 * l1**2 + geared + rotor),
            "q1_dot**2*cos(q2)": m2 * l1 * r2,
            "q1_dot*q2_dot": i2 - gear * rotor,
            "q1_dot*q2_dot*cos(q2)": m2 * l1 * r2,
            "q2_dot**2": 0.5 * (i2 + geared),
        },
        {"cos(q1)": -(m1 * r1 + m2 * l1) * GRAVITY, "cos(q1 + q2)": -m2 * r2 * GRAVITY},
        {"q1_dot**2": 0.5 * rub, "q2_dot**2": 0.5 * rub, "abs(q1_dot)": dry1, "abs(q2_dot)": dry2},
        {"q1": {u1: 1.0}, "q2": {u2: 1.0}},
    ).model


def torque_factors(model: Model, signals: Signals) -> tuple[float, ...]:
    """Return the factor of each input with which a model predicts the filtered accelerations best."""
    joined = signals.joined()
    rows = joined[[signals.row(v) for v in (*model.states, *(i.name for i in signals.inputs))]]
    driven = rows[len(model.states) :]
    truth = np.concatenate([joined[signals.row(t)] for t in model.targets])

    def under(inputs: np.ndarray) -> np.ndarray:
        return np.concatenate(predicted(model, np.vstack([rows[: len(model.states)], inputs])))

    still = under(np.zeros_like(driven))
    gains = [under(np.eye(len(driven))[k][:, None] * driven) - still for k in range(len(driven))]
    return tuple(np.linalg.lstsq(np.column_stack(gains), truth - still)[0].tolist())


def with_columns(layout: Layout, names: Sequence[str]) -> Layout:
    """Return a layout that reads further columns, which keep their values as inputs do."""
    return replace(layout, columns=(*layout.columns, *((n, n) for n in names)), held=layout.held | set(names))


def arm_rivals(study: Study, folder: Path, model: Model) -> list[Rival]:
    """Return the model and the published arm under every kind of torque."""
    commanded = tuple(i.name for i in model.inputs)
    measured = tuple(f"{name}_meas" for name in commanded)
    published, ones = published_arm(model), (1.0,) * len(commanded)
    files = [folder / f for f in study.data.files]
    seen = read_records(files, with_columns(study.layout(), measured))
    found = []
    for kind, columns in (("commanded", commanded), ("measured", measured)):
        inputs = [msgspec.structs.replace(i, name=c) for i, c in zip(model.inputs, columns, strict=True)]
        signals = estimate_signals(seen, study.measured(), inputs, study.signals.differentiator)
        factors = torque_factors(published, signals)
        told = " and ".join(f"{f:.3f}" for f in factors)
        found.append(Rival(f"published, torques {kind}", published, columns, ones))
        found.append(Rival(f"published, torques {kind}, times {told}", published, columns, factors))
        found.append(Rival(f"odescope, torques {kind}", model, columns, ones))
    return found


def arm_runs(study: Study, folder: Path, rivals: Sequence[Rival]) -> None:
    """Print the errors in rad of free runs over the recordings that identification has not seen.

    Of runs from many starts also how often each beats the model under the torques that it was identified with.
    """
    states, measured = rivals[0].model.states, [c for r in rivals for c in r.columns]
    layout = with_columns(study.layout(), sorted(set(measured) - {name for name, _ in study.layout().columns}))
    off: dict[tuple[str, float], list[list[float]]] = {}
    whole: dict[str, list[float]] = {r.name: [] for r in rivals}
    for file in UNSEEN:
        records = read_records([folder / file], layout)
        run = records.runs[0]
        signals = estimate_signals(records, study.measured(), (), study.signals.differentiator, 0.0, decimate=False)
        filtered = signals.columns[0][[signals.row(s) for s in states]].T
        rest = np.where(np.arange(len(states)) < len(study.coordinates), filtered[0], 0.0)
        for r in rivals:
            whole[r.name].append(rms(r.errors(run, 0, len(run), rest)))
        for horizon in HORIZONS:
            steps = round(horizon / run.sample_period)
            begins = np.arange(MARGIN, run.duration - MARGIN - horizon, EVERY)
            for r in rivals:
                found = [
                    rms(r.errors(run, k, k + steps + 1, filtered[k]))
                    for k in np.round(begins / run.sample_period).astype(int)
                ]
                off.setdefault((r.name, horizon), []).append(found)
    names = [f"{Path(f).stem}, whole" for f in UNSEEN]
    starts = {h: sum(map(len, off[rivals[0].name, h])) for h in HORIZONS}
    names += [f"{h:g} s, {starts[h]} starts: median, mean, better" for h in HORIZONS]
    print("| model | " + " | ".join(names) + " |\n|---|" + "---:|" * len(names))
    ours = {h: np.concatenate(off[rivals[2].name, h]) for h in HORIZONS}
    for r in rivals:
        cells = [f"{e:.3f}" for e in whole[r.name]]
        for h in HORIZONS:
            each = np.concatenate(off[r.name, h])
            cells.append(f"{np.median(each):.4f}, {np.mean(each):.4f}, {np.mean(each < ours[h]):.0%}")
        print(f"| {r.name} | " + " | ".join(cells) + " |")


def kept(folder: Path | None, name: str, found: Callable[[], Model]) -> Model:
    """Return the model of a name that is in a folder already, or that is found, and put there."""
    file = None if folder is None else folder / f"{name}.json"
    if file is not None and file.exists():
        return read_model(file)
    begin = time.perf_counter()
    model = found()
    print(f"{name}: identified in {time.perf_counter() - begin:.0f} s", flush=True)
    if file is not None:
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(to_json(model), encoding="utf-8")
    return model


def own(study: Study, folder: Path) -> Records:
    return read_records([folder / f for f in study.data.files], study.layout())


def run_error(model: Model, run: Record) -> float:
    """Return the root mean square error of the first coordinate in a free run of a whole recording."""
    driven = np.column_stack([run.column(i.name) for i in model.inputs])
    free = simulate(model, run.t, driven, initial_state(model, run))
    c = model.coordinates[0]
    return rms(free.column(c.name) + c.offset - run.column(c.name)) if free.ended is None else np.inf


def arm(folder: Path, models: Path | None) -> None:
    study, folder = read_study(STUDIES / "driven_double_pendulum.toml"), folder / "driven_double_pendulum"
    model = kept(models, "driven_double_pendulum", lambda: identify(study, own(study, folder)).model)
    arm_runs(study, folder, arm_rivals(study, folder, model))


def emps(folder: Path, models: Path | None) -> None:
    study = read_study(STUDIES / "emps.toml")
    records = own(study, folder / "emps")
    model = kept(models, "emps", lambda: identify(study, records).model)
    print("| free run of the whole record | mm |\n|---|---:|")
    for mass, rub, dry, beside in ((95.109, 203.50, 20.394, 3.165), (95.452, 214.93, 19.361, 3.290)):
        law = (
            ("q_ddot", "1", mass),
            (None, "q_dot", rub),
            (None, "sign(q_dot)", dry),
            (None, "1", -beside),
            (None, "force", -1.0),
        )
        ways = [
            msgspec.structs.replace(i, hold=hold, delay=delay)
            for i in model.inputs
            for hold in ("linear", "zero")
            for delay in (0.0, i.delay)
        ]
        stages = [relations(model.coordinates, (way,), {"q_ddot": law}).model for way in ways]
        best = min(run_error(stage, records.runs[0]) for stage in stages)
        print(f"| published, {mass} kg | {1e3 * best:.2f} |")
    print(f"| odescope | {1e3 * run_error(model, records.runs[0]):.2f} |")


def silverbox(folder: Path, models: Path | None) -> None:
    study = read_study(STUDIES / "silverbox.toml")
    run = own(study, folder / "silverbox").runs[0]
    seen = Records((run.part(0, len(run) - LAST),))
    model = kept(models, "silverbox", lambda: identify(study, seen).model)
    print("| free run of the last rows | mV |\n|---|---:|")
    print(f"| odescope | {1e3 * run_error(model, run.part(len(run) - LAST, len(run))):.3f} |")


CASES = {"arm": arm, "emps": emps, "silverbox": silverbox}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--only", nargs="+", choices=CASES, default=list(CASES))
    parser.add_argument("--keep", type=Path, help="folder of models that were identified")
    options = parser.parse_args()
    for name in options.only:
        print(f"\n{name}\n", flush=True)
        CASES[name](options.folder, options.keep)


if __name__ == "__main__":
    main()
