"""Kernels are compiled once, anew when anything that went into them changes, and kept where an uninstall finds them."""

import importlib
import os
import pickle
import subprocess
import sys
from pathlib import Path

import pytest

from odescope.parallel import kernels

SCALE = "SCALE = 2.0\n"
INNER = """
from odescope.parallel.kernels import kernel

@kernel()
def inner(x):
    return 10.0 * x
"""
OUTER = """
from inner import inner
from scale import SCALE
from odescope.parallel.kernels import compiled, kernel

@kernel("contract")
def outer(x):
    return SCALE * inner(x) + 1.0
"""


@pytest.fixture
def program(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Three modules in a folder of their own, whose machine code is kept in cache/ there."""
    for name, text in {"scale": SCALE, "inner": INNER, "outer": OUTER}.items():
        (tmp_path / f"{name}.py").write_text(text)
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setattr(sys, "dont_write_bytecode", True)  # it does not tell changes of the same second and size
    monkeypatch.setattr(kernels, "_root", lambda: tmp_path / "cache")
    return tmp_path


def run(program: Path) -> tuple[bool, float, int]:
    """Import the program anew: was its kernel compiled, its value at 1, and how often was machine code loaded."""
    kernels._source.cache_clear()
    for name in ("scale", "inner", "outer"):
        sys.modules.pop(name, None)
    kernel = importlib.import_module("outer").outer
    known = kernels.compiled(kernel)
    return known, kernel(1.0), sum(kernel.stats.cache_hits.values())


def test_a_kernel_is_compiled_once(program: Path) -> None:
    """By one process for the next."""
    code = (
        "from odescope.parallel.kernels import compiled; from outer import outer;"
        "print(compiled(outer), outer(1.0), sum(outer.stats.cache_hits.values()))"
    )
    environment = os.environ | {"NUMBA_CACHE_DIR": str(program / "cache"), "PYTHONPATH": os.pathsep.join(sys.path)}
    for told in ("False 21.0 0", "True 21.0 1"):
        command = [sys.executable, "-B", "-W", "error", "-c", code]
        found = subprocess.run(command, cwd=program, env=environment, capture_output=True, text=True, check=True)
        assert found.stdout.strip() == told


@pytest.mark.parametrize(
    ("file", "before", "after", "value"),
    [("inner", "10.0", "30.0", 61.0), ("scale", "2.0", "5.0", 51.0), ("outer", "+ 1.0", "+ 3.0", 23.0)],
)
def test_a_change_in_any_file_compiles_anew(program: Path, file: str, before: str, after: str, value: float) -> None:
    """Numba itself looks at the kernel's own file alone, and runs what the others said before."""
    assert run(program) == (False, 21.0, 0)
    path = program / f"{file}.py"
    path.write_text(path.read_text().replace(before, after))
    assert run(program) == (False, value, 0)
    assert run(program) == (True, value, 1)
    assert len(list((program / "cache").rglob("outer.*.nb?"))) == 2  # what is stale is overwritten


def test_a_class_that_a_kept_kernel_took_may_be_gone(program: Path) -> None:
    """The index holds the types of the arguments: those of an older source may have other names by now."""
    run(program)
    (index,) = (program / "cache").rglob("outer*.nbi")
    with index.open("rb") as file:
        version = pickle.load(file)  # noqa: S301 (our own)
    index.write_bytes(pickle.dumps(version) + b"cnowhere\nGone\n.")
    (program / "outer.py").write_text(OUTER.replace("+ 1.0", "+ 3.0"))
    assert run(program) == (False, 23.0, 0)


def test_lines_that_move_leave_no_files_behind(program: Path) -> None:
    run(program)
    (program / "outer.py").write_text("\n\n" + OUTER)
    assert run(program) == (False, 21.0, 0)
    assert len(list((program / "cache").rglob("outer.*.nb?"))) == 2


def test_a_kernel_runs_where_nothing_can_be_kept(program: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(kernels, "_root", lambda: None)
    for _ in range(2):
        assert run(program) == (False, 21.0, 0)


def test_without_compilation_a_kernel_is_the_function_itself(program: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(kernels.config, "DISABLE_JIT", 1)
    kernel = kernels.kernel()(run)
    assert kernel is run
    assert kernels.compiled(kernel)


@pytest.fixture
def installed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The layout that a wheel leaves: the package, and beside it a file that will make room for the kernels."""
    package = tmp_path / "site-packages" / "odescope"
    (package / "parallel").mkdir(parents=True)
    (package.parent / "odescope.kernels").write_text("room for kernels")
    monkeypatch.setattr(kernels, "PACKAGE", package)
    monkeypatch.setattr(kernels, "__file__", str(package / "parallel" / "kernels.py"))
    monkeypatch.setattr(kernels.config, "CACHE_DIR", "")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "home"))
    monkeypatch.setenv("LOCALAPPDATA", str(tmp_path / "home"))
    monkeypatch.setattr(Path, "home", lambda: tmp_path / "home")
    return package.parent


def root() -> Path | None:
    return kernels._root.__wrapped__()


def test_the_folder_takes_the_place_of_the_file_of_the_wheel(installed: Path) -> None:
    for _ in range(2):
        assert root() == installed / "odescope.kernels"
        assert (installed / "odescope.kernels").is_dir()
    (installed / "odescope.kernels").rmdir()
    assert root() == installed / "odescope.kernels"  # never the package itself, where it would be left behind


def test_a_source_tree_keeps_its_kernels_among_its_bytecode(installed: Path) -> None:
    (installed / "odescope" / "parallel" / "kernels.txt").write_text("room for kernels")
    assert root() == installed / "odescope" / "__pycache__" / "kernels"
    assert (installed / "odescope.kernels").is_file()


def test_what_numba_is_told_goes_first(installed: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(kernels.config, "CACHE_DIR", str(tmp_path / "mine"))
    found = root()
    assert found is not None
    assert found.parent == tmp_path / "mine"


def test_a_package_that_cannot_be_written_keeps_its_kernels_with_the_user(
    installed: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(Path, "unlink", lambda _: (_ for _ in ()).throw(PermissionError()))
    found = root()
    assert found == kernels.user_folder()
    assert found.is_relative_to(tmp_path / "home")
    if os.name == "posix":
        assert found.stat().st_mode & 0o777 == 0o700
        found.chmod(0o770)  # whoever may write there could have their code run
        assert root() is None


def test_the_folder_of_a_user_tells_versions_and_places_apart(installed: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folders = {kernels.user_folder()}
    monkeypatch.setattr(kernels.odescope, "__version__", "9.9")
    folders.add(kernels.user_folder())
    monkeypatch.setattr(kernels, "PACKAGE", installed / "elsewhere" / "odescope")
    folders.add(kernels.user_folder())
    assert len(folders) == 3
