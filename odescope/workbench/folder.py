"""The folder of a workbench: paths that stay in it, and the logs, studies and results that it holds."""

from __future__ import annotations

import os
import tomllib
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path, PurePosixPath, PureWindowsPath
from typing import TYPE_CHECKING

from odescope.errors import InputError
from odescope.recordings.formats import FORMATS
from odescope.recordings.readers import find_files
from odescope.report.result_names import MODEL, NO_MODEL

if TYPE_CHECKING:
    from odescope.study.options import Study

DEPTH = 4  # folders within folders that are looked into
MOST = 500  # files that are listed
ENDINGS = tuple(ending for kind in FORMATS for ending in kind.endings)
STUDY = ".toml"
LARGEST_STUDY = 1_000_000  # bytes


@dataclass(frozen=True)
class Folder:
    """A folder, by its resolved path."""

    root: Path

    @staticmethod
    def of(path: Path) -> Folder:
        """Return the folder of a path.

        Raises:
            InputError: it is none.
        """
        if not path.is_dir():
            raise InputError(f"{path} is no folder: name the one that holds the logs")
        return Folder(path.resolve())

    def inside(self, text: str) -> Path:
        """Return the path that a text names from the folder on, which need not exist yet.

        Raises:
            InputError: it leads out of the folder, by its parts or by a symbolic link.
        """
        windows = PureWindowsPath(text)
        absolute = PurePosixPath(text).is_absolute() or windows.is_absolute() or windows.drive or windows.root
        if not text or "\0" in text or absolute or ".." in windows.parts:
            raise InputError(f"{text!r} is no path within {self.root.name}")
        path = self.root / text
        self.check(path)
        return path

    def check(self, path: Path) -> None:
        """Refuse a path that lies outside, wherever symbolic links lead.

        Raises:
            InputError: it does.
        """
        try:
            within = path.resolve().is_relative_to(self.root)
        except (OSError, RuntimeError):  # a circle of links
            within = False
        if not within:
            raise InputError(f"{path.name!r} lies outside {self.root.name}, the folder of this workbench")

    def name(self, path: Path) -> str:
        """Return the path of something in the folder, from there on, with slashes."""
        return path.relative_to(self.root).as_posix()

    def files_of(self, study: Study, place: Path) -> tuple[Path, ...]:
        """Return the data files of a study that lies in `place`, all of them inside.

        Raises:
            InputError: one is not there, or lies outside.
        """
        found = find_files([place / file for file in study.data.files])
        for path in found:
            self.check(path)
        return found

    def logs(self) -> tuple[str, ...]:
        """Return the data files."""
        return self._listed(lambda path: path.name.lower().endswith(ENDINGS))

    def studies(self) -> tuple[str, ...]:
        """Return the studies: files of TOML with coordinates."""
        return self._listed(_is_study)

    def results(self) -> tuple[str, ...]:
        """Return the folders of results, those that changed last first."""
        found = [place for place, names in self._places() if MODEL in names or NO_MODEL in names]
        found.sort(key=lambda place: -max((place / name).stat().st_mtime for name in _there(place)))
        return tuple(self.name(place) for place in found if place != self.root)

    def _listed(self, wanted: Callable[[Path], bool]) -> tuple[str, ...]:
        found = []
        for place, names in self._places():
            if place != self.root and (MODEL in names or NO_MODEL in names):
                continue  # what lies there was written by a run
            for name in names:
                path = place / name
                if wanted(path) and self._holds(path):
                    found.append(self.name(path))
        return tuple(sorted(found, key=lambda name: (name.count("/"), name))[:MOST])

    def _holds(self, path: Path) -> bool:
        try:
            self.check(path)
        except InputError:
            return False
        return path.is_file()

    def _places(self) -> Iterator[tuple[Path, list[str]]]:
        """Yield the folders that are looked into, and the names of the files in each; no hidden ones."""
        for place, folders, names in os.walk(self.root):
            here = Path(place)
            deep = len(here.relative_to(self.root).parts) >= DEPTH
            folders[:] = [] if deep else sorted(name for name in folders if name[0] not in "._")
            yield here, sorted(name for name in names if name[0] not in "._")


def _there(place: Path) -> list[str]:
    return [name for name in (MODEL, NO_MODEL) if (place / name).exists()]


def _is_study(path: Path) -> bool:
    if path.suffix.lower() != STUDY:
        return False
    try:
        return path.stat().st_size < LARGEST_STUDY and "coordinates" in tomllib.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError):
        return False
