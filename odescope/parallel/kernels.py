"""How a kernel is compiled, and where its machine code is kept.

Numba keeps it in the `__pycache__` of each module, where an uninstall leaves it, and does not notice when a kernel or a
constant of another module changes. So it has a place of its own: the folder `odescope.kernels` beside the package. The
wheel brings a file of that name, whose place the folder takes, and so an uninstall removes it. In a source tree it is
`odescope/__pycache__/kernels`, and the user's cache folder where neither can be written. NUMBA_CACHE_DIR goes first.
"""

from __future__ import annotations

import functools
import hashlib
import os
import sys
import tempfile
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path
from types import CodeType, FunctionType, ModuleType
from typing import Any, TypeVar

import numba
import numpy as np
from numba.core import caching, config, registry

import odescope

PACKAGE = Path(odescope.__file__).parent

Kernel = TypeVar("Kernel", bound=Callable[..., object])


def kernel(*fastmath: str, inline: bool = False) -> Callable[[Kernel], Kernel]:
    """Return a decorator that compiles a function at its first call, keeps the machine code, and lets threads run.

    The arguments are what floating-point arithmetic may do beyond IEEE 754: "contract" joins a product and a sum,
    "reassoc" takes sums in any order, and so in vector registers. Division by zero gives inf or nan, as in numpy.
    With `inline` its text takes the place of every call: arrays that are handed over a hundred thousand times in a
    second are then not counted each time.

    Kernels copy arrays by loops: to assign one to a slice compiles the text of numba's error too, for seconds.
    """
    options: dict[str, Any] = {"fastmath": set(fastmath)} if fastmath else {}
    options |= {"inline": "always"} if inline else {}

    def compile_lazily(function: Kernel) -> Kernel:
        lazy = numba.njit(nogil=True, error_model="numpy", **options)(function)
        if lazy is not function and _root() is not None:  # with NUMBA_DISABLE_JIT=1 it is the function itself
            with suppress(OSError):
                lazy._cache = _Cache(function)  # type: ignore[arg-type]
        return lazy  # type: ignore[no-any-return]

    return compile_lazily


def compiled(function: Callable[..., object]) -> bool:
    """Tell whether machine code of a kernel, as it reads now, is kept for this processor."""
    cache = getattr(function, "_cache", None)
    if cache is None:
        return True
    if cache.cache_path is None:
        return False
    machine = registry.cpu_target.target_context.codegen().magic_tuple()
    return any(
        made_for == machine and Path(cache.cache_path, file).exists()
        for (_, made_for, *_), file in cache._cache_file._load_index().items()
    )


def user_folder() -> Path:
    """Return the folder for this user's kernels, one for each version and place of odescope and each Python."""
    if sys.platform == "win32":
        home = Path(os.environ.get("LOCALAPPDATA") or Path.home() / "AppData" / "Local")
    elif sys.platform == "darwin":
        home = Path.home() / "Library" / "Caches"
    else:
        home = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    return home / "odescope" / f"{odescope.__version__}-{sys.implementation.cache_tag}-{_here()}"


def _here() -> str:
    return hashlib.sha256(str(PACKAGE).encode()).hexdigest()[:12]


@functools.cache
def _root() -> Path | None:
    """Return the first folder that can be written, or None: then kernels are compiled anew in each process."""
    if config.CACHE_DIR and _writable(folder := Path(config.CACHE_DIR, f"odescope-{_here()}")):
        return folder
    if _writable(folder := _shared()):
        return folder
    with suppress(RuntimeError):  # no home
        folder = user_folder()
        if _writable(folder, private=True):
            return folder
    return None


def _shared() -> Path:
    """Return the folder that goes with the package, free of the file that the wheel brought in its place."""
    if Path(__file__).with_name("kernels.txt").exists():  # a source tree: in the wheel that file has moved
        return PACKAGE / "__pycache__" / "kernels"
    folder = PACKAGE.parent / "odescope.kernels"
    if folder.is_file():
        with suppress(OSError):  # no right to it, or another process was faster
            folder.unlink()
    return folder


def _writable(folder: Path, private: bool = False) -> bool:
    """Make a folder and try to write there; a private one, since it holds code, must be this user's alone."""
    try:
        folder.parent.mkdir(parents=True, exist_ok=True)
        folder.mkdir(mode=0o700 if private else 0o777, exist_ok=True)
        if private and hasattr(os, "getuid"):
            status = folder.stat()
            if status.st_uid != os.getuid() or status.st_mode & 0o022:
                return False
        tempfile.TemporaryFile(dir=folder).close()
    except OSError:
        return False
    return True


class _Locator(caching._CacheLocator):  # type: ignore[misc]
    """Tells numba where a kernel's machine code is kept and what it was made from."""

    def __init__(self, function: FunctionType, file: str, root: Path) -> None:
        self._function = function
        self._py_file, self._lineno = file, function.__code__.co_firstlineno  # numba's warnings name them
        self._folder = root / Path(file).parent.name

    def get_cache_path(self) -> str:
        return str(self._folder)

    def get_source_stamp(self) -> bytes:
        return _stamp(self._function)

    def get_disambiguator(self) -> str:
        return "1"  # names are unique within a module; a line number would leave files behind whenever lines move

    @classmethod
    def from_function(cls, py_func: FunctionType, py_file: str) -> _Locator | None:
        root = _root()
        if root is None:
            return None
        locator = cls(py_func, py_file, root)
        locator.ensure_cache_path()
        return locator


class _Code(caching.CompileResultCacheImpl):  # type: ignore[misc]
    _locator_classes = (_Locator,)


class _Cache(caching.Cache):  # type: ignore[misc]
    _impl_class = _Code

    def __init__(self, function: FunctionType) -> None:
        super().__init__(function)
        # What was made from another source is passed over unread: it may name classes that are there no more.
        self._cache_file._version += _stamp(function).hex()


@functools.cache
def _stamp(function: FunctionType) -> bytes:
    """Return a digest of all that a kernel's machine code was made from, in this file and others."""
    digest = hashlib.sha256(_source(function.__code__.co_filename))
    for name in sorted(set(_names(function.__code__))):
        digest.update(_fingerprint(function.__globals__.get(name)))
    return digest.digest()


def _names(code: CodeType) -> Iterator[str]:
    yield from code.co_names
    for constant in code.co_consts:
        if isinstance(constant, CodeType):
            yield from _names(constant)


def _fingerprint(value: object) -> bytes:
    """Return what machine code takes from a global name: another kernel's stamp, or a constant."""
    if hasattr(value, "py_func"):
        return _stamp(value.py_func)
    if isinstance(value, (tuple, list)):
        return b"".join(map(_fingerprint, value))
    if isinstance(value, np.ndarray):
        return value.tobytes()
    if isinstance(value, ModuleType) and value.__name__.startswith("odescope."):
        return _source(str(value.__file__))
    return repr(value).encode() if isinstance(value, (bool, int, float, complex, str, np.generic)) else b""


@functools.cache
def _source(file: str) -> bytes:
    try:
        return hashlib.sha256(Path(file).read_bytes()).digest()
    except OSError:  # text that was never in a file
        return b""
