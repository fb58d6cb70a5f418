"""The reference of the Python package, as Markdown: every public name, from its docstring, under its package."""

from __future__ import annotations

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
    entries = "\n\n".join(_entry(name) for name in names)
    return f"## {package.capitalize()}\n\n{text}\n\n```{{eval-rst}}\n{entries}\n```"


def as_parameters(app: object, what: str, name: str, found: object, options: object, lines: list[str]) -> None:
    """Show the attributes of options, which are in the lines of the docstring, as the parameters that they are."""
    if inspect.isclass(found) and issubclass(found, msgspec.Struct):
        text = "\n".join(lines).replace("Attributes:\n", "Args:\n")
        lines[:] = re.sub(r"^( {4}\w+) \((.*?)\): ", r"\1: in \2; ", text, flags=re.MULTILINE).split("\n")


def short_signature(
    app: object, what: str, name: str, found: object, options: object, signature: str | None, returned: str | None
) -> tuple[str | None, str | None]:
    """Return the signature of options by names and defaults; types stand in the reference of studies."""
    if not (inspect.isclass(found) and issubclass(found, msgspec.Struct)):
        return signature, returned
    fields = msgspec.structs.fields(found)
    return f"({', '.join(f.name if f.required else f'{f.name}={_shown(f)}' for f in fields)})", None


def _shown(field: msgspec.structs.FieldInfo) -> str:
    value = field.default if field.default_factory is msgspec.NODEFAULT else field.default_factory()
    return repr(value)


def _entry(name: str) -> str:
    found = getattr(odescope, name)
    if inspect.isfunction(found):
        return f".. autofunction:: odescope.{name}"
    return f".. autoclass:: odescope.{name}\n   :members:"
