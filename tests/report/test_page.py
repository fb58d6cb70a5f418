import json
import re
from dataclasses import replace

import msgspec
import numpy as np
import pytest
from pages import ATTACK, Page, blank, identified, samples

from odescope.errors import InputError
from odescope.model.relation import RelationTerm
from odescope.model.scores import FreeRun
from odescope.pipeline.identification import DraftReady, identify
from odescope.report import read_report, summary, to_html, to_json_text
from odescope.report.assemble import model_of
from odescope.report.console import trust_text
from odescope.report.data import Report, TableRow
from odescope.report.figures.catalogue import pictures
from odescope.report.page import in_time, number, with_error
from odescope.report.recorded import recorded
from odescope.study.options import Data, Driven, Measured, Study

TABLE = (TableRow(target="x_dot", term="u", truth=1.0, paper=None, found=0.9999),)


@pytest.fixture(scope="module")
def result():
    return identified()[0]


@pytest.fixture(scope="module")
def report(result):
    return summary(result, f"run {ATTACK}", truth=identified()[1], table=TABLE)


@pytest.fixture(scope="module")
def html(report):
    return to_html(report)


@pytest.fixture(scope="module")
def page(html):
    return Page(html)


def test_the_page_needs_nothing_from_elsewhere(page, html):
    assert not {"script", "link", "iframe", "object", "embed", "base", "form"} & set(page.tags)
    for tag, name, value in page.attributes:
        if name in ("src", "href", "srcset", "data", "action", "xlink:href"):
            assert value.startswith(("#", "data:")), f"{tag} {name}={value}"
    assert not re.search(r"url\(\s*['\"]?(?!data:|#)", html)
    assert "@import" not in html
    elsewhere = set(re.findall(r"https?://[^\"'\s<)]+", html))
    assert elsewhere <= {
        "http://www.w3.org/1998/Math/MathML", "http://www.w3.org/2000/svg", "http://www.w3.org/1999/xlink"
    }  # fmt: skip


def test_text_from_outside_stays_text(page, html):
    assert "<img" not in html
    assert not any(name.startswith("on") for _, name, _ in page.attributes)
    assert f"run {ATTACK}" in page.text  # the title
    assert ["x", "x", ATTACK] in [cells[:3] for _, cells in page.rows]  # the unit
    assert "$N & m$" in page.text
    assert page.text.count(ATTACK[:20]) >= 8  # and in figures and in the study


def test_every_text_of_the_report_is_escaped(report, result):
    poisoned = f"{ATTACK}\"' {{{{ 7 * 7777 }}}}"

    def poison(value, key=None):
        if isinstance(value, dict):
            return {k: v if k in ("model", "format", "role", "signs") else poison(v, k) for k, v in value.items()}
        if isinstance(value, list):
            return [poison(v, key) for v in value]
        return poisoned if isinstance(value, str) else value

    plain = poison(json.loads(to_json_text(report)))
    scores = plain["model"]["scores"]
    scores["free_runs"][0]["ended"] = poisoned
    scores["targets"][poisoned] = scores["targets"]["x_dot"]
    scores["likelihood"] |= {
        "hints": [poisoned],
        "limits": [{"target": poisoned, "term": poisoned, "limit": 1.0}],
        "correlations": [{"first": poisoned, "second": poisoned, "correlation": 0.99}],
        "trail": [
            {"gap": 1.0, "action": poisoned, "target": poisoned, "term": poisoned, "statistic": 3.0} | {"price": 2.0}
        ],
        "process_noise": {poisoned: 0.1},
    }
    scores["path"][1]["dropped"] = poisoned
    stored = msgspec.json.decode(json.dumps(plain), type=Report)
    html = to_html(stored)  # figures too
    assert "<img" not in html
    read = Page(html)
    assert not any("onerror" in name for _, name, _ in read.attributes)
    assert read.text.count("{{ 7 * 7777 }}") > 40
    assert "54439" not in html


def test_the_page_from_the_stored_data_is_the_page_byte_for_byte(report, html, tmp_path):
    (tmp_path / "report.json").write_text(to_json_text(report))
    stored = read_report(tmp_path / "report.json")
    assert stored == report
    assert to_json_text(stored) == to_json_text(report)
    assert to_html(stored) == html


def test_no_two_elements_share_an_id_and_all_that_is_used_is_there(page):
    ids = [value for _, name, value in page.attributes if name == "id"]
    assert len(ids) == len(set(ids))
    used = {value for _, name, value in page.attributes if name in ("href", "xlink:href") and value.startswith("#")}
    used |= {f"#{m}" for _, _, value in page.attributes for m in re.findall(r"url\(#([^)]+)\)", value)}
    assert used <= {f"#{i}" for i in ids}
    assert len(used) > 20


def test_every_figure_has_an_alternative_text_and_a_caption(page, report):
    labels = [value for tag, name, value in page.attributes if (tag, name) == ("div", "aria-label")]
    for picture in pictures(report):
        assert picture.alternative in labels
        assert " ".join(picture.caption.split()) in page.text
    assert page.tags.count("figure") == page.tags.count("figcaption") == len(pictures(report)) == 11


def test_the_model_is_that_of_the_result_with_errors_and_units(report, page, result):
    model = model_of(report)
    assert [r.terms for r in model.relations] == [r.terms for r in result.model.relations]
    rows = {cells[0]: cells for _, cells in page.rows if len(cells) == 5}
    term = next(t for t in result.model.relations[1].terms if t.text == "x*y")
    assert term.std_error is not None
    value, error = (float(cell.replace("−", "-")) for cell in rows["x\u2062y"][1:3])
    assert value == pytest.approx(term.coefficient, abs=term.std_error / 10)
    assert error == pytest.approx(term.std_error, rel=0.06)
    low, high = (float(end.replace("−", "-")) for end in rows["x\u2062y"][3].split(" to "))
    assert (low, high) == pytest.approx((value - 1.96 * error, value + 1.96 * error), abs=0.1 * error)
    y = report.coefficients[1][[t.text for t in result.model.relations[1].terms].index("y")]
    assert y.unit == ""  # y states no unit


def test_an_angle_without_a_unit_is_in_radians(result):
    angles = tuple(msgspec.structs.replace(c, angle=True, unit=None) for c in result.signals.coordinates)
    turned = replace(result, signals=replace(result.signals, coordinates=angles))
    assert [c.unit for c in recorded(turned).coordinates] == ["rad", "rad"]


def test_what_to_trust_is_said_in_words(page, result):
    scores = result.model.scores
    assert f"{100 * scores.targets['x_dot'].r2_held_out:.2f} % of the variance of x_dot" in page.text or (
        "more than 99.99 % of the variance of x_dot" in page.text
    )
    assert "No denominator vanishes between the states of the data." in page.text
    run = FreeRun(duration=8.0, valid_time=0.5, ended="the states grew without bound")
    early = replace(result, model=replace(result.model, scores=msgspec.structs.replace(scores, free_runs=(run,))))
    told = summary(early)
    text = Page(to_html(told, blank(told))).text
    assert "Run freely from its start, it stays with the recording for 0.5 of 8 s. The free run ended early:" in text


@pytest.mark.slow
def test_what_is_known_before_the_likelihood_stage_can_be_shown_like_a_result():
    data, _ = samples(count=1000)
    study = Study(data=Data(time="t"), coordinates={"x": Measured(), "y": Measured()}, inputs={"u": Driven()})
    told = []
    result = identify(study, data, watch=told.append)
    (draft,) = (event.result for event in told if isinstance(event, DraftReady))
    assert draft.model.scores is None
    assert set(draft.notes) <= set(result.notes)
    assert draft._repr_html_().count("<math") == 2
    assert "<li>" not in draft.model._repr_html_()
    told = summary(draft)
    text = Page(to_html(told, blank(told))).text
    assert "The model at work" in text
    assert "What the likelihood of the trajectory changed" not in text
    assert "–" in trust_text(told)


def test_without_errors_the_page_says_so(result):
    bare = tuple(
        replace(r, terms=tuple(RelationTerm(t.product, t.coefficient) for t in r.terms)) for r in result.model.relations
    )
    told = summary(replace(result, model=replace(result.model, relations=bare)))
    text = Page(to_html(told, blank(told))).text
    assert "No standard error is stated" in text
    assert "says how far the noise alone" not in text


def test_the_chosen_are_marked_and_what_was_discarded_is_shown_with_its_reason(page, result):
    marked = [cells for kind, cells in page.rows if kind == "chosen" and len(cells) == 6]
    assert len(marked) == 2
    for cells, search, chosen in zip(marked, result.searches, result.chosen, strict=True):
        assert cells[1] == ", ".join(search.problem.terms[j].text for j in chosen.support)
        assert cells[2:4] == [str(len(chosen.support)), str(len(chosen.guesses))]
        assert float(cells[4]) == pytest.approx(chosen.target_rmse, rel=1e-3)
        for reason, count in search.ranked.discarded:
            assert [reason, str(count)] in [row for _, row in page.rows]
        for rule, count in search.removed:
            assert [rule, str(count)] in [row for _, row in page.rows]


def test_the_grid_holds_the_signs_of_the_candidates(report, result):
    for searched, search in zip(report.searches, result.searches, strict=True):
        assert [r.rank for r in searched.rows] == sorted(r.rank for r in searched.rows)
        place = {term.text: j for j, term in enumerate(search.problem.terms)}
        for row in searched.rows:
            candidate = search.ranked.candidates[row.rank - 1]
            signs = {c: s for c, s in zip(searched.columns, row.signs, strict=True) if s != "."}
            assert {place[c] for c in signs} == set(candidate.support)
            assert all((candidate.xi[place[c]] > 0) == (s == "+") for c, s in signs.items())
            assert search.problem.terms[candidate.guess].text == row.guess


def test_held_out_means_held_out(report, result):
    """The refitted coefficients do not change when the stretch they are judged on does."""
    from odescope.report.at_work import predicted, without_folds

    assert report.at_work.held_out
    problem = result.searches[0].problem
    models = without_folds(result)
    assert models.keys() == {b.fold for b in problem.blocks}
    assert all(problem.training[fold].rows < problem.factor.rows for fold in models)
    refitted = models[0]
    for own, other in zip(refitted.relations[0].terms, result.model.relations[0].terms, strict=True):
        assert own.coefficient == pytest.approx(other.coefficient, rel=0.02)
        assert own.std_error is None
    assert any(
        a.coefficient != b.coefficient
        for a, b in zip(refitted.relations[0].terms, result.model.relations[0].terms, strict=True)
    )
    columns = result.signals.joined()
    rows = columns[[result.signals.row(v) for v in result.model.variables]]
    values = dict(zip(result.model.variables, rows, strict=True))
    quotient = predicted(result.model, rows)
    exact = -values["x"] + 0.5 * values["y"] + values["u"]
    assert np.abs(quotient[0] - exact).max() < 0.01


def test_truth_is_drawn_beside_the_derivatives_and_vanishes_without(report, result):
    roles = {line.role for panel in report.observed.derivatives.panels for line in panel.wide}
    assert roles == {"estimated", "truth"}
    told = summary(result)
    assert {line.role for p in told.observed.derivatives.panels for line in p.wide} == {"estimated"}
    text = Page(to_html(told, blank(told))).text
    assert "Against the truth" not in text
    assert "Table 2" not in text


def test_table_two_is_on_the_page(page):
    assert "Table 2" in page.text
    assert ["x_dot", "u", "1", "missing", "0.9999"] in [cells for _, cells in page.rows]


def test_what_the_filter_removed_is_the_noise(report):
    panel = report.observed.recorded.chart.panels[0]
    rest = np.array([v for v in panel.close[0].y if v is not None])
    assert 2e-4 < np.abs(rest).max() < 1e-3  # noise of 1e-4: nothing of the motion, of size 1


@pytest.mark.parametrize(
    ("change", "part"),
    [
        (lambda d: d.update(version=2), "its version is not 1"),
        (lambda d: d.update(format="other"), 'its format is not "odescope/report"'),
        (lambda d: d.pop("title"), "missing required field `title`"),
        (lambda d: d.update(extra=1), "unknown field `extra`"),
        (lambda d: d["searches"][0]["rows"][0].update(signs="+"), "does not fit"),
        (lambda d: d["searches"][0]["correlations"]["percent"].pop(), "not a square table"),
        (lambda d: d["observed"]["recorded"]["chart"]["panels"][0]["wide"][0]["x"].pop(), "abscissas"),
        (lambda d: d["model"]["relations"][0]["terms"][0].update(term="__import__('os')"), "is not a report"),
        (lambda d: d["coefficients"].pop(), "its coefficients are not those of its model"),
    ],
)
def test_a_stored_report_that_is_wrong_is_refused_in_one_line(report, tmp_path, change, part):
    plain = json.loads(to_json_text(report))
    change(plain)
    (tmp_path / "report.json").write_text(json.dumps(plain))
    with pytest.raises(InputError, match=re.escape(part)) as error:
        read_report(tmp_path / "report.json")
    assert "\n" not in str(error.value)


def test_a_report_that_is_no_json_or_not_there(tmp_path):
    with pytest.raises(InputError, match="odescope identify writes it"):
        read_report(tmp_path / "report.json")
    (tmp_path / "report.json").write_bytes(b"\xff{")
    with pytest.raises(InputError, match="is not a report"):
        read_report(tmp_path / "report.json")


def test_numbers_for_people():
    assert [number(v) for v in (0.001, 1.0, -2919.4, 9.1e7, 1e-9, None, float("nan"))] == [
        "0.001", "1", "−2919", "9.100·10⁷", "1.000·10⁻⁹", "–", "–"
    ]  # fmt: skip
    assert with_error(-5.55563621, 0.0000524) == ("−5.555636", "0.000052")
    assert with_error(32.059, 0.0996) == ("32.06", "0.10")
    assert with_error(1234.0, 95.0) == ("1234", "95")
    assert with_error(0.001, 0.5) == ("0.001", "0.5")
    assert [in_time(v) for v in (65.0, 600.0, 36000.0)] == ["65 s", "10 min", "10 h"]


def test_without_searches_there_is_no_figure_of_them(report):
    names = {p.name for p in pictures(msgspec.structs.replace(report, searches=()))}
    assert not {name for name in names if name.startswith(("accuracy", "candidates", "correlation"))}


def test_what_the_page_says_of_gaps_is_what_the_notes_say(result):
    lost = [300, 301, 302, 900]
    data = {name: np.delete(column, lost) for name, column in samples()[0].items()}
    study = Study(data=Data(time="t"), coordinates={"x": Measured(), "y": Measured()}, inputs={"u": Driven()})
    found = identify(study, data)
    page = Page(to_html(summary(found)))
    told = "4 samples of x, of 2000, are missing (0.20 %), in 2 gaps"
    assert told in found.notes
    assert f"{told}." in page.text
    assert "No gap was found" not in page.text
    assert "gap before" not in page.text
    table = [cells for _, cells in page.rows if cells[-1] in ("missing samples", "4")]
    assert table[0][-1] == "missing samples"
    assert table[1][1:] == ["2,000", "39.98 s", "4"]
    assert "No gap was found." in Page(to_html(summary(result))).text
