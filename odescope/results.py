"""The files of an identification, written so that a stop in the middle leaves no half file (DESIGN 3.1, 3.4)."""

from __future__ import annotations

import csv
import io
import os
import shutil
import tempfile
from collections.abc import Mapping
from pathlib import Path

from odescope.errors import InputError
from odescope.export.modelfile import to_json
from odescope.identification import Identification
from odescope.study import Study, study_toml

CANDIDATE_COLUMNS = (
    "target",
    "guess",
    "support",
    "number_of_terms",
    "consensus",
    "implicit_rmse",
    "acceleration_rmse",
    "rank",
    "chosen",
    "family",
    "cluster",
    "criterion",
)


def candidates_csv(result: Identification) -> str:
    """Return candidates.csv: one row a family member, best first in each target."""
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow(CANDIDATE_COLUMNS)
    for search, chosen in zip(result.searches, result.chosen, strict=True):
        terms = search.problem.terms
        for rank, c in enumerate(search.ranked.candidates, start=1):
            support = " + ".join(terms[j].text for j in c.support)
            writer.writerow(
                (
                    c.target,
                    terms[c.guess].text,
                    support,
                    len(c.support),
                    len(c.guesses),
                    repr(c.implicit_rmse),
                    repr(c.target_rmse),
                    rank,
                    int(c is chosen),
                    c.family + 1,
                    c.cluster,
                    repr(c.criterion),
                )
            )
    return out.getvalue()


def result_files(result: Identification, resolved: Study, html: str) -> dict[str, str]:
    """Return the files of a result by name."""
    return {
        "model.json": to_json(result.model),
        "candidates.csv": candidates_csv(result),
        "report.html": html,
        "study.toml": study_toml(resolved),
    }


def check_writable(folder: Path) -> None:
    """Refuse early, before anything is computed, a folder that cannot be written.

    Raises:
        InputError: the folder is a file, or cannot be made or written to.
    """
    existing = folder
    while not existing.exists() and existing != existing.parent:
        existing = existing.parent
    if not existing.is_dir():
        raise InputError(f"cannot write results to {folder}: {existing} is not a folder")
    try:
        with tempfile.TemporaryFile(dir=existing):
            pass
    except OSError as error:
        raise InputError(f"cannot write results to {folder}: {error.strerror or error}") from error


def write_files(folder: Path, files: Mapping[str, str]) -> None:
    """Write texts to files of a folder: all are complete beside it before the first takes its place.

    Raises:
        InputError: the folder cannot be written.
    """
    try:
        folder.parent.mkdir(parents=True, exist_ok=True)
        partial = Path(tempfile.mkdtemp(prefix=f".{folder.name}-", dir=folder.parent))
        try:
            for name, text in files.items():
                (partial / name).write_text(text, encoding="utf-8", newline="\n")
            if folder.exists():
                for name in files:
                    os.replace(partial / name, folder / name)
            else:
                partial.chmod(0o755)
                os.replace(partial, folder)
        finally:
            shutil.rmtree(partial, ignore_errors=True)
    except OSError as error:
        raise InputError(f"cannot write results to {folder}: {error.strerror or error}") from error


def write_file(path: Path, text: str) -> None:
    """Write one file, complete beside its place before it takes it.

    Raises:
        InputError: it cannot be written.
    """
    if path.is_dir():
        raise InputError(f"cannot write {path}: it is a folder; name a file")
    try:
        with tempfile.NamedTemporaryFile("w", encoding="utf-8", newline="\n", dir=path.parent, delete=False) as partial:
            partial.write(text)
        os.replace(partial.name, path)
    except OSError as error:
        raise InputError(f"cannot write {path}: {error.strerror or error}") from error
