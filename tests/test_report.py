import json
import re
from dataclasses import replace
from html.parser import HTMLParser

import numpy as np
import pytest

from odescope.export.text import to_text
from odescope.identification import identify
from odescope.report import SHOWN, summary, to_html
from odescope.study import Data, Driven, Measured, Study, study_toml

ATTACK = "<img src=x onerror=alert(1)>"
VOID = {"meta", "link", "img", "br", "hr", "input", "path"}


class Page(HTMLParser):
    """Reads a page: its tags, attributes and visible text; unclosed or crossed tags are errors."""

    def __init__(self, html):
        super().__init__(convert_charrefs=True)
        self.open, self.tags, self.attributes, self.texts, self.rows = [], [], [], [], []
        self.feed(html)
        self.close()
        assert self.open == []

    def handle_starttag(self, tag, attrs):
        self.tags.append(tag)
        self.attributes += [(tag, name, value or "") for name, value in attrs]
        if tag == "tr":
            self.rows.append((dict(attrs).get("class"), []))
        if tag not in VOID:
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        if "style" not in self.open:
            self.texts.append(data)
        if self.open[-1:] == ["td"]:
            self.rows[-1][1].append(data)

    @property
    def text(self):
        return " ".join("".join(self.texts).split())


@pytest.fixture(scope="module")
def result():
    """x' = -x + .5 y + u, y' = -2 y + x y."""
    rng, h = np.random.default_rng(0), 0.02
    t = h * np.arange(2000)
    u = np.sin(1.1 * t) + 0.7 * np.sin(2.7 * t + 1.0) + 0.4 * np.cos(4.3 * t)
    state, states = np.array([0.5, 1.5]), []
    for now in t:
        states.append(state)
        for k in range(4):  # Euler's midpoint rule, four steps a sample
            at = now + k * h / 4

            def f(s, at):
                drive = np.sin(1.1 * at) + 0.7 * np.sin(2.7 * at + 1.0) + 0.4 * np.cos(4.3 * at)
                return np.array([-s[0] + 0.5 * s[1] + drive, 1.0 - 2 * s[1] + s[0] * s[1]])

            half = state + h / 8 * f(state, at)
            state = state + h / 4 * f(half, at + h / 8)
    x, y = (np.array(states) + 1e-4 * rng.standard_normal((len(t), 2))).T
    study = Study(
        data=Data(time="t"),
        coordinates={"x": Measured(unit=ATTACK), "y": Measured()},
        inputs={"u": Driven(unit="N & m")},
    )
    return identify(study, {"t": t, "x": x, "y": y, "u": u})


@pytest.fixture(scope="module")
def html(result):
    return to_html(summary(result, f"run {ATTACK}", study_toml(result.study)))


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


def test_text_from_outside_stays_text(page, html):
    assert "<img" not in html
    assert not any(name.startswith("on") for _, name, _ in page.attributes)
    assert f"run {ATTACK}" in page.text  # the title
    assert page.rows[1][1][:2] == ["x", ATTACK]  # the unit
    assert page.text.count(ATTACK) >= 4  # title, heading, unit, study


def test_every_field_of_the_summary_is_escaped(result):
    data = summary(result, "title", "study")

    def poisoned(value):
        if isinstance(value, dict):
            return {k: poisoned(v) for k, v in value.items()}
        if isinstance(value, list):
            return [poisoned(v) for v in value]
        return f"{ATTACK}\"'" if isinstance(value, str) else value

    html = to_html(poisoned(data))
    assert "<img" not in html
    assert not any("onerror" in name or "onerror" in value for _, name, value in Page(html).attributes)


def test_the_equations_are_those_of_the_model(page, result):
    equations = to_text(result.model, 6)
    assert " ".join(equations.split()) in page.text
    assert equations.startswith("x_dot = ")
    # To six digits they still are the truth.
    assert float(re.search(r"([\d.]+)\*y", equations)[1]) == pytest.approx(0.5, rel=0.02)


def test_the_summary_is_plain_data(result):
    data = summary(result, "title", "study")
    assert json.loads(json.dumps(data, allow_nan=False)) == data


def test_the_chosen_are_marked_and_counted(page, result):
    marked = [cells for kind, cells in page.rows if kind == "chosen"]
    assert len(marked) == 2
    for cells, search, chosen in zip(marked, result.searches, result.chosen, strict=True):
        assert cells[0] == " + ".join(search.problem.terms[j].text for j in chosen.support)
        assert cells[1:3] == [str(len(chosen.support)), str(len(chosen.guesses))]
        assert float(cells[3]) == pytest.approx(chosen.target_rmse, rel=1e-3)


def test_what_was_discarded_is_shown_with_its_reason(page, result):
    for search in result.searches:
        assert search.ranked.discarded
        for reason, count in search.ranked.discarded:
            assert f"{count} {reason}" in page.text
        kept = len(search.ranked.candidates)
        assert f"{len(search.found.supports)} distinct relations, {kept} kept." in page.text


def test_at_most_a_dozen_candidates_are_shown(result):
    for shown, search in zip(summary(result, "", "")["searches"], result.searches, strict=True):
        assert len(shown["candidates"]) == min(SHOWN, len(search.ranked.candidates))
    assert any(len(s.ranked.candidates) > SHOWN for s in result.searches)


def test_the_measured_noise_and_cutoff_are_shown(page, result):
    x, y = (cells for kind, cells in page.rows[1:3])
    for cells, channel in ((x, result.signals.channels[0]), (y, result.signals.channels[1])):
        assert float(cells[-2]) == pytest.approx(channel.noise, rel=1e-3) == pytest.approx(1e-4, rel=0.1)
        assert float(cells[-1]) == pytest.approx(channel.cutoff, rel=1e-3)


def test_a_free_run_that_ended_early_and_notes_are_told(result):
    free_run = {"duration": 8.0, "valid_time": 0.5, "ended": "the states grew without bound"}
    model = replace(result.model, scores={**result.model.scores, "free_run": free_run})
    told = summary(replace(result, model=model), "", "")["trust"]
    assert "free run over 8 s of the record: valid for 0.5 s; the states grew without bound" in told
    whole = summary(result, "", "")["trust"]
    assert len(whole) == 3 + len(result.notes)
    assert all(f"{100 * c.target_r2:.2f}%" in line for c, line in zip(result.chosen, whole, strict=False))
