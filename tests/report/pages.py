"""Small results to report on, and a reader of pages that checks them as it goes."""

import functools
from html.parser import HTMLParser

import numpy as np

from odescope.pipeline.identification import identify
from odescope.report.figures.catalogue import pictures
from odescope.study.options import Data, Driven, Measured, Study

ATTACK = "<img src=x onerror=alert(1)>"
BLANK = '<svg viewBox="0 0 10 10"></svg>'
VOID = {"meta", "link", "img", "br", "hr", "input"}


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
        if tag in ("td", "th"):
            self.rows[-1][1].append("")
        if tag not in VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag, attrs):
        self.handle_starttag(tag, attrs)
        if tag not in VOID:
            self.open.pop()

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        if "style" in self.open:
            return
        self.texts.append(data)
        if "td" in self.open or "th" in self.open:
            self.rows[-1][1][-1] += data

    @property
    def text(self):
        return " ".join("".join(self.texts).split())


def samples(count=2000, seed=0):
    """x' = -x + .5 y + u, y' = 1 - 2 y + x y."""
    rng, h = np.random.default_rng(seed), 0.02
    t = h * np.arange(count)

    def drive(at):
        return np.sin(1.1 * at) + 0.7 * np.sin(2.7 * at + 1.0) + 0.4 * np.cos(4.3 * at)

    def slope(s, at):
        return np.array([-s[0] + 0.5 * s[1] + drive(at), 1.0 - 2 * s[1] + s[0] * s[1]])

    state, states = np.array([0.5, 1.5]), []
    for now in t:
        states.append(state)
        for k in range(4):  # Euler's midpoint rule, four steps a sample
            at = now + k * h / 4
            state = state + h / 4 * slope(state + h / 8 * slope(state, at), at + h / 8)
    clean = np.array(states)
    x, y = (clean + 1e-4 * rng.standard_normal((count, 2))).T
    truth = {"x": clean[:, 0], "y": clean[:, 1]}
    truth |= {"x_dot": -truth["x"] + 0.5 * truth["y"] + drive(t), "y_dot": 1 - 2 * truth["y"] + truth["x"] * truth["y"]}
    return {"t": t, "x": x, "y": y, "u": drive(t)}, truth


@functools.cache
def identified():
    """Return a result with hostile units, and the true signals."""
    data, truth = samples()
    study = Study(
        data=Data(time="t"),
        coordinates={"x": Measured(unit=ATTACK), "y": Measured()},
        inputs={"u": Driven(unit="$N & m$")},
    )
    return identify(study, data), truth


def blank(report):
    """Return an empty picture for every figure of a report."""
    return {p.name: BLANK for p in pictures(report)}
