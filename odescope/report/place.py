"""Where results may go: not to a folder that the data come from, where the next run would read them as data."""

from __future__ import annotations

import fnmatch
from collections.abc import Iterable
from pathlib import Path

from odescope.recordings.readers import matches
from odescope.report.result_names import PATH_TABLE, RESULT_FILES


def reads_results(files: Iterable[str], folder: Path, place: Path) -> bool:
    """Say whether a study would read as data what its run writes to a folder.

    Results in folders below one with data are not read: of a folder only the files in itself are, but for Parquet
    files, which no results are.

    Args:
        files: of the study, folders and patterns among them.
        folder: that these are relative to.
        place: of the results.
    """
    own = place.resolve()
    for path in (folder / file for file in files):
        if any(found.is_dir() and found.resolve() == own for found in matches(path)):
            return True
        pattern = any(sign in path.name for sign in "*?")
        if pattern and path.parent.resolve() == own and fnmatch.filter((*RESULT_FILES, PATH_TABLE), path.name):
            return True
    return False


def default_place(named: Path, files: Iterable[str], folder: Path) -> Path:
    """Return the folder that results are called for, with "-results" behind it where the data come from that.

    Args:
        named: what the folder would be called.
        files: of the study.
        folder: that these are relative to.
    """
    return named.with_name(f"{named.name}-results") if reads_results(files, folder, named) else named
