"""What is said of candidates that these data cannot tell from others."""

from odescope.model.left_out_notes import NAMED, TOLD, left_out_sentences


def said(*dependent):
    return list(left_out_sentences(dependent))


def test_each_is_named_once_and_not_without_end():
    dependent = [(f"x**{k}", ("1", "x")) for k in range(TOLD + 3)]
    notes = said(*dependent * 2)
    assert notes[0] == "these data cannot tell x**0 from a combination of 1, x"
    assert len(notes) == TOLD + 1
    assert notes[-1] == "and 3 more candidates that are combinations of others: see the report"


def test_what_is_constant_or_in_proportion_is_said_so():
    assert said(("sign(v)", ("1",))) == ["sign(v) is constant in these data"]
    assert said(("v*abs(v)", ["v**2"])) == ["these data cannot tell v*abs(v) from v**2: they are in proportion"]


def test_of_a_long_combination_the_first_terms_are_named():
    terms = [f"x**{k}" for k in range(NAMED + 2)]
    (whole,), (cut,) = said(("y", terms[:NAMED])), said(("y", terms))
    assert whole == f"these data cannot tell y from a combination of {', '.join(terms[:NAMED])}"
    assert cut == f"{whole} and 2 more"
