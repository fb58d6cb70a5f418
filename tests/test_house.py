"""The house rules that can be read off the source: sizes, signatures, docstrings, names, references.

Each rule is a function from a checkout's folder to one line an offender, "file:line: what is wrong".
"""

from __future__ import annotations

import ast
import re
from collections import defaultdict
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
FILE_LINES = 400
FUNCTION_LINES = 60
PARAMETERS = 3  # from here on a public function says what its parameters are
OUTSIDE = re.compile(r"\b(METHOD|DESIGN|ANCHORS)\b")  # documents that a reader of the repository does not have
TEXTS = {".py", ".pyi", ".md", ".toml", ".jinja", ".css", ".cff", ".yml", ".yaml"}

Function = ast.FunctionDef | ast.AsyncFunctionDef


@cache
def modules(root: Path) -> dict[str, ast.Module]:
    """The package's modules by path from the root, parsed."""
    paths = sorted((root / "odescope").rglob("*.py"))
    return {p.relative_to(root).as_posix(): ast.parse(p.read_text(encoding="utf-8")) for p in paths}


def public(name: str) -> bool:
    return not name.startswith("_")


def public_module(path: str) -> bool:
    return all(public(part) or part in ("__init__.py", "__main__.py") for part in path.split("/"))


def words(node: ast.AST | None) -> set[str]:
    """Every name in an expression, inside quoted annotations too."""
    found: set[str] = set()
    for n in ast.walk(node) if node else ():
        if isinstance(n, ast.Name):
            found.add(n.id)
        elif isinstance(n, ast.Attribute):
            found.add(n.attr)
        elif isinstance(n, ast.Constant) and isinstance(n.value, str):
            found |= set(re.findall(r"\w+", n.value))
    return found


def functions(tree: ast.Module) -> Iterator[tuple[str, Function, ast.ClassDef | None]]:
    """Functions of a module and methods of its classes: the qualified name, the definition, the class."""
    for node in tree.body:
        if isinstance(node, Function):
            yield node.name, node, None
        elif isinstance(node, ast.ClassDef):
            for inner in node.body:
                if isinstance(inner, Function):
                    yield f"{node.name}.{inner.name}", inner, node


def public_functions(root: Path) -> Iterator[tuple[str, str, Function, ast.ClassDef | None]]:
    for path, tree in modules(root).items():
        if public_module(path):
            for name, function, owner in functions(tree):
                if public(function.name) and (owner is None or public(owner.name)):
                    yield path, name, function, owner


def parameters(function: Function, owner: ast.ClassDef | None) -> list[ast.arg]:
    """The parameters of a function; self and cls are none."""
    a = function.args
    listed = [*a.posonlyargs, *a.args]
    if owner and "staticmethod" not in {w for d in function.decorator_list for w in words(d)}:
        listed = listed[1:]
    return [*listed, *([a.vararg] if a.vararg else []), *a.kwonlyargs, *([a.kwarg] if a.kwarg else [])]


def compilers(root: Path) -> set[str]:
    """numba's njit, and the names of the package that stand for it: an assignment or a function that applies it."""
    names = {"njit", "jit"}
    for tree in modules(root).values():
        for node in tree.body:
            if isinstance(node, ast.Assign | ast.AnnAssign) and words(node.value) & {"njit", "jit"}:
                targets = node.targets if isinstance(node, ast.Assign) else [node.target]
                names |= {t.id for t in targets if isinstance(t, ast.Name)}
            elif isinstance(node, Function) and any({"njit", "jit"} & words(b) for b in node.body):
                names.add(node.name)
    return names


def long_files(root: Path) -> list[str]:
    sizes = {path: (root / path).read_text(encoding="utf-8").count("\n") for path in modules(root)}
    return [f"{path}:{n}: {n} lines, over {FILE_LINES}" for path, n in sizes.items() if n > FILE_LINES]


def long_functions(root: Path) -> list[str]:
    """Compiled kernels may be longer if the docstring says why, with the word "because"."""
    compiled, found = compilers(root), []
    for path, tree in modules(root).items():
        for node in ast.walk(tree):
            if not isinstance(node, Function):
                continue
            lines = (node.end_lineno or node.lineno) - node.lineno + 1
            kernel = any(words(d) & compiled for d in node.decorator_list)
            if lines > FUNCTION_LINES and not (kernel and "because" in (ast.get_docstring(node) or "")):
                want = 'a kernel, whose docstring must say why ("because ...")' if kernel else f"over {FUNCTION_LINES}"
                found.append(f"{path}:{node.lineno}: {node.name} has {lines} lines, {want}")
    return found


def any_in_signatures(root: Path) -> list[str]:
    """Parameters, results and the annotated fields (which are parameters too) of what is public."""
    vague = {"Any"}
    for tree in modules(root).values():  # an alias of something with Any is Any
        for node in tree.body:
            if isinstance(node, ast.Assign | ast.AnnAssign) and "Any" in words(node.value):
                targets = node.targets if isinstance(node, ast.Assign) else [node.target]
                vague |= {t.id for t in targets if isinstance(t, ast.Name) and public(t.id) and t.id[0].isupper()}
    found = []
    for path, name, function, owner in public_functions(root):
        for p in parameters(function, owner):
            if words(p.annotation) & vague:
                found.append(f"{path}:{p.lineno}: {name}({p.arg}: {ast.unparse(p.annotation)})")  # type: ignore[arg-type]
        if words(function.returns) & vague:
            found.append(f"{path}:{function.lineno}: {name} -> {ast.unparse(function.returns)}")  # type: ignore[arg-type]
    for path, tree in modules(root).items():
        for node in tree.body if public_module(path) else ():
            for field in node.body if isinstance(node, ast.ClassDef) and public(node.name) else ():
                if isinstance(field, ast.AnnAssign) and words(field.annotation) & vague and public(field.target.id):  # type: ignore[union-attr]
                    found.append(f"{path}:{field.lineno}: {node.name}.{ast.unparse(field)}")  # type: ignore[union-attr]
    return found


def without_args(root: Path) -> list[str]:
    """Methods that a protocol of the package declares are explained there; options of commands explain themselves."""
    declared = {
        function.name
        for tree in modules(root).values()
        for _, function, owner in functions(tree)
        if owner
        and any("Protocol" in words(base) for base in owner.bases)
        and "Args:" in (ast.get_docstring(function) or "")
    }
    found = []
    for path, name, function, owner in public_functions(root):
        decorators = {w for d in function.decorator_list for w in words(d)}
        if (owner and function.name in declared) or decorators & {"overload", "command", "callback", "setter"}:
            continue
        count = len(parameters(function, owner))
        if count >= PARAMETERS and not re.search(r"^\s*Args:$", ast.get_docstring(function) or "", re.MULTILINE):
            found.append(f'{path}:{function.lineno}: {name} has {count} parameters and no "Args:" in its docstring')
    return found


def outside_references(root: Path) -> list[str]:
    places = [p for folder in ("odescope", "tests", "bench", "docs") for p in (root / folder).rglob("*")]
    found = []
    for path in sorted([*places, *root.glob("*.md"), root / "pyproject.toml"]):
        if path.suffix in TEXTS and path.is_file() and path.name != "test_house.py":
            for k, line in enumerate(path.read_text(encoding="utf-8").splitlines(), 1):
                if OUTSIDE.search(line):
                    found.append(f"{path.relative_to(root).as_posix()}:{k}: {line.strip()}")
    return found


def homonyms(root: Path) -> list[str]:
    places = defaultdict(list)
    for path, tree in modules(root).items():
        for node in tree.body:
            if isinstance(node, ast.ClassDef) and public(node.name):
                places[node.name].append(f"{path}:{node.lineno}")
    return [
        f"{where}: {name} is also {', '.join(p for p in all_ if p != where)}"
        for name, all_ in places.items()
        if len(all_) > 1
        for where in all_[:1]
    ]


RULES = (long_files, long_functions, any_in_signatures, without_args, outside_references, homonyms)


@pytest.mark.parametrize("rule", RULES, ids=lambda rule: rule.__name__)
def test_the_house_rule_holds(rule):
    offenders = rule(ROOT)
    assert not offenders, "\n" + "\n".join(offenders)
