"""The study of logs: which of a folder go together, what their study is called, and what a look at them says."""

from __future__ import annotations

import asyncio
import re
from collections.abc import Iterable, Sequence
from functools import lru_cache
from itertools import count
from pathlib import Path

from nicegui import run
from nicegui.run import SubprocessException

from odescope.errors import InputError
from odescope.recordings.readers import column_names
from odescope.study.draft import Drafted, draft
from odescope.study.toml import parse_study
from odescope.workbench.folder import Folder
from odescope.workbench.frame import aside

SMALL = 20_000_000  # bytes of files that are looked at in no time
Known = tuple[Path, int, int]  # a file, when it was changed and its size
DRAFTED: dict[tuple[Known, ...], Drafted] = {}


def alike(folder: Folder, name: str) -> tuple[str, ...]:
    """Return the other logs of a folder that have the columns of one, those beside it first.

    Raises:
        InputError: the columns of the log itself cannot be read.
    """
    own, found = _columns(_known(folder.inside(name))), list[str]()
    for other in folder.logs():
        try:
            same = other != name and _columns(_known(folder.inside(other))) == own
        except InputError:  # its own page says what is wrong with it
            continue
        if same:
            found.append(other)
    place = folder.inside(name).parent
    return tuple(sorted(found, key=lambda other: folder.inside(other).parent != place))


def in_order(names: Iterable[str]) -> list[str]:
    """Return logs in the order of a study of them: those of folders above first, then by their names, 2 before 10."""
    return sorted(names, key=lambda n: (n.count("/"), [int(p) if p.isdecimal() else p for p in re.split(r"(\d+)", n)]))


def study_of(folder: Folder, names: Sequence[str]) -> tuple[Path, bool]:
    """Return where the study of logs is, or is to be written, and whether it is there.

    It lies beside the first of them and is called as `odescope init` has it, with a number behind where another study
    or the results of one have that name. Of one log the study of its name is the one, unless it is known to be of
    others alone.
    """
    files = [folder.inside(name) for name in names]
    stem = files[0].name.removesuffix(".gz").rpartition(".")[0]
    stem += f"-and-{len(files) - 1}-more" if len(files) > 1 else ""
    for number in count(1):
        path = files[0].parent / f"{stem}{'' if number == 1 else f'-{number}'}.toml"
        if not path.exists():
            if len(files) == number == 1 or not path.with_suffix("").exists():
                return path, False
            continue
        read = _files(folder, path)
        own = {file.resolve() for file in files}
        if read == own or (len(files) == 1 and number == 1 and (read is None or own <= read)):
            return path, True
    raise AssertionError("numbers do not end")


async def drafted_from(files: Sequence[Path]) -> Drafted:
    """Return the study of logs; one that was drafted from the files as they are now is at hand.

    Raises:
        InputError: there is nothing to identify in them.
        asyncio.CancelledError: the server ends.
    """
    known = tuple(map(_known, files))
    if known not in DRAFTED:
        DRAFTED[known] = await _draft(list(files), sum(size for _, _, size in known))
    return DRAFTED[known]


async def _draft(files: list[Path], size: int) -> Drafted:
    """Draft the study of logs; a long look is taken in another process, since it would hold up the pages of this.

    Args:
        files: of data, the first of which the study lies beside.
        size: of them all, in bytes.

    Raises:
        InputError: there is nothing to identify in them.
        asyncio.CancelledError: the server ends.
    """
    if size < SMALL:
        return await aside(draft, files, files, files[0].parent)
    try:
        found = await run.cpu_bound(draft, files, files, files[0].parent)
    except SubprocessException as error:
        raise InputError(error.original_message) from error
    if found is None:
        raise asyncio.CancelledError
    return found


def _files(folder: Folder, study: Path) -> set[Path] | None:
    """Return the files of a study, None where that cannot be said."""
    try:
        found = folder.files_of(parse_study(study.read_text(encoding="utf-8")), study.parent)
    except (OSError, UnicodeDecodeError, InputError):
        return None
    return {file.resolve() for file in found}


def _known(path: Path) -> Known:
    try:
        about = path.stat()
    except OSError as error:
        raise InputError(f"no such file: {path.name}") from error
    return path, about.st_mtime_ns, about.st_size


@lru_cache(maxsize=1000)
def _columns(known: Known) -> frozenset[str]:
    return frozenset(column_names(known[0]))
