"""The documentation runs: its Python blocks, its studies, its file names."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path

import numpy as np
import pytest

from odescope.events import Note
from odescope.report.assemble import read_report
from odescope.study.options import Data
from odescope.study.pieces import PLACES
from odescope.study.toml import parse_study

ROOT = Path(__file__).parent.parent


def blocks(path: str, language: str) -> list[str]:
    return re.findall(
        rf"^```{language}\n(.*?)^```", (ROOT / path).read_text(encoding="utf-8"), re.MULTILINE | re.DOTALL
    )


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
    assert capsys.readouterr().out.startswith("x_ddot = ")


def test_readme_study_is_a_study() -> None:
    study, streamed = blocks("README.md", "toml")
    assert parse_study(study).coordinates["phi"].column == "angle"
    assert parse_study(f"{streamed}\n[coordinates.x]").data.memory == Data().memory


def test_links_lead_somewhere() -> None:
    for page in (ROOT / "README.md", *ROOT.glob("docs/*.md")):
        for target in re.findall(r"\]\(([^)#:]+)\)", page.read_text(encoding="utf-8")):
            assert (page.parent / target).exists(), f"{page.name} links to {target}"
        for command in re.findall(r"python (bench/\w+\.py)", page.read_text(encoding="utf-8")):
            assert (ROOT / command).exists()


def test_lock_names_only_the_public_index() -> None:
    hosts = set(re.findall(r"https?://([^/\"]+)", (ROOT / "uv.lock").read_text(encoding="utf-8")))
    assert hosts == {"pypi.org", "files.pythonhosted.org"}
