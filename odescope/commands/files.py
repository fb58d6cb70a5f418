"""The files of an identification, written so that a stop in the middle leaves no half file."""

from __future__ import annotations

import csv
import io
import tempfile
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from pathlib import Path

from odescope.errors import InputError
from odescope.export.model_file import to_json
from odescope.files import write_files
from odescope.model.model import Model
from odescope.model.prediction import relation_errors
from odescope.model.scores import PathScore
from odescope.pipeline.identification import Identification
from odescope.report.result_names import FIGURES, MODEL, NO_MODEL, PATH, PATH_MODEL, PATH_TABLE, REPORT, RESULT_FILES
from odescope.study.options import Study
from odescope.study.toml import study_toml

PATH_MODELS = f"{PATH}/[0-9]*{PATH_MODEL}"
WRITTEN = (*RESULT_FILES, PATH_TABLE, PATH_MODELS, NO_MODEL, f"{FIGURES}/*.svg", f"{FIGURES}/*.png")
MARKED = 400  # bytes in which a file says that odescope wrote it
MARKS = (
    (MODEL, b'"odescope/model"'),
    (REPORT, b'"odescope/report"'),
    (NO_MODEL, b'content="odescope"'),
)
LISTED = 4  # files in a message

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
    "inclusion",
)


PATH_COLUMNS = ("terms", "held_out_error", "spread", "chosen", "dropped", "statistic", "support")


def candidates_csv(result: Identification) -> str:
    """Return candidates.csv: one row a family member, best first in each target; those of the model are chosen."""
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow(CANDIDATE_COLUMNS)
    for search, chosen in zip(result.searches, result.chosen, strict=True):
        terms = search.problem.terms
        for rank, c in enumerate(search.ranked.candidates, start=1):
            # As terms of the library, their factors in canonical order: what programs compare.
            support = " + ".join(terms[j].expanded.text for j in c.support)
            writer.writerow(
                (
                    c.target,
                    terms[c.guess].expanded.text,
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
                    "" if search.inclusion is None else repr(float(search.inclusion[list(c.support)].min())),
                )
            )
    writer.writerows(_no_candidates(result))
    return out.getvalue()


def _no_candidates(result: Identification) -> Iterator[tuple[object, ...]]:
    """Yield a row for every relation of the model that is no candidate, as one behind all of these."""
    candidates = {s.problem.target: (s, c) for s, c in zip(result.searches, result.chosen, strict=True)}
    if len(candidates) == len(result.model.targets) and None not in result.chosen:
        return
    model, signals, columns = result.model, result.signals, result.signals.joined()
    variables, targets = (columns[[signals.row(n) for n in names]] for names in (model.variables, model.targets))
    found = relation_errors(model, variables, targets)
    for target, relation, errors in zip(model.targets, model.relations, found, strict=True):
        search, chosen = candidates.get(target, (None, None))
        if chosen is None:
            ranked = () if search is None else search.ranked.candidates
            support = " + ".join(t.product.expanded.text for t in relation.terms)
            family = 1 + max((c.family + 1 for c in ranked), default=0)
            told = (target, "", support, len(relation.terms), 0, *map(repr, errors))
            yield (*told, len(ranked) + 1, 1, family, "", "", "")


def result_files(result: Identification, resolved: Study, report: Mapping[str, str | bytes]) -> dict[str, str | bytes]:
    """Return the files of a result by name, with those of its report.

    Args:
        result: what `identify` returned.
        resolved: the study, its files relative to the folder of the results.
        report: files of the report by name.
    """
    texts = (to_json(result.model), candidates_csv(result), study_toml(resolved))
    shorter = {f"{PATH}/{score.terms}{PATH_MODEL}": to_json(model) for score, model in _on_path(result)}
    table = {PATH_TABLE: path_csv(result)} if shorter else {}
    return {**dict(zip(RESULT_FILES, texts, strict=False)), **table, **shorter, **report}


def _on_path(result: Identification) -> list[tuple[PathScore, Model]]:
    scores = result.model.scores
    return [] if scores is None else list(zip(scores.path, result.path, strict=True))


def path_csv(result: Identification) -> str:
    """Return path.csv: one row a model on the path from many terms to few."""
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow(PATH_COLUMNS)
    for score, model in _on_path(result):
        own = [t.text for r in model.relations for t in r.terms]
        support = [f"{m.name} in {m.kind}" for m in model.mechanisms] or own
        writer.writerow(
            (
                score.terms,
                repr(score.error),
                repr(score.spread),
                int(score.chosen),
                score.dropped or "",
                "" if score.statistic is None else repr(score.statistic),
                " + ".join(support),
            )
        )
    return out.getvalue()


def check_writable(folder: Path) -> None:
    """Refuse early, before anything is computed, a folder that cannot be written.

    Raises:
        InputError: the folder is a file, cannot be made or written to, or holds a folder where a result belongs.
    """
    try:
        existing = folder
        while not existing.exists() and existing != existing.parent:
            existing = existing.parent
        if not existing.is_dir():
            raise InputError(f"cannot write to {folder}: {existing} is not a folder; name another with --out")
        for name in RESULT_FILES:
            if (folder / name).is_dir():
                raise InputError(f"cannot write to {folder}: its {name} is a folder; name another with --out")
        for name in (FIGURES, PATH):
            if (folder / name).exists() and not (folder / name).is_dir():
                raise InputError(f"cannot write to {folder}: its {name} is no folder; name another with --out")
        with tempfile.TemporaryFile(dir=existing):
            pass
    except OSError as error:
        raise InputError(f"cannot write to {folder}: {error.strerror or error}") from error


def refuse_foreign(folder: Path, written: Iterable[str], marks: Sequence[tuple[str, bytes]] = MARKS) -> None:
    """Refuse, before anything is computed, a folder with files that are no results and whose place results would take.

    A folder with earlier results is theirs: new ones replace them. In any other, which may be that of a project, files
    that happen to be called like results stay as they are.

    Args:
        folder: for results.
        written: names of files that are to come; of folders in it, patterns.
        marks: files, and what they begin with, that say that the folder is one with earlier results.

    Raises:
        InputError: such files are there.
    """
    if any(_holds(folder / name, mark) for name, mark in marks):
        return
    foreign = sorted({path.relative_to(folder).as_posix() for name in written for path in folder.glob(name)})
    if foreign:
        more = ", ..." if len(foreign) > LISTED else ""
        raise InputError(
            f"{folder}/ holds {', '.join(foreign[:LISTED])}{more} and no results of odescope, which would take their"
            " place; name another folder with --out"
        )


def _holds(path: Path, mark: bytes) -> bool:
    """Say whether a file begins with a mark, within what a line or two take."""
    if not path.is_file():
        return False
    with path.open("rb") as file:
        return mark in file.read(MARKED)


def refuse_overwriting(targets: Iterable[Path], sources: Iterable[Path]) -> None:
    """Refuse, before anything is computed, to write a result over a file that it is made from.

    Raises:
        InputError: a target is one of the sources.
    """
    read = {source.resolve() for source in sources}
    for target in targets:
        if target.resolve() in read:
            raise InputError(f"the result would overwrite {target}, which it is made from; name another with --out")


def write_results(folder: Path, files: Mapping[str, str | bytes]) -> None:
    """Write the files of a result, and remove what an earlier run left of a path or of no model.

    Raises:
        InputError: the folder cannot be written.
    """
    write_files(folder, files)
    try:
        (folder / NO_MODEL).unlink(missing_ok=True)
        for model in folder.glob(PATH_MODELS):
            if f"{PATH}/{model.name}" not in files:
                model.unlink()
        if PATH_TABLE not in files:
            (folder / PATH_TABLE).unlink(missing_ok=True)
            with suppress(OSError):  # something else is in it
                (folder / PATH).rmdir()
    except OSError as error:
        raise InputError(f"cannot write to {folder}: {error.strerror or error}") from error
