import ast
import inspect
import re
import subprocess
import sys
import tomllib
from importlib.metadata import version
from pathlib import Path

import pytest

import odescope

ROOT = Path(__file__).parent.parent


def python(code):
    """Run code in a fresh interpreter and return what it prints."""
    return subprocess.run(
        [sys.executable, "-W", "error", "-c", code], capture_output=True, text=True, check=True
    ).stdout.strip()


@pytest.mark.parametrize("name", odescope.__all__)
def test_every_public_name_resolves(name):
    found = getattr(odescope, name)
    if name != "__version__":
        assert not inspect.ismodule(found)
        assert found.__name__ == name
        assert found.__doc__


def test_the_list_of_names_is_complete_and_without_repeats():
    assert len(set(odescope.__all__)) == len(odescope.__all__)
    assert dir(odescope) == sorted(odescope.__all__)
    assert {"identify", "Study", "read_study", "simulate", "read_model", "to_python", "InputError"} <= set(
        dir(odescope)
    )


def test_from_odescope_import_everything():
    names = python("from odescope import *; print(sorted(k for k in globals() if not k.startswith('_')))")
    assert names == str(sorted(n for n in odescope.__all__ if not n.startswith("_")))


def test_an_unknown_name_is_an_attribute_error():
    with pytest.raises(AttributeError, match="module 'odescope' has no attribute 'identity'"):
        odescope.identity  # noqa: B018
    assert not hasattr(odescope, "fit")


def test_importing_is_light():
    heavy = "{'numpy', 'numba', 'typer', 'scipy', 'sympy', 'pyarrow', 'matplotlib', 'jinja2', 'msgspec'}"
    assert python(f"import sys, odescope; print({heavy} & set(sys.modules) or 'none')") == "none"


def test_errors_are_light_too():
    code = "import sys; from odescope import InputError, NoModelError; print('numpy' in sys.modules)"
    assert python(code) == "False"


def test_arrays_are_read_without_pandas():
    """Arrow's own conversion imports it where it is installed, half a second or more for nothing."""
    code = (
        "import sys; import numpy as np; from odescope import Layout, records_from; t = np.arange(9)[::2];"
        " (run,) = records_from({'t': t, 'x': np.sqrt(t).astype('>f4')}, Layout(time='t', columns=(('x', 'x'),)));"
        " print('pandas' in sys.modules, run.t.tolist(), (run.column('x') ** 2).round(5).tolist())"
    )
    assert python(code) == "False [0.0, 2.0, 4.0, 6.0, 8.0] [0.0, 2.0, 4.0, 6.0, 8.0]"


def test_identify_stays_a_function_after_its_module_is_imported():
    modules = "pipeline.identification", "study.options", "model.simulation", "commands.cli"
    code = "".join(f"import odescope.{module}; " for module in modules) + "import odescope as o; "
    assert python(code + "print(type(o.identify).__name__, type(o.simulate).__name__)") == "function function"
    assert python(
        "import odescope as o; o.identify; import odescope.pipeline.identification; print(callable(o.identify))"
    )


@pytest.mark.parametrize("name", [n for n in odescope.__all__ if n != "__version__"])
def test_no_submodule_hides_a_public_name(name):
    """A module odescope/NAME.py would take the place of the name as soon as it is imported."""
    from importlib.util import find_spec

    assert find_spec(f"odescope.{name}") is None


def test_the_version_is_that_of_the_distribution():
    assert odescope.__version__ == version("odescope")


def test_the_stub_says_what_the_table_says():
    """Otherwise: ./run python .ci/stub.py."""
    tree = ast.parse((ROOT / "odescope/__init__.pyi").read_text(encoding="utf-8"))
    imports = [statement for statement in tree.body if isinstance(statement, ast.ImportFrom)]
    drawn = {alias.asname: (i.module, alias.name) for i in imports for alias in i.names}
    assert drawn == {name: (f"odescope.{module}", name) for name, module in odescope._HOME.items()}


def test_mypy_checks_the_code_of_a_user(tmp_path):
    """Run beside the package, whose cache the gate's own run of mypy shares."""
    script = tmp_path / "script.py"
    script.write_text(
        "import odescope\n"
        "study = odescope.Study(data=odescope.Data(time='t'), coordinates={'x': odescope.Measured(order=2)})\n"
        "text: str = odescope.to_text(odescope.identify(study, {}).model)\n"
        "odescope.identify('study.toml')\n"
        "count: int = text\n"
        "odescope.identfy(study)\n"
    )
    command = [sys.executable, "-m", "mypy", "--config-file", str(ROOT / "pyproject.toml"), str(script)]
    told = subprocess.run(command, capture_output=True, text=True, cwd=ROOT).stdout
    wrong = {int(line): code for line, code in re.findall(r"script\.py:(\d+): error: .*\[(.*)\]", told)}
    assert wrong == {4: "arg-type", 5: "assignment", 6: "attr-defined"}, told


def test_runtime_dependencies_are_imported_somewhere():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    wanted = {re.match(r"[a-z0-9-]+", d)[0].replace("-", "_") for d in project["dependencies"]}
    code = "\n".join(path.read_text(encoding="utf-8") for path in ROOT.glob("odescope/**/*.py"))
    assert {name for name in wanted if not re.search(rf"^\s*(import|from) {name}\b", code, re.MULTILINE)} == set()


def test_the_citation_names_this_version_and_licence():
    citation = (ROOT / "CITATION.cff").read_text(encoding="utf-8")
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    assert f"\nversion: {odescope.__version__}\n" in citation
    assert f"\nlicense: {project['license']}\n" in citation


def test_hooks_run_what_the_gate_runs():
    """The same commands, in the versions of the lock."""
    gate = re.findall(r"^\./run (.+)$", (ROOT / ".ci/run").read_text(encoding="utf-8"), re.MULTILINE)
    hooks = re.findall(r"entry: bash run (.+)$", (ROOT / ".pre-commit-config.yaml").read_text("utf-8"), re.MULTILINE)
    assert sorted(hooks) == sorted(gate)
    assert len(gate) == 5
