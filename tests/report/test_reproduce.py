"""What the page prints to do it again runs as it is printed, and no piece of one's own is in its way."""

from html import unescape
from itertools import combinations
from pathlib import Path

import numpy as np
import pytest
from logs import Command, oscillator, write
from pages import Page

from odescope import Derivatives, identify, read_study, to_json
from odescope.likelihood.search import LikelihoodSearch
from odescope.report import summary, to_html
from odescope.report.figures.catalogue import pictures
from odescope.report.page import report_files
from odescope.study.library_options import Candidates
from odescope.study.options import Data, Driven, Filtering, Measured, Regression, Study
from odescope.study.toml import parse_study

BLANK = ('<svg viewBox="0 0 1 1"></svg>', b"")
REGRESSED = LikelihoodSearch(enabled=False)


def printed(html):
    """Return the study that a page prints, and what it says above it."""
    study = unescape(html[html.index("<pre") : html.index("</pre>")].split(">", 1)[1])
    return study, Page(html).text.rpartition("How to reproduce")[2]


def test_the_printed_study_runs_where_the_page_says(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    for folder in ("logs/first", "logs/second", "studies"):
        Path(folder).mkdir(parents=True)
    write("logs/first/run.csv", oscillator(seed=2))
    write("logs/second/run.csv", oscillator(seed=3))
    Path("studies/mass.toml").write_text(
        '[data]\nfiles = ["../logs/first/run.csv", "../logs/second/run.csv"]\ntime = "t"\n'
        "[coordinates.x]\norder = 2\n[inputs.u]\n[likelihood]\nenabled = false\n"
    )
    odescope = Command(monkeypatch, capsys)
    assert odescope("identify", "studies/mass.toml", "--out", "results").code == 0
    study, said = printed(Path("results/report.html").read_text())
    assert "in the folder that holds first/run.csv, go there, and run odescope identify study.toml" in said
    Path("logs/study.toml").write_text(study)
    monkeypatch.chdir("logs")
    assert odescope("identify", "study.toml").code == 0
    assert Path("study/model.json").read_bytes() == Path("../results/model.json").read_bytes()


def test_the_printed_study_of_data_in_memory_runs_from_python(tmp_path):
    data = oscillator()
    study = Study(
        data=Data(time="t"), coordinates={"x": Measured(order=2)}, inputs={"u": Driven()}, likelihood=REGRESSED
    )
    result = identify(study, data)
    told = summary(result)
    text, said = printed(to_html(told, {p.name: BLANK[0] for p in pictures(told)}))
    assert 'odescope.identify(odescope.read_study(pathlib.Path("study.toml")), data)' in said
    (tmp_path / "study.toml").write_text(text)
    assert to_json(identify(read_study(tmp_path / "study.toml"), data).model) == to_json(result.model)


class SmallSubsets:
    """The proposer of docs/extending.md."""

    def supports(self, factor, left, columns):
        others = [j for j in columns if j != left]
        for size in (2, 3):
            yield from combinations(others, size)


class Gaussian:
    """The differentiator of docs/extending.md, with a longer window."""

    def derivatives(self, channel, period, order):
        from scipy.ndimage import gaussian_filter1d

        width = 0.08 / period
        values = tuple(
            np.array([gaussian_filter1d(s, width, order=k, mode="nearest") / period**k for k in range(order + 1)])
            for s in channel
        )
        noise = float(np.std(np.concatenate([s - v[0] for s, v in zip(channel, values, strict=True)])))
        return Derivatives(values, noise, cutoff=1.0 / (2 * np.pi * 0.08))


@pytest.mark.parametrize(
    ("own", "name"),
    [
        ({"regression": Regression(proposers=(SmallSubsets(),))}, "SmallSubsets"),
        ({"signals": Filtering(differentiator=Gaussian())}, "Gaussian"),
    ],
)
def test_pieces_of_ones_own_are_reported_like_any(own, name):
    study = Study(
        data=Data(time="t"),
        coordinates={"x": Measured(order=2)},
        inputs={"u": Driven()},
        library=Candidates(basis=("x", "x_dot", "u"), degree=1),
        likelihood=REGRESSED,
        **own,
    )
    result = identify(study, oscillator())
    assert {t.text for t in result.model.relations[0].terms} >= {"x_ddot", "x", "x_dot", "u"}
    told = summary(result)
    files = report_files(told, {p.name: BLANK for p in pictures(told)})
    text = printed(files["report.html"])[0]
    assert [name in line for line in text.splitlines() if line.startswith("#")] == [True]
    again = parse_study(text)  # with the defaults in its place
    assert (again.coordinates, again.library) == (study.coordinates, study.library)
