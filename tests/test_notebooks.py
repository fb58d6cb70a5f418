"""The notebooks run, as someone who opens them would run them, and find what their logs were made from."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

FOLDER = Path(__file__).parent.parent / "docs/notebooks"

# A last cell: every mechanism of the truth and no other, within four standard errors, which is 1 in 16 000 for each.
MECHANISM = """
assert found.keys() == expected.keys()
for name, m in found.items():
    assert abs(m.coefficient - expected[name]) <= 4.0 * (m.std_error or 0.0), name
"""
REACTOR = """
assert {m.name for m in result.model.mechanisms} == true.keys()
for m in result.model.mechanisms:
    assert abs(m.coefficient - true[m.name]) <= 4.0 * m.std_error, m.name
"""


@pytest.mark.slow
@pytest.mark.parametrize(("name", "check"), [("mechanism", MECHANISM), ("reactor", REACTOR)])
@pytest.mark.filterwarnings("default")  # of the kernel's packages, which are not odescope's to mend
def test_the_notebook_runs_and_finds_the_truth(name: str, check: str, tmp_path: Path) -> None:
    nbclient = pytest.importorskip("nbclient", reason="no nbclient, which the dependency group docs has")
    pytest.importorskip("ipykernel", reason="no ipykernel, which the dependency group docs has")
    nbformat = pytest.importorskip("nbformat", reason="no nbformat, which the dependency group docs has")
    notebook = nbformat.read(FOLDER / f"{name}.ipynb", as_version=4)
    notebook.cells.append(nbformat.v4.new_code_cell(check))
    nbclient.NotebookClient(notebook, timeout=300, resources={"metadata": {"path": str(tmp_path)}}).execute()
    shown = [output for cell in notebook.cells for output in cell.get("outputs", [])]
    kinds = {kind for output in shown for kind in output.get("data", ())}
    assert {"text/html", "image/png"} <= kinds  # the equations, a figure


@pytest.mark.parametrize("path", sorted(FOLDER.glob("*.ipynb")), ids=lambda path: path.stem)
def test_notebooks_are_kept_without_outputs(path: Path) -> None:
    cells = json.loads(path.read_text(encoding="utf-8"))["cells"]
    code = [cell for cell in cells if cell["cell_type"] == "code"]
    assert [cell["outputs"] for cell in code] == [[]] * len(code)
    assert {cell["execution_count"] for cell in code} == {None}
