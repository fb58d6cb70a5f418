"""The site of the documentation: what is made for it is complete, and its checks find what is wrong."""

from __future__ import annotations

import importlib.util
import re
import sys
from collections import Counter
from pathlib import Path
from types import ModuleType
from typing import Annotated

import msgspec
import pytest

import odescope
from odescope.commands.cli import app
from odescope.model.scores import ModelScores
from odescope.study.described import described
from odescope.study.options import Study

ROOT = Path(__file__).parent.parent


def loaded(path: str) -> ModuleType:
    """A module that is no part of the package, with its neighbours within reach while it is read."""
    spec = importlib.util.spec_from_file_location(Path(path).stem, ROOT / path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.path.insert(0, str((ROOT / path).parent))
    try:
        spec.loader.exec_module(module)
    finally:
        sys.path.pop(0)
    return module


def properties(root: type) -> Counter[str]:
    """Every key of a class and of those in it, as msgspec writes its schema, but for the tags of kinds."""
    definitions = msgspec.json.schema(root)["$defs"]
    return Counter(
        key
        for name, definition in definitions.items()
        if name != root.__name__
        for key, value in definition["properties"].items()
        if "enum" not in value or len(value["enum"]) > 1 or key != "kind"
    )


def test_every_option_is_in_the_reference_of_studies() -> None:
    page = loaded("docs/site/study_reference.py").study_reference()
    keys = re.findall(r"^\(study-([\w-]+)\)=\n`(\w+)`\n: (.+)\n\n  (\w.+)$", page, re.MULTILINE)
    assert Counter(key for _, key, _, _ in keys) == properties(Study)
    assert len({anchor for anchor, *_ in keys}) == len(keys)
    for name in msgspec.structs.fields(Study):
        assert re.search(rf"^## `\[{name.name}[\].]", page, re.MULTILINE), name.name
    facts = {anchor: said for anchor, _, said, _ in keys}
    assert facts["data-memory"] == "number; in MB; default `1000.0`"
    assert facts["coordinates-order"] == "whole number; default `1`"
    assert facts["library-degree"] == "whole number, at least 1, at most 12; default `3`"
    assert facts["inputs-delay"] == 'number or `"auto"` or `"estimate"`; in s; default `"auto"`'
    assert facts["library-rules"] == "list of tables with a `kind` each; no default"
    assert facts["library-parameters"].startswith('table of [number, number] or `"scale"`')
    assert facts["regression-rows"] == 'a table with a `kind`; default `{ kind = "noise_weighted", passes = 1 }`'
    assert facts["signals-differentiator-cutoff-fixed-frequency"] == "number, above 0; in Hz; needed"


def test_an_option_without_a_meaning_is_refused() -> None:
    class Silent(msgspec.Struct):
        """Options.

        Attributes:
            low (s): the least.
            hgih: the largest.
        """

        low: Annotated[float, msgspec.Meta(gt=0.0)] = 0.1
        high: float = 1.0

    with pytest.raises(LookupError, match="Silent: attributes and fields differ in hgih, high"):
        described(Silent)


def test_every_score_is_in_the_reference_of_files() -> None:
    page = loaded("docs/site/scores_reference.py").scores_reference()
    own = Counter(field.name for field in msgspec.structs.fields(ModelScores))
    assert Counter(re.findall(r"^- `(\w+)`: .", page, re.MULTILINE)) == properties(ModelScores) + own


def test_every_command_is_in_the_reference_of_commands(capsys: pytest.CaptureFixture[str]) -> None:
    """What --help prints of each is there: its arguments, options and words."""
    page = loaded("docs/site/command_reference.py").command_reference()
    sections = re.findall(r"^## odescope (\w+)\n(.*?)(?=^## |\Z)", page, re.MULTILINE | re.DOTALL)
    assert {"identify", "simulate", "filter", "validate", "demo", "report", "export"} <= {name for name, _ in sections}
    for name, section in sections:
        with pytest.raises(SystemExit):
            app([name, "--help"])
        told = capsys.readouterr().out
        options = set(re.findall(r"^ +(--[\w-]+)", told, re.MULTILINE)) - {"--help"}
        assert options == set(re.findall(r"^`(--[\w-]+)", section, re.MULTILINE))
        (described,) = re.findall(r"^ *Usage:.*\n\n((?: .*\n)+)", told, re.MULTILINE)
        assert "".join(described.split()) in "".join(section.split())


def test_every_public_name_is_in_the_reference_of_python() -> None:
    page = loaded("docs/site/python_reference.py").python_reference()
    named = re.findall(r"^\.\. auto(?:class|function):: odescope\.(\w+)$", page, re.MULTILINE)
    assert sorted(["__version__", *named]) == sorted(odescope.__all__)


def test_every_page_is_in_the_navigation() -> None:
    """That is made of the lists of the index: what no list names nobody finds."""
    index = (ROOT / "docs/index.md").read_text(encoding="utf-8")
    listed = set(re.findall(r"^- \[.*?\]\((.*?)\)", index, re.MULTILINE))
    pages = {p.relative_to(ROOT / "docs").as_posix() for p in (*ROOT.glob("docs/*.md"), *ROOT.glob("docs/*/*.ipynb"))}
    assert listed == pages - {"index.md"} | {"decisions/index.md"}


GOOD = '<link rel="stylesheet" href="a.css"><h1 id="top">A</h1><a href="b.html#here">B</a><a href="https://x.org">X</a>'


@pytest.mark.parametrize(
    ("page", "style", "said"),
    [
        (GOOD, "", []),
        ('<script src="https://x.org/a.js"></script>', "", ["a.html loads https://x.org/a.js"]),
        ('<img src="//x.org/a.png">', "", ["a.html loads //x.org/a.png"]),
        ('<link rel="preload" href="https://x.org/f.woff2">', "", ["a.html loads https://x.org/f.woff2"]),
        ('<p style="background: url(http://x.org/a.png)">', "", ["a.html loads http://x.org/a.png"]),
        (GOOD, '@import "https://x.org/b.css";', ["a.css loads https://x.org/b.css"]),
        ('<a href="c.html">C</a>', "", ["a.html leads to c.html, which is not there"]),
        ('<img src="c.png">', "", ["a.html leads to c.png, which is not there"]),
        ('<a href="b.html#there">B</a>', "", ["a.html leads to b.html#there, a page without that place"]),
        ('<a href="#there">B</a>', "", ["a.html leads to #there, a page without that place"]),
    ],
)
def test_the_check_of_the_site_finds_what_is_wrong(page: str, style: str, said: list[str], tmp_path: Path) -> None:
    (tmp_path / "a.html").write_text(page)
    (tmp_path / "a.css").write_text(style)
    (tmp_path / "b.html").write_text('<p id="here">')
    assert loaded(".ci/check_site.py").wrong(tmp_path) == said


def test_a_site_without_pages_is_wrong(tmp_path: Path) -> None:
    assert loaded(".ci/check_site.py").wrong(tmp_path) == [f"{tmp_path} holds no page"]
