"""The libraries that the options of a study make."""

import pytest

from odescope.errors import InputError
from odescope.study.toml import parse_study

PLAIN = '[data]\nfiles = ["run.csv"]\ntime = "t"\n[coordinates.x]\norder = 2\n[inputs.u]\n'
PAPER = """
[coordinates.x]
order = 2
cyclic = true
[coordinates.phi]
order = 2
angle = true
[inputs.u]
[library]
preset = "paper"
"""


@pytest.mark.parametrize(
    ("table", "parts"),
    [
        ('basis = ["x_dot", "v"]', ["'v'", "u, x, x_ddot, x_dot"]),
        ('basis = ["x_dot", "sinn(x)"]', ["'sinn'", "did you mean 'sin'?"]),
        ('basis = ["x_dot", "x+u"]', ["'x+u'", "one product"]),
        ('basis = ["x_dot", "x^2"]', ["'x^2'", "**"]),
        ("basis = [\"x_dot\", \"__import__('os').system('touch pwned')\"]", ["__import__", "only names"]),
        ('basis = ["x_dot", "9**9**9"]', ["9**9**9", "exponent"]),
        ('basis = ["x_dot", "%s"]' % ("sin(" * 3000 + "x" + ")" * 3000), ["15001 characters"]),
        ('basis = ["x_dot", "%s"]' % ("-" * 900 + "x"), ["nested deeper than"]),
        ('basis = ["u"]', ["contains a state"]),
        ("terms = []", ["contains a state"]),
        ('terms = ["x"]\ncoupled = true\nfunctions = {"f(a, a)" = "a"}', ["'f' has two parameters of one name"]),
        ('basis = ["x"]\nrules = [{kind = "maximum_degree", of = ["q"], degree = 1}]', ["'q'", "x_dot"]),
        ('basis = ["drag(x)"]\nfunctions = {"drag v" = "v"}', ["[library.functions]", "'drag v' came"]),
        ('basis = ["drag(x)"]\nfunctions = {"drag(v)" = "w"}', ["'w'", "there are: v"]),
        ('basis = ["drag(x)"]\nfunctions = {"sin(v)" = "v"}', ["'sin'", "taken"]),
    ],
)
def test_a_library_that_cannot_be_read(table, parts):
    study = parse_study(PLAIN + "[library]\n" + table)
    with pytest.raises(InputError) as caught:
        study.candidates("x_ddot")
    assert all(part in str(caught.value) for part in parts)


def test_the_paper_preset_has_35_candidates_a_target():
    study = parse_study(PAPER)
    for target in ("x_ddot", "phi_ddot"):
        library = study.candidates(target)
        assert len(library) == 35
        other = {"x_ddot": "phi_ddot", "phi_ddot": "x_ddot"}[target]
        assert not any(other in term.names for term in library)


def test_a_basis_is_multiplied_out_and_linear_in_the_target():
    study = parse_study(
        PLAIN + '[library]\nbasis = ["x", "drag(x_dot)"]\ndegree = 2\nfunctions = {"drag(v)" = "v*abs(v)"}'
    )
    assert {t.text for t in study.candidates("x_ddot")} == {
        "1",
        "x",
        "x**2",
        "x_dot*abs(x_dot)",
        "x_dot**2*abs(x_dot)**2",
        "x*x_dot*abs(x_dot)",
        "x_ddot",
        "x*x_ddot",
        "x_ddot*x_dot*abs(x_dot)",
    }


def test_terms_are_taken_as_they_are_with_the_target_added_where_none_holds_it():
    study = parse_study(PLAIN + '[library]\nterms = ["x", "u*x_dot"]')
    assert [t.text for t in study.candidates("x_ddot")] == ["x", "u*x_dot", "x_ddot"]
    study = parse_study(PLAIN + '[library]\nterms = ["x", "x*x_ddot"]')
    assert [t.text for t in study.candidates("x_ddot")] == ["x", "x*x_ddot"]
