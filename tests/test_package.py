import inspect
import subprocess
import sys
from importlib.metadata import version

import pytest

import odescope


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
