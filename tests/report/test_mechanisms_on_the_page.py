"""Mechanisms, the forms that competed and the path of models, as the report shows them."""

import json
from dataclasses import replace

import msgspec
import pytest
from pages import ATTACK, Page, blank, identified

from odescope.export.model_file import to_json
from odescope.model.relation import FoundMechanism
from odescope.model.scores import Conserved, FormScore, FreeRun, ModelScores, PathScore
from odescope.report import read_report, summary, to_html, to_json_text
from odescope.report.assemble import model_of
from odescope.report.console import trust_text
from odescope.report.figures.catalogue import pictures


@pytest.fixture(scope="module")
def result():
    return identified()[0]


@pytest.fixture(scope="module")
def report(result):
    return summary(result, f"run {ATTACK}", truth=identified()[1])


def test_mechanisms_come_first_and_what_was_found_beside_them_is_no_warning(report, result):
    forms = (FormScore("reactions", 3, 0.01, 1.0, True, True), FormScore("relations", 7, 0.02, 1.0, True, False))
    scores = ModelScores(forms=forms, conserved=(Conserved("x + y", (0.98,), True),))
    mechanisms = (
        FoundMechanism("x + y -> 2 x", "reaction", "x*y", 1.03, 0.021),
        FoundMechanism(f"{ATTACK} -> y", "reaction", ATTACK, 2.0),
    )
    model = replace(result.model, mechanisms=mechanisms, scores=scores)
    notes = (
        "reactions (3 coefficients, free-run error 0.01) were preferred to relations (7, 0.02)",
        "mind the gap",
        "u acts late",
    )
    own = msgspec.Raw(msgspec.json.format(to_json(model).encode(), indent=0))
    changed = msgspec.structs.replace(report, model=own, notes=notes, warnings=("mind the gap",))
    html = to_html(changed, blank(changed))
    page = Page(html)
    assert html.index("⟶") < html.index("Rates of change")
    (row,) = [cells for _, cells in page.rows if cells[1:2] == ["1.030"]]
    assert row[2:4] == ["0.021", "0.989 to 1.071"]
    assert "<img" not in html
    warned = html[html.index('<div class="warning">') :].partition("</div>")[0]
    assert "mind the gap" in warned
    assert "preferred" not in warned
    assert "u acts late" not in warned
    assert [page.text.count(note) for note in notes] == [1, 1, 1]
    assert html.count("⚠") == 1
    assert "x + y stays constant at 0.98 in recording 1" in page.text


PATH = (
    PathScore(9, 0.0112, 0.004, None, None, False),
    PathScore(8, 0.0115, 0.0045, f"{ATTACK} in kinetic", 144.0, True),
    PathScore(7, 0.42, 0.1, "u in x_dot", 1e4, False),
)


def with_model(report, model):
    return msgspec.structs.replace(report, model=msgspec.Raw(msgspec.json.format(to_json(model).encode(), indent=0)))


def with_path(report, result, path):
    scores = msgspec.structs.replace(result.model.scores, path=path)
    return with_model(report, replace(result.model, scores=scores))


def test_the_path_is_shown_with_what_was_dropped_and_how_to_take_another(report, result):
    told = with_path(report, result, PATH)
    html = to_html(told, blank(told))
    page = Page(html)
    assert "<img" not in html
    start = page.text.index("What was dropped at each step")
    assert page.text.index("The candidates") < start
    rows = [(kind, cells) for kind, cells in page.rows if cells[0] in ("9", "8 ◀", "7") and len(cells) == 5]
    assert rows == [
        (None, ["9", "–", "–", "0.0112", "0.004"]),
        ("chosen", ["8 ◀", f"{ATTACK} in kinetic", "12", "0.0115", "0.0045"]),
        (None, ["7", "u in x_dot", "100", "0.42", "0.1"]),
    ]
    for words in ("terms = 9 under [likelihood]", "path/9_terms.json", "result.with_terms(9)"):
        assert words in page.text
    assert ("div", "class", "scroll") in page.attributes
    assert ("figure", "id", "path-of-models") in page.attributes
    assert ("a", "href", "#path") in page.attributes
    first = with_path(report, result, (msgspec.structs.replace(PATH[0], chosen=True), *PATH[2:]))
    assert "terms = 7 under [likelihood]" in Page(to_html(first, blank(first))).text


@pytest.mark.parametrize("path", [(), PATH[1:2]], ids=["none", "one"])
def test_without_a_path_of_two_models_there_is_no_such_section(report, result, path):
    told = with_path(report, result, path)
    assert not {"path", "path-of-models"} & {p.name for p in pictures(told)}
    page = Page(to_html(told, blank(told)))
    assert "path of models" not in page.text
    assert ("a", "href", "#path") not in page.attributes


def test_a_stored_report_from_before_there_were_paths_is_read(report, tmp_path):
    plain = json.loads(to_json_text(report))
    del plain["model"]["scores"]["path"]
    (tmp_path / "report.json").write_text(json.dumps(plain))
    stored = read_report(tmp_path / "report.json")
    assert model_of(stored).scores.path == ()
    assert "path of models" not in to_html(stored, blank(stored))


def test_what_is_held_out_of_targets_is_said_where_no_free_run_tells(report, result):
    without = msgspec.structs.replace(result.model.scores, path=())
    told = with_model(report, replace(result.model, scores=without))
    assert "R² held out" in trust_text(told)
    assert "R² held out" not in trust_text(with_path(report, result, PATH))


def test_nothing_of_the_regression_is_said_of_mechanisms(report, result):
    """Its candidates were held out, these mechanisms were not: free runs over what is held out are what is known."""
    scores = ModelScores(path=PATH, free_runs=(FreeRun(8.0, 8.0),))
    mechanisms = (FoundMechanism("x + y -> 2 x", "reaction", "x*y", 1.03, 0.021),)
    told = with_model(report, replace(result.model, mechanisms=mechanisms, scores=scores))
    text = trust_text(told)
    assert "R²" not in text
    rows = [line.split() for line in text.splitlines()]
    for relation, target in zip(result.model.relations, result.model.targets, strict=True):
        assert [target, str(len(relation.terms) - 1)] in rows
    assert "free-run error, held out: 0.011 ± 0.0045 standard deviations" in text
    captions = " ".join(p.caption for p in pictures(told))
    assert "another form was preferred" not in captions  # a candidate has the terms of its relations
    unlike = tuple(msgspec.structs.replace(s, adopted=False) for s in told.searches)
    captions = " ".join(p.caption for p in pictures(msgspec.structs.replace(told, searches=unlike)))
    assert "another form was preferred" in captions
    assert "another form was preferred" not in " ".join(p.caption for p in pictures(report))
