"""What it takes to do an identification again: a study that runs as it is printed, and the versions behind it."""

from __future__ import annotations

import os
import platform
from importlib.metadata import version
from pathlib import Path

from odescope.pipeline.identification import Identification
from odescope.report.data import Reproduce, Stage
from odescope.study.options import Study
from odescope.study.toml import moved, study_toml

PACKAGES = ("numpy", "scipy", "numba", "matplotlib")


def reproduce(result: Identification) -> Reproduce:
    """Return the study as the page prints it, the seed, the versions and the stages."""
    study = _beside_data(result.study)
    return Reproduce(
        study=study_toml(study),
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


def _versions() -> tuple[tuple[str, str], ...]:
    from odescope import __version__

    python = ("Python", f"{platform.python_version()}, {platform.system()} {platform.machine()}")
    return (("odescope", __version__), python, *((name, version(name)) for name in PACKAGES))
