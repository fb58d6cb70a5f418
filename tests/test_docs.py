"""The documentation runs: its Python blocks, its studies, its file names."""

from __future__ import annotations

import io
import json
import re
import shlex
import tomllib
from contextlib import redirect_stderr, redirect_stdout
from pathlib import Path

import msgspec
import numpy as np
import pytest

from odescope.commands.cli import main
from odescope.commands.files import CANDIDATE_COLUMNS, PATH_COLUMNS
from odescope.events import Note
from odescope.export.model_file import _File, from_json, to_json
from odescope.library.mechanism import candidates_of
from odescope.library.ties import tied
from odescope.report.assemble import read_report
from odescope.report.result_names import FACTORS, NO_MODEL, PATH, RESULT_FILES
from odescope.study.clock import with_time
from odescope.study.options import Data
from odescope.study.pieces import PLACES
from odescope.study.toml import parse_study

ROOT = Path(__file__).parent.parent


def blocks(path: str, language: str) -> list[str]:
    return re.findall(
        rf"^```{language}\n(.*?)^```", (ROOT / path).read_text(encoding="utf-8"), re.MULTILINE | re.DOTALL
    )


@pytest.mark.slow
def test_extending_runs_and_recovers_the_system(capsys: pytest.CaptureFixture[str]) -> None:
    session: dict[str, object] = {}
    for block in blocks("docs/extending.md", "python"):
        exec(compile(block, "docs/extending.md", "exec"), session)  # noqa: S102 (our own documentation)
    truth = {"x": 4.0, "x_dot": 0.2, "tanh(20.0*x_dot)": 0.5, "f": -1.0, "x_ddot": 1.0}
    result = session["result"]
    for model in (session["model"], result.model):  # type: ignore[attr-defined]
        found = {t.text: t.coefficient for t in model.relations[0].terms}  # type: ignore[attr-defined]
        assert found.keys() == truth.keys()
        for term, value in truth.items():
            assert found[term] == pytest.approx(value, rel=0.05)
    run, position = session["run"], np.asarray(session["position"])
    assert np.std(run.states[:2000, 0] - position[:2000]) < 0.02 * np.std(position)  # type: ignore[attr-defined]
    smoothed, signals = session["smoothed"], session["signals"]
    assert smoothed.channels[0].cutoff > 0  # type: ignore[attr-defined]
    assert signals.names == smoothed.names  # type: ignore[attr-defined]
    results, told = session["results"], session["told"]
    found = {t.text for t in results.result.model.relations[0].terms}  # type: ignore[attr-defined]
    assert {"x", "tanh(20.0*x_dot)", "f", "x_ddot"} <= found <= truth.keys()
    written = (results.folder / "study.toml").read_text(encoding="utf-8")  # type: ignore[attr-defined]
    lines = written.splitlines()
    assert [line.split()[1] for line in lines[:2]] == ["signals.differentiator", "regression.proposers[0]"]
    assert read_report(results.folder / "report.json").reproduce.study.splitlines()[:2] == lines[:2]  # type: ignore[attr-defined]
    notes = [event.text for event in told if isinstance(event, Note)]  # type: ignore[attr-defined]
    assert sum("cannot name" in note for note in notes) == 2


NUMBER = re.compile(r"(?<![\w.])[+-]?\d+(?:\.\d*)?(?:[eE][+-]?\d+)?")


def run_page(path: str, capsys: pytest.CaptureFixture[str]) -> dict[str, object]:
    """Run the blocks of a page that shows what they print: words are the same, numbers to the error of the fits."""
    page = (ROOT / path).read_text(encoding="utf-8")
    pairs = re.findall(r"^```python\n(.*?)^```(?:\n+```text\n(.*?)^```)?", page, re.MULTILINE | re.DOTALL)
    assert len(pairs) == len(blocks(path, "python"))
    assert sum(bool(shown) for _, shown in pairs) == len(blocks(path, "text"))
    session: dict[str, object] = {}
    for block, shown in pairs:
        exec(compile(block, path, "exec"), session)  # noqa: S102 (our own documentation)
        printed = capsys.readouterr().out
        assert NUMBER.sub("#", printed).split() == NUMBER.sub("#", shown).split()
        numbers = [[float(n) for n in NUMBER.findall(text)] for text in (printed, shown)]
        assert numbers[0] == pytest.approx(numbers[1], rel=0.05)
    return session


def shows(printed: str, shown: str) -> None:
    """Every line that is shown is among those that were printed, in their order: words the same, numbers to 5 %."""
    lines = iter(printed.splitlines())
    for line in shown.splitlines():
        numbers = [float(n) for n in NUMBER.findall(line)]
        assert any(
            NUMBER.sub("#", line).split() == NUMBER.sub("#", found).split()
            and [float(n) for n in NUMBER.findall(found)] == pytest.approx(numbers, rel=0.05)
            for found in lines
        ), f"{line!r} is not among what was printed:\n{printed}"


def test_the_tutorial_runs_and_prints_what_it_shows(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Its blocks, in their order, in one folder: Python, commands, the study; the truth is that of the simulation."""
    monkeypatch.chdir(tmp_path)
    page = (ROOT / "docs/tutorial.md").read_text(encoding="utf-8")
    session, checked = dict[str, object](), 0
    for language, block, shown in re.findall(
        r"^```(python|sh|toml)\n(.*?)^```(?:\n+```text\n(.*?)^```)?", page, re.MULTILINE | re.DOTALL
    ):
        said = io.StringIO()
        with redirect_stdout(said), redirect_stderr(said):
            if language == "toml":
                Path("study.toml").write_text(block, encoding="utf-8")
            elif language == "python":
                exec(compile(block, "docs/tutorial.md", "exec"), session)  # noqa: S102 (our own documentation)
            else:
                for command in block.splitlines():
                    monkeypatch.setattr("sys.argv", shlex.split(command))
                    with pytest.raises(SystemExit) as end:
                        main()
                    assert not end.value.code, said.getvalue()
        shows(said.getvalue(), shown)
        checked += bool(shown)
    assert checked == len(blocks("docs/tutorial.md", "text"))
    truth = {"sin(phi)": 12.0, "phi_dot": 0.3, "sign(phi_dot)": 0.4, "torque": -8.0, "phi_ddot": 1.0}
    terms = session["model"].relations[0].terms  # type: ignore[attr-defined]
    assert {t.text: t.coefficient for t in terms} == pytest.approx(truth, rel=0.01)
    for t in terms:
        assert t.std_error is None or abs(t.coefficient - truth[t.text]) < 3.0 * t.std_error
    written = {"coefficients.csv", "judged/validation.csv", "plant/plant.h", "predicted.csv", "states.csv"}
    assert all(Path(name).is_file() for name in written)


def test_files_of_results_are_described() -> None:
    """The example is a model; tables have the keys and columns that are written; so does the list of files."""
    page = (ROOT / "docs/files.md").read_text(encoding="utf-8")
    first, *tables = [
        re.findall(r"`(\w[^`]*)`", " ".join(row.split("|")[1] for row in table.splitlines()[2:]))
        for table in re.findall(r"(?:^\|.*\n)+", page, re.MULTILINE)
    ]
    (example,) = blocks("docs/files.md", "json")
    assert from_json(example).relations[0].terms[0].text == "phi_ddot"
    keys, columns = tables
    written = set(json.loads(to_json(from_json(example))))
    assert written < set(keys) == {field.encode_name for field in msgspec.structs.fields(_File)}
    assert tuple(columns) == CANDIDATE_COLUMNS
    assert set(PATH_COLUMNS) <= set(re.findall(r"`(\w+)`", page.rpartition("## path.csv")[2]))
    assert {*RESULT_FILES, NO_MODEL, f"{PATH}.csv", f"{PATH}/", f"{FACTORS}/"} == set(first)


def test_observer_runs_and_prints_what_it_shows(capsys: pytest.CaptureFixture[str]) -> None:
    """The velocity that nobody measured is within its stated standard deviations of the truth."""
    session = run_page("docs/observer.md", capsys)
    run, truth = session["run"], np.asarray(session["truth"])
    off = (run.states - truth) / run.std  # type: ignore[attr-defined]
    assert 0.3 < np.sqrt(np.mean(off**2)) < 1.2


def test_forms_runs_and_prints_what_it_shows(capsys: pytest.CaptureFixture[str]) -> None:
    """True values are those of the simulations."""
    session = run_page("docs/forms.md", capsys)
    mechanics = {("kinetic", "x_dot**2"): 0.9, ("kinetic", "phi_dot*x_dot*cos(phi)"): 0.18}
    mechanics |= {("kinetic", "phi_dot**2"): 0.02754, ("potential", "cos(phi)"): -1.7658}
    mechanics |= {("dissipation", "x_dot**2"): 5.0, ("dissipation", "phi_dot**2"): 0.005, ("force", "u on x"): 1.0}
    found = {(m.kind, m.name): m.coefficient for m in session["result"].model.mechanisms}  # type: ignore[attr-defined]
    assert found == pytest.approx(mechanics, rel=2e-3)
    rates = {m.name: m.coefficient for m in session["found"].model.mechanisms}  # type: ignore[attr-defined]
    assert rates == pytest.approx({"S + E -> C": 1.0, "C -> S + E": 0.5, "C -> E + P": 0.3}, rel=0.02)


def test_libraries_of_forms_are_libraries() -> None:
    """Each with the coordinates that its terms are about; nothing in it is refused, nothing is left out of it."""
    cart = "[coordinates.x]\norder = 2\ncyclic = true\n[coordinates.phi]\norder = 2\nangle = true\n[inputs.u]\n"
    masses = "[coordinates.x]\norder = 2\n[coordinates.y]\norder = 2\n"
    species = "".join(f"[coordinates.{name}]\n" for name in "SECP")
    default, named, equal, composed, constants, heated, timed = blocks("docs/forms.md", "toml")
    assert parse_study(cart + default).forms() == ("lagrangian",)
    mechanisms, left_out = parse_study(cart + named).mechanisms("lagrangian")
    assert len(mechanisms) == 10
    assert not left_out
    study = parse_study(masses + equal)
    targets = [c.target for c in study.measured()]
    plain = candidates_of([study.candidates(target).products(targets) for target in targets], targets)
    assert [m.term for m in tied(plain, study.library.ties, study.scope()) if m.kind == "tie"] == ["x"]
    assert parse_study(species + composed).forms() == ("reactions",)
    library = parse_study(species + constants).candidates("S_dot")
    assert "S*(K + S)**-1" in {t.text for t in library}
    mechanisms, left_out = parse_study("".join(f"[coordinates.{name}]\n" for name in "ABC") + heated).mechanisms(
        "reactions"
    )
    assert [m.name for m in mechanisms if m.kind == "reaction"] == ["A -> B", "B -> C"]
    assert not left_out
    named_time = with_time(parse_study("[coordinates.x]\norder = 2\n" + timed))
    assert "sin(t*w)" in {t.text for t in named_time.candidates("x_ddot")}


def test_the_entry_points_of_extending_are_those_that_are_looked_up() -> None:
    basis, package, study = (tomllib.loads(block) for block in blocks("docs/extending.md", "toml"))
    assert basis["library"]["functions"]
    offered = package["project"]["entry-points"]
    assert set(offered) < {place.group for place in PLACES}
    assert study["signals"]["differentiator"]["kind"] in offered["odescope.differentiators"]
    assert study["regression"]["proposers"][0]["kind"] in offered["odescope.proposers"]


def test_readme_python_runs(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    t = np.arange(0.0, 30.0, 0.01)
    omega, decay = 2.0, 0.05
    x = np.exp(-decay * t) * np.cos(np.sqrt(omega**2 - decay**2) * t)
    x += 1e-4 * np.random.default_rng(0).standard_normal(len(t))
    rows = "\n".join(f"{a!r},{b!r}" for a, b in zip(t.tolist(), x.tolist(), strict=True))
    (tmp_path / "run1.csv").write_text(f"t,x\n{rows}\n")
    monkeypatch.chdir(tmp_path)
    (block,) = blocks("README.md", "python")
    session: dict[str, object] = {}
    exec(compile(block, "README.md", "exec"), session)  # noqa: S102 (our own documentation)
    found = {t.text: t.coefficient for t in session["result"].model.relations[0].terms}  # type: ignore[attr-defined]
    assert found.keys() == {"x", "x_dot", "x_ddot"}
    assert found["x"] == pytest.approx(omega**2, rel=1e-3)
    assert found["x_dot"] == pytest.approx(2 * decay, rel=0.05)
    out = capsys.readouterr().out
    assert out.startswith("x_ddot = ")
    assert re.search(r"^model +free run +x +9\d", out, re.MULTILINE)
    table = session["table"]
    assert list(table.columns)[:4] == ["equation", "term", "coefficient", "std_error"]  # type: ignore[attr-defined]
    assert session["run"].states[1, 0] == pytest.approx(np.cos(1.0), rel=0.1)  # type: ignore[attr-defined]


def test_readme_study_is_a_study() -> None:
    study, forms, streamed = blocks("README.md", "toml")
    assert parse_study(study).coordinates["phi"].column == "angle"
    mechanisms, _ = parse_study(f"{study}\n{forms}").mechanisms("lagrangian")
    assert [m.known for m in mechanisms if m.kind == "kinetic"].count(0.9) == 1
    assert sum(m.kind == "potential" for m in mechanisms) == 2
    assert parse_study(f"{streamed}\n[coordinates.x]").data.memory == Data().memory


def test_links_lead_somewhere() -> None:
    for page in (ROOT / "README.md", *ROOT.glob("docs/*.md")):
        for target in re.findall(r"\]\(([^)#:]+)\)", page.read_text(encoding="utf-8")):
            assert (page.parent / target).exists(), f"{page.name} links to {target}"
        for command in re.findall(r"python ((?:bench|docs)/\w+\.py)", page.read_text(encoding="utf-8")):
            assert (ROOT / command).exists()


PAGES = [p for p in (ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted(ROOT.glob("docs/*.md"))) if p.exists()]
NAMED = re.compile(
    r"(?<![\w/.])(?:(?:odescope|tests|bench|docs|\.ci|\.github)/[\w./-]*|\.?/?[\w.-]+\.(?:py|md|toml|cff|yaml))"
)
MADE_BY_COMMANDS = {"model.json", "study.toml", "model.py", "study.md"}  # what pages say that odescope writes


@pytest.mark.parametrize("page", PAGES, ids=lambda p: p.name)
def test_paths_that_a_page_names_exist(page: Path) -> None:
    """Code spans that look like a path of the repository; a module may be named from odescope/ on, as `signals/`."""
    missing = []
    for span in re.findall(r"`([^`\n]+)`", page.read_text(encoding="utf-8")):
        for named in NAMED.findall(span):
            if named in MADE_BY_COMMANDS or "NAME" in named:
                continue
            if not any((folder / named).exists() for folder in (ROOT, ROOT / "odescope", page.parent)):
                missing.append(named)
    assert not missing


def test_every_row_of_the_paper_names_a_place_with_its_symbols_and_a_test() -> None:
    """A symbol in code spans is defined in the module before it; a test's file holds tests."""
    rows = [
        r.split("|")[1:-1] for r in (ROOT / "docs/paper.md").read_text(encoding="utf-8").splitlines() if r[:1] == "|"
    ]
    places = 0
    for _, what, where, tests in rows[2:]:
        sources, spans = list[str](), re.findall(r"`([^`]+)`", where)
        for span in spans:
            if "/" in span:
                sources.append((ROOT / span).read_text(encoding="utf-8"))
            elif " " not in span:
                places += 1
                owner, _, member = span.rpartition(".")
                assert any(
                    re.search(rf"^(def|class) {owner or member}\b", s, re.MULTILINE)
                    and re.search(rf"^( *)(def|class) {member}\b", s, re.MULTILINE)
                    for s in sources
                ), f"{span} ({what.strip()})"
        assert spans
        for path in re.findall(r"`([^`]+)`", tests):
            assert path.startswith("tests/")
            assert re.search(r"^def test_", (ROOT / path).read_text(encoding="utf-8"), re.MULTILINE), path
    assert places > 20


def test_references_to_the_method_name_its_headings() -> None:
    """Comments say "docs/method.md, Signals": the heading is there, and the method names no folder that is not."""
    method = (ROOT / "docs/method.md").read_text(encoding="utf-8")
    headings = set(re.findall(r"^#+ (.+)$", method, re.MULTILINE))
    lost = []
    for path in sorted((ROOT / "odescope").rglob("*.py")):
        text = re.sub(r"\s+(?:# )?", " ", path.read_text(encoding="utf-8"))
        for reference in re.findall(r'docs/method\.md, "?([A-Z][^.)":;]*)', text):
            if not any(reference == h or reference.startswith((f"{h} ", f"{h},")) for h in headings):
                lost.append(f"{path.relative_to(ROOT)}: {reference}")
    assert not lost
    for module in re.findall(r"`([\w/]+(?:/|\.py))`", method):
        assert (ROOT / "odescope" / module).exists(), module


def test_lock_names_only_the_public_index() -> None:
    hosts = set(re.findall(r"https?://([^/\"]+)", (ROOT / "uv.lock").read_text(encoding="utf-8")))
    assert hosts == {"pypi.org", "files.pythonhosted.org"}
