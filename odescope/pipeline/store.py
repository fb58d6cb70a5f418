"""Where factors of finished chunks are kept, so that nothing is done twice."""

from __future__ import annotations

import hashlib
import json
import os
import secrets
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from zipfile import BadZipFile

import numpy as np

from odescope.arrays import FloatArray
from odescope.recordings.chunks import Chunk
from odescope.regression.factor import Factor

OUTGROWN = 2.0  # times the rows there were when the sample was drawn: then another is


@dataclass(frozen=True, eq=False)
class Reduced:
    """What is kept of a chunk: for each target factors of pieces with their folds; the extremes of every signal."""

    factors: tuple[tuple[tuple[int, Factor], ...], ...]
    low: FloatArray
    high: FloatArray
    rows: int
    recordings: int


@dataclass(frozen=True)
class Store:
    """Where factors of finished chunks of a study are kept, so that nothing is done twice.

    Nothing of it is executed when it is read. `study` is a digest of the options; `served` collects the names of what
    was read and written.
    """

    root: Path
    study: str
    served: set[str] = field(default_factory=set, compare=False)

    @property
    def folder(self) -> Path:
        """The study's own folder."""
        return self.root / self.study[:16]

    def sampled(self, chunks: Sequence[Chunk], rows: int) -> tuple[Chunk, ...]:
        """Return the chunks of which decisions were made before; none where they changed, or the log has doubled."""
        try:
            kept = json.loads((self.folder / "sample.json").read_text(encoding="utf-8"))
            known = {self._identity(p): p for p in chunks}
            return tuple(known[name] for name in kept["chunks"]) if rows <= OUTGROWN * kept["rows"] else ()
        except (OSError, ValueError, TypeError, KeyError):  # none yet, or of other files
            return ()

    def keep_sample(self, chunks: Sequence[Chunk], rows: int) -> None:
        """Keep the chunks of which decisions are made, and the rows of the log."""
        content = {"rows": rows, "chunks": [self._identity(p) for p in chunks]}
        self._write("sample.json", lambda path: path.write_text(json.dumps(content), encoding="utf-8"))

    def key(self, plan: str, chunk: Chunk, fold: int) -> str:
        """Return the name under which the factors of a chunk are kept: it says all that these depend on.

        Args:
            plan: a digest of what turns chunks into factors.
            chunk: whose factors they are.
            fold: the number that they carry.
        """
        return f"{digest([plan, self._identity(chunk), chunk.before, chunk.after, fold])}.npz"

    def holds(self, key: str) -> bool:
        """Return whether something is kept under a name."""
        return (self.folder / key).exists()

    def read(self, key: str) -> Reduced | None:
        """Return what is kept under a name, None where it is not there or damaged."""
        self.served.add(key)
        try:
            with (self.folder / key).open("rb") as file, np.load(file, allow_pickle=False) as arrays:
                return _unpacked(arrays)
        except (OSError, ValueError, KeyError, EOFError, BadZipFile):
            return None

    def write(self, key: str, reduced: Reduced) -> None:
        """Keep the factors of a chunk."""
        self.served.add(key)
        self._write(key, lambda path: _save(path, _packed(reduced)))

    def prune(self) -> None:
        """Remove the study's factors that served nothing: a run may read the log several times, each with a plan."""
        for name in {path.name for path in self.folder.glob("*.npz")} - self.served:
            (self.folder / name).unlink(missing_ok=True)

    def _write(self, name: str, write: Callable[[Path], object]) -> None:
        self.folder.mkdir(parents=True, exist_ok=True)
        partial = self.folder / f".{secrets.token_hex(8)}"
        try:
            write(partial)
            os.replace(partial, self.folder / name)
        finally:
            partial.unlink(missing_ok=True)

    @staticmethod
    def _identity(chunk: Chunk) -> str:
        about = chunk.path.stat()
        return f"{chunk.path.resolve()}|{about.st_size}|{about.st_mtime_ns}|{chunk.first}|{chunk.stop}"


def digest(about: Sequence[str | int]) -> str:
    """Return a short digest of texts and numbers."""
    return hashlib.sha256(json.dumps(about).encode()).hexdigest()[:32]


def _save(path: Path, arrays: dict[str, FloatArray]) -> None:
    with path.open("wb") as file:  # by its name alone NumPy would give it an ending
        np.savez(file, **arrays)  # type: ignore[arg-type]


def _packed(reduced: Reduced) -> dict[str, FloatArray]:
    arrays = {"low": reduced.low, "high": reduced.high, "counts": np.array([reduced.rows, reduced.recordings])}
    for t, factors in enumerate(reduced.factors):
        arrays[f"about{t}"] = np.array([[fold, f.rows] for fold, f in factors]).reshape(-1, 2)
        arrays[f"r{t}"] = np.array([f.r for _, f in factors])
        arrays[f"scale{t}"] = np.array([f.scale for _, f in factors])
    return arrays


def _unpacked(file: np.lib.npyio.NpzFile) -> Reduced:
    targets = sum(name.startswith("about") for name in file.files)
    factors = tuple(
        tuple(
            (int(fold), Factor(r, scale, int(rows)))
            for (fold, rows), r, scale in zip(file[f"about{t}"], file[f"r{t}"], file[f"scale{t}"], strict=True)
        )
        for t in range(targets)
    )
    rows, recordings = (int(n) for n in file["counts"])
    return Reduced(factors, file["low"], file["high"], rows, recordings)
