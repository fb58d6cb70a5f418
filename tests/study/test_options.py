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


@pytest.mark.parametrize("key", ['time_unit = "ms"', 'date = "day"'])
def test_what_belongs_to_a_column_of_time_is_refused_without_one(key):
    with pytest.raises(
        InputError, match=rf"^\[data\] {key.split()[0]} = '.*' goes with time, .* sample_period is in seconds"
    ):
        parse_study(f"[data]\nsample_period = 10\n{key}\n[coordinates.x]\n")
    parse_study(f'[data]\ntime = "t"\n{key}\n[coordinates.x]\n')


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


@pytest.mark.parametrize(
    ("table", "parts"),
    [
        ('preset = "paper"\ndegree = 2', ["degree", "paper's preset"]),
        ('terms = ["x"]\ndegree = 2', ["degree", "terms"]),
        ("molecules = 3", ["molecules = 3", "composition ="]),
        ('reactions = ["x ->"]\nmolecules = 3', ["molecules = 3"]),
        ('saturating = ["x"]', ["saturating", "S/(K + S)"]),
    ],
)
def test_what_would_change_nothing_in_a_library_is_refused_with_what_to_write(table, parts):
    with pytest.raises(InputError) as caught:
        parse_study(PLAIN + "[library]\n" + table)
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


ENERGIES = PAPER.replace('preset = "paper"', "%s")


@pytest.mark.parametrize(
    ("table", "form", "parts"),
    [
        ('kinetic = ["x_dot**2"]', "lagrangian", ["no kinetic term gives the equation of phi an acceleration"]),
        ("kinetic = [\"__import__('os')\"]", "lagrangian", ["__import__", "only names"]),
        ('potential = ["x**2"]', "lagrangian", ["declared cyclic"]),
        ('potential = ["psi"]', "lagrangian", ["'psi'"]),
        ('forces = {psi = ["u"]}', "lagrangian", ["no coordinate 'psi'"]),
        ('form = "lagrangian"\nties = ["w = 2"]', "lagrangian", ["'w'"]),
        ('reactions = ["x -> phi"]', "reactions", ["order"]),
    ],
)
def test_mechanisms_that_cannot_be(table, form, parts):
    study = parse_study(ENERGIES % table)
    assert study.forms() == (form,)
    with pytest.raises(InputError) as caught:
        study.mechanisms(form)
    assert all(part in str(caught.value) for part in parts)


def test_mechanisms_are_those_that_are_named_and_the_defaults_of_the_others():
    study = parse_study(ENERGIES % 'kinetic = ["x_dot**2", "phi_dot**2"]\ndissipation = []\nforces = {x = ["u"]}')
    found, left_out = study.mechanisms("lagrangian")
    assert [m.term for m in found if m.kind == "kinetic"] == ["x_dot**2", "phi_dot**2"]
    assert [(m.term, m.place) for m in found if m.kind == "force"] == [("u", "force on x")]
    assert not [m for m in found if m.kind == "dissipation"]
    assert {"cos(phi)", "sin(phi)"} <= {m.term for m in found if m.kind == "potential"}
    assert not left_out


def test_what_no_data_could_tell_apart_is_left_out_with_what_it_is_a_combination_of():
    study = parse_study(ENERGIES % 'potential = ["cos(phi)", "cos(phi)**2", "sin(phi)**2"]')
    found, left_out = study.mechanisms("lagrangian")
    assert [(m.term, [o.term for o in others]) for m, others in left_out] == [("sin(phi)**2", ["cos(phi)**2"])]
    assert "sin(phi)**2" not in {m.term for m in found}


def test_ties_merge_mechanisms():
    named = 'reactions = ["a -> b", "b -> a"]\n'
    text = "[coordinates.a]\n[coordinates.b]\n[library]\n" + named
    free, _ = parse_study(text).mechanisms("reactions")
    tied, _ = parse_study(text + "ties = [\"'a -> b' = 2*'b -> a'\"]").mechanisms("reactions")
    assert len(tied) == len(free) - 1
    (merged,) = (m for m in tied if m.kind == "tie")
    assert {(p.relation, p.product.text): p.share for p in merged.parts} == {
        (0, "a"): 2.0, (0, "b"): -1.0, (1, "a"): -2.0, (1, "b"): 1.0,
    }  # fmt: skip
