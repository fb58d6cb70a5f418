import re

import numpy as np
import pytest
from built_models import build
from hand_models import MODELS

from odescope.export.languages.latex import to_latex
from odescope.export.languages.text import to_text
from odescope.recordings.coordinate import Coordinate, Input

FUNCTIONS = {f: getattr(np, f) for f in ("sin", "cos", "exp", "abs", "tanh")}


def values(model, text, variables):
    found = {}
    for line in (line for line in text.splitlines() if line[0] != "#"):
        target, _, right = line.partition(" = ")
        found[target] = eval(right, {"__builtins__": {}}, FUNCTIONS | variables)  # noqa: S307 (our own output)
    return found


def solved(model, variables):
    """Return the targets from the relations themselves: A y' = b by NumPy."""
    evaluate = lambda term: eval(term.text, {"__builtins__": {}}, FUNCTIONS | variables)  # noqa: S307, E731
    a, b = np.zeros((len(model.targets),) * 2), np.zeros(len(model.targets))
    for row, relation in enumerate(model.relations):
        for t in relation.terms:
            if t.factor is None:
                b[row] -= t.coefficient * evaluate(t.term)
            else:
                a[row, model.targets.index(t.factor)] += t.coefficient * evaluate(t.term)
    return dict(zip(model.targets, np.linalg.solve(a, b), strict=True))


@pytest.mark.parametrize("name", MODELS)
def test_the_text_is_what_the_relations_say(name):
    model = MODELS[name]
    rng = np.random.default_rng(0)
    for _ in range(10):
        variables = dict(zip(model.variables, rng.uniform(0.3, 1.2, len(model.variables)), strict=True))
        exact = solved(model, variables)
        written = values(model, to_text(model), variables)
        assert list(written) == list(model.targets)
        assert all(np.isclose(written[t], exact[t], rtol=1e-10, atol=0) for t in exact)
        rounded = values(model, to_text(model, 6), variables)
        assert all(np.isclose(rounded[t], exact[t], rtol=1e-4, atol=1e-5) for t in exact)


def test_digits_are_all_or_as_many_as_asked_for():
    assert "0.3333333333333333*u" in to_text(MODELS["rational"])
    assert "0.333333*u" in to_text(MODELS["rational"], 6)
    assert "0.33*u" in to_text(MODELS["rational"], 2)


def test_what_divides_stands_below_its_coefficient():
    terms = {"v**-1": -0.4298, "v**-2": 1.0, "u**-1*v**-1": 2.5, "u*v**-1": 0.5, "exp(3.0*v**-1)": 0.25}
    target, rest = ("x_dot", "1", 1.0), [(None, text, c) for text, c in terms.items()]
    model = build([Coordinate("x")], [Input("u"), Input("v")], [target, *rest])
    (line,) = to_text(model).splitlines()
    assert "*1/" not in line
    for part in ("exp(3.0/v)", "0.4298/v", "- 1/v**2", "- 2.5/(u*v)", "- 0.5*u/v"):
        assert part in line
    variables = {"x": 1.0, "u": 0.7, "v": 0.3}
    assert values(model, line, variables)["x_dot"] == pytest.approx(solved(model, variables)["x_dot"], rel=1e-14)


@pytest.mark.parametrize("name", MODELS)
def test_latex_is_one_balanced_line_a_target(name):
    latex = to_latex(MODELS[name])
    lines = latex.split(" \\\\\n")
    errors = [r for r in MODELS[name].relations if any(t.std_error is not None for t in r.terms)]
    assert len(lines) == len(MODELS[name].targets) + len(errors)
    for line in lines:
        assert "\n" not in line
        depth = 0
        for mark in re.findall(r"(?<!\\)[{}]", line):
            depth += 1 if mark == "{" else -1
            assert depth >= 0
        assert depth == 0
        assert line.count(r"\left(") == line.count(r"\right)")
        assert not re.search(r"\de[-+]?\d", line)  # no 1e-09


def test_latex_of_a_rational_model():
    first, second, errors = to_latex(MODELS["rational"]).split(" \\\\\n")
    assert first.startswith(r"\ddot{x} = \frac{")
    assert r"\cos^{2}\left(\phi\right)" in first
    assert r"0.333333 \, u" in first
    assert r"1 \cdot 10^{-17}" in first
    assert second.startswith(r"\ddot{\phi} = \frac{")
    assert r"\dot{\phi} \, \left|\dot{\phi}\right|" in second
    left, right = errors.split(" = ")
    assert left == r"\ddot{x} - \left(0.3000 \pm 0.0010\right) \, \ddot{x} \, \cos^{2}\left(\phi\right)"
    assert right.endswith(r"\sin\left(\phi\right) - \left(5.55 \pm 0\right) \, \dot{x} - 1 \cdot 10^{-17}")
