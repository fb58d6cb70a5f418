"""What pip installs is complete, works, and goes without a trace."""

import os
import re
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
SOURCES = [path.read_text(encoding="utf-8") for path in ROOT.glob("odescope/**/*.py") if path.name != "kernels.py"]


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("wheel")
    command = [sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-d", str(folder)]
    subprocess.run(command, cwd=ROOT, check=True, capture_output=True)
    (found,) = folder.iterdir()
    return found


def test_the_wheel_has_licence_types_and_template(wheel: Path) -> None:
    with zipfile.ZipFile(wheel) as packed:
        names = packed.namelist()
        (metadata,) = [packed.read(name).decode() for name in names if name.endswith("/METADATA")]
    tree = {path.relative_to(ROOT).as_posix() for path in ROOT.glob("odescope/**/*.py")}
    told = [
        "odescope/py.typed",
        "odescope/__init__.pyi",
        "odescope/report/page.html.jinja",
        "odescope/export/c_code/model.c.jinja",
        "odescope.kernels",
    ]
    assert tree | set(told) <= set(names)
    assert any(name.endswith(".dist-info/licenses/LICENSE") for name in names)
    assert {name for name in names if not re.match(r"odescope(/|\.kernels$|-[\d.]+\.dist-info/)", name)} == set()
    assert "License-Expression: BSD-3-Clause" in metadata
    assert "Author: odescope developers" in metadata


def test_every_kernel_is_compiled_by_the_decorator_of_the_package() -> None:
    assert [text for text in SOURCES if re.search(r"\bnumba\.(n?jit|vectorize)|from numba", text)] == []


@pytest.mark.slow
def test_an_uninstall_leaves_nothing_behind(wheel: Path, tmp_path: Path) -> None:
    """Installed without its dependencies, which are those of this environment, behind the new one's own packages."""
    new = tmp_path / "new"
    environment = {key: value for key, value in os.environ.items() if not key.startswith(("PYTHON", "NUMBA"))}
    home = {key: str(tmp_path / "home") for key in ("HOME", "USERPROFILE", "XDG_CACHE_HOME", "LOCALAPPDATA")}

    program = str(new / ("Scripts/python.exe" if os.name == "nt" else "bin/python"))

    def say(*command: str) -> str:
        return subprocess.run(
            command, cwd=tmp_path, env=environment | home, capture_output=True, text=True, check=True
        ).stdout

    def traces() -> set[str]:
        return {path.relative_to(tmp_path).as_posix() for path in tmp_path.rglob("*")}

    say(sys.executable, "-m", "venv", "--without-pip", str(new))
    site = Path(say(program, "-c", "import sysconfig; print(sysconfig.get_path('purelib'))").strip())
    pip = (sys.executable, "-m", "pip", "--python", program)
    (site / "dependencies.pth").write_text("\n".join(path for path in sys.path if path.endswith("site-packages")))
    before = traces()
    say(*pip, "install", "--quiet", "--no-deps", "--no-index", str(wheel))
    assert say(program, "-m", "odescope", "--version").startswith("odescope ")
    used = say(
        program,
        "-c",
        "import numpy as np, odescope; from odescope.regression.solve import least_squares as solve;"
        "solve(np.eye(3), np.array([0]), 1);"
        "print(odescope.__file__, solve.stats.cache_path, sep='\\n')",
    ).splitlines()
    assert [Path(path).relative_to(site).parts[0] for path in used] == ["odescope", "odescope.kernels"]
    assert list((site / "odescope.kernels").rglob("*.nbi"))
    say(*pip, "uninstall", "--quiet", "-y", "odescope")
    left = traces() - before
    assert {path for path in left if path.startswith("new/") or "odescope" in path or "numba" in path} == set()
