"""Fingerprints: whether two objects, perhaps of two runs of the program, are sure to do the same."""

from __future__ import annotations

import copyreg
import hashlib
import sys
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from types import BuiltinFunctionType, CodeType, FunctionType, MethodType, ModuleType

import numpy as np

from odescope.errors import InputError

PLAIN = (bool, int, float, complex, str, bytes, bytearray, type(None), type(...))
DEEPEST = 100  # levels of objects within objects
INSTALLED = {"site-packages", "dist-packages"}  # folders of packages that others made


def fingerprint(value: object) -> str:
    """Return a digest of an object: its class, all of its state, and the source of classes and functions of one's own.

    The digest is the same in another run only where all of these are; it may differ without need.

    Raises:
        InputError: the state of some object within cannot be told.
    """
    return _digest(value, 0)


def _digest(value: object, depth: int) -> str:
    found = hashlib.sha256()
    for text in _walk(value, depth):
        found.update(len(text).to_bytes(8, "little"))
        found.update(text)
    return found.hexdigest()


def _walk(value: object, depth: int) -> Iterator[bytes]:
    """Yield all that an object depends on."""
    if depth > DEEPEST:
        raise InputError(f"store: an object of class {_name(type(value))} holds itself, or others too deep to compare")
    within = depth + 1
    if type(value) in PLAIN:
        yield f"{type(value).__name__} {value!r}".encode()
    elif isinstance(value, np.ndarray) and value.dtype.kind != "O":
        yield f"array {value.dtype.str} {value.shape}".encode()
        yield value.tobytes()
    elif isinstance(value, dict):
        yield f"{_name(type(value))} {len(value)}".encode()
        yield from sorted(_digest(item, within).encode() for item in value.items())
    elif isinstance(value, set | frozenset):
        yield f"{_name(type(value))} {len(value)}".encode()
        yield from sorted(_digest(item, within).encode() for item in value)
    elif isinstance(value, list | tuple):
        yield f"{_name(type(value))} {len(value)}".encode()
        for item in value:
            yield from _walk(item, within)
    elif isinstance(value, type):
        yield b"class " + _name(value).encode()
        for base in value.__mro__:
            yield from _source(base, base.__module__)
    elif isinstance(value, MethodType):
        yield from _walk((value.__func__, value.__self__), within)
    elif isinstance(value, FunctionType):
        yield f"function {value.__module__}.{value.__qualname__}".encode()
        yield from _source(value, value.__module__)
        closed = tuple(cell.cell_contents for cell in value.__closure__ or ())
        yield from _walk((value.__defaults__, value.__kwdefaults__, closed), within)
    elif isinstance(value, BuiltinFunctionType | ModuleType):
        yield repr((getattr(value, "__module__", None), value.__name__)).encode()
    else:
        yield from _walk(type(value), within)
        yield from _walk(_state(value), within)


def _name(kind: type) -> str:
    return f"{kind.__module__}.{kind.__qualname__}"


def _state(value: object) -> object:
    """Return of what an object would be made again, as pickle asks for it; nothing is pickled here."""
    try:
        reducer = copyreg.dispatch_table.get(type(value))
        made = value.__reduce_ex__(4) if reducer is None else reducer(value)
    except Exception as error:  # whatever a class of one's own, or of C, may say
        raise InputError(
            f"store: an object of class {_name(type(value))} cannot be compared with that of another run ({error});"
            " keep its state in plain attributes, or run without a store"
        ) from error
    if isinstance(made, str):  # the name of a global: it has no state of its own
        return made
    function, arguments, *rest = made
    plain = getattr(function, "__module__", "") == "copyreg"  # how any object is made: the arguments are its class
    items = [list(part) if hasattr(part, "__next__") else part for part in rest]
    return ([a for a in arguments if a is not type(value)] if plain else (function, arguments), items)


def _source(thing: type | FunctionType, module: str) -> Iterator[bytes]:
    """Yield the source of what is not Python's or odescope's: its code, its file, and files of one's own that it uses.

    The code as well as the file, which may have been edited since it was loaded. Other packages are assumed to stay.
    """
    home = sys.modules.get(module)
    if home is None or _ours(home):
        return
    yield from _code(thing)
    for file in sorted(_files(home, set())):
        yield file.read_bytes()


def _code(thing: object) -> Iterator[bytes]:
    """Yield the compiled code of a function, or of what a class defines, and the constants in it."""
    if isinstance(thing, FunctionType):
        yield from _compiled(thing.__code__)
    elif isinstance(thing, type):
        for name, value in sorted(vars(thing).items()):
            inner = getattr(value, "__func__", getattr(value, "fget", value))
            if isinstance(inner, FunctionType):
                yield name.encode()
                yield from _compiled(inner.__code__)
            elif type(inner) in PLAIN and name != "__firstlineno__":
                yield f"{name} {inner!r}".encode()


def _compiled(constant: object) -> Iterator[bytes]:
    if isinstance(constant, CodeType):
        yield constant.co_code
        yield repr((constant.co_names, constant.co_varnames, constant.co_freevars)).encode()
        for inner in constant.co_consts:
            yield from _compiled(inner)
    else:  # a set shows its items in another order in each run
        yield repr(sorted(map(repr, constant)) if isinstance(constant, frozenset) else constant).encode()


def _files(module: ModuleType, seen: set[Path]) -> set[Path]:
    """Return the file of a module, and those of one's own that its globals come from."""
    file = _file(module)
    if file is None or file in seen:
        return seen
    seen.add(file)
    for value in list(vars(module).values()):
        name = value.__name__ if isinstance(value, ModuleType) else getattr(value, "__module__", None)
        origin = sys.modules.get(name) if isinstance(name, str) else None
        if origin is not None and not _ours(origin) and not INSTALLED & set((_file(origin) or Path()).parts):
            _files(origin, seen)
    return seen


def _file(module: ModuleType) -> Path | None:
    path = getattr(module, "__file__", None)
    return _resolved(path) if path else None


@cache  # a module is met once for every global that comes from it, thousands of times
def _resolved(path: str) -> Path | None:
    return Path(path).resolve() if Path(path).is_file() else None


def _ours(module: ModuleType) -> bool:
    """Whether a module is odescope's or Python's, whose versions are known or assumed to stay."""
    name = module.__name__.partition(".")[0]
    return name == "odescope" or (name in sys.stdlib_module_names and name != "__main__")
