"""The reference of the Python package, as Markdown: every public name, from its docstring, under its package."""

from __future__ import annotations

import dataclasses
import inspect
import re
from importlib import import_module

import msgspec

import odescope

# What most people call comes first; a package that is not named here comes after these.
FIRST = ("pipeline", "study", "model", "validation", "observer", "export", "recordings", "signals", "library")


def python_reference() -> str:
    """Return one section a package with its public names."""
    packages: dict[str, list[str]] = {}
    for name, home in odescope._HOME.items():
        packages.setdefault(home.partition(".")[0], []).append(name)
    order = [*FIRST, *(package for package in packages if package not in FIRST)]
    return "\n\n".join(_section(package, packages[package]) for package in order if package in packages)


def _section(package: str, names: list[str]) -> str:
    text = (import_module(f"odescope.{package}").__doc__ or "").strip()
    functions_first = sorted(names, key=lambda name: (inspect.isclass(getattr(odescope, name)), name))
    entries = "\n\n".join(map(_entry, functions_first))
    return f"## {package.capitalize()}\n\n{text}\n\n```{{eval-rst}}\n{entries}\n```"


def as_parameters(app: object, what: str, name: str, found: object, options: object, lines: list[str]) -> None:
    """Show the attributes of options, which are in the lines of the docstring, as the parameters that they are."""
    if inspect.isclass(found) and issubclass(found, msgspec.Struct):
        text = "\n".join(lines).replace("Attributes:\n", "Args:\n")
        lines[:] = re.sub(r"^( {4}\w+) \((.*?)\): ", r"\1: in \2; ", text, flags=re.MULTILINE).split("\n")


def short_signature(
    app: object, what: str, name: str, found: object, options: object, signature: str | None, returned: str | None
) -> tuple[str | None, str | None]:
    """Return the signature of a class by its fields and their defaults; types of options are in that of studies."""
    if inspect.isclass(found) and issubclass(found, msgspec.Struct):
        own = [(f.name, f.default, f.default_factory) for f in msgspec.structs.fields(found)]
    elif inspect.isclass(found) and dataclasses.is_dataclass(found):
        own = [(f.name, f.default, f.default_factory) for f in dataclasses.fields(found) if f.init]
    else:  # within a union Sphinx shows an alias as it holds it
        return tuple(text and re.sub(r"TypeAliasForwardRef\('(\w+)'\)", r"\1", text) for text in (signature, returned))
    none = (msgspec.NODEFAULT, dataclasses.MISSING)
    shown = [(name, default if make in none else make()) for name, default, make in own]
    return f"({', '.join(name if value in none else f'{name}={value!r}' for name, value in shown)})", None


def _entry(name: str) -> str:
    found = getattr(odescope, name)
    if inspect.isfunction(found):
        return f".. autofunction:: odescope.{name}"
    return f".. autoclass:: odescope.{name}\n   :members:"
