"""What it takes to do an identification again: a study that runs as it is printed, and the versions behind it."""

from __future__ import annotations

import os
import platform
from importlib.metadata import version
from pathlib import Path

import msgspec

from odescope.pipeline.identification import Identification
from odescope.report.data import Reproduce, Stage
from odescope.study.options import Filtering, Regression, Study, moved, study_toml

PACKAGES = ("numpy", "scipy", "numba", "matplotlib")


def reproduce(result: Identification) -> Reproduce:
    """Return the study as the page prints it, the seed, the versions and the stages."""
    study = _beside_data(result.study)
    return Reproduce(
        study=_printed(study),
        files=study.data.files,
        seed=study.random.seed,
        versions=_versions(),
        stages=tuple(
            Stage(name=name, seconds=round(seconds, 4), peak=result.memory.get(name))
            for name, seconds in result.seconds.items()
        ),
    )


def _beside_data(study: Study) -> Study:
    """Return the study with its files named from the folder that holds them all: saved there, it runs."""
    try:
        folder = os.path.commonpath([str(Path(file).resolve().parent) for file in study.data.files] or ["."])
    except ValueError:  # several drives, on Windows
        folder = "."
    return moved(study, Path(), Path(folder))


def _printed(study: Study) -> str:
    """Return the study as TOML; of pieces of one's own, which it cannot say, there are comments, and the defaults."""
    try:
        return study_toml(study)
    except TypeError:
        signals, regression = study.signals, study.regression
        places: tuple[tuple[str, tuple[object, ...]], ...] = (
            ("signals.differentiator", (signals.differentiator,)),
            ("regression.rows", (regression.rows,)),
            ("regression.proposers", regression.proposers),
        )
        own = {key: [p for p in pieces if not isinstance(p, msgspec.Struct)] for key, pieces in places}
        if own["signals.differentiator"]:
            signals = msgspec.structs.replace(signals, differentiator=Filtering().differentiator)
        if own["regression.rows"]:
            regression = msgspec.structs.replace(regression, rows=Regression().rows)
        known = tuple(p for p in regression.proposers if p not in own["regression.proposers"])
        regression = msgspec.structs.replace(regression, proposers=known or Regression().proposers)
        lines = [f"# {key}: a piece of one's own, {type(p).__name__}\n" for key, found in own.items() for p in found]
        return "".join(lines) + study_toml(msgspec.structs.replace(study, signals=signals, regression=regression))


def _versions() -> tuple[tuple[str, str], ...]:
    from odescope import __version__

    python = ("Python", f"{platform.python_version()}, {platform.system()} {platform.machine()}")
    return (("odescope", __version__), python, *((name, version(name)) for name in PACKAGES))
