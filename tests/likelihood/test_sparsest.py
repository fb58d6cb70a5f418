"""The fewest terms and functions that say what a relation says."""

import numpy as np

from odescope.library.expression import ONE
from odescope.library.families import families_of
from odescope.library.pairs import pair_families
from odescope.likelihood.imitation import Choice, Imitated, Samples, choices_of
from odescope.likelihood.sparsest import beside, grown, sparse

T = np.linspace(0.0, 12.0, 300)
VALUES = {"x": 1.0 + 0.6 * np.sin(T), "y": 0.8 * np.cos(0.7 * T + 0.4), "z": np.sin(1.9 * T) + 0.3 * np.cos(T)}
BASE = np.array([np.ones_like(T), *VALUES.values()])
BASES = ([0], [0, 1], range(4))
UNKNOWN = 1e-8


def ends(said, terms=8):
    single = choices_of(families_of("x", VALUES["x"], ()), (ONE,))
    pairs = [Choice((f.term,), f.constants, f.points) for f in pair_families(VALUES, ())]
    noise = np.sqrt(UNKNOWN * np.mean(said**2)) * np.random.default_rng(0).standard_normal(len(said))
    return sparse(Imitated(said + noise, BASE, Samples(VALUES)), [single, pairs], BASES, (UNKNOWN, terms))


def test_a_step_of_a_weighted_sum_is_found_with_the_terms_beside_it():
    best = ends(0.3 - 1.4 * VALUES["x"] + 2.0 / (1.0 + np.exp(0.7 - 1.1 * VALUES["y"] - 0.6 * VALUES["z"])))[0]
    assert best.kept == (0, 1)
    single, pair = best.placed
    assert single.choice.terms == ()
    assert set(pair.values) == {"weight_y_y_z", "weight_z_y_z", "offset_y_z"}
    assert abs(pair.values["weight_y_y_z"] - 1.1) < 0.02
    assert abs(pair.values["weight_z_y_z"] - 0.6) < 0.02


def test_a_function_of_one_variable_is_found_beside_one_of_two():
    best = ends(-1.3 * np.sqrt(VALUES["x"]) + 0.4 * np.sin(VALUES["x"] - VALUES["y"]))[0]
    assert best.kept == ()
    assert [c.choice.terms[0].text for c in best.placed] == ["sqrt(x)", "sin(x - y)"]


def test_what_says_the_same_in_other_words_is_found_however_little_is_known():
    """Of a model that follows its record; what its rates are known to hides no more than which imitation is near."""
    amounts = {"x": VALUES["x"], "w": 1.2 + np.cos(0.7 * T + 0.4)}
    said = 0.4 - 0.1 * amounts["x"] - 2.0 * amounts["x"] / (1.0 + 1.2 * amounts["x"] + 1.7 * amounts["w"])
    base = np.array([np.ones_like(T), *amounts.values()])
    single = [choices_of(families_of(name, amounts[name], ()), (ONE,)) for name in amounts]
    pairs = [Choice((f.term,), f.constants, f.points) for f in pair_families(amounts, ())]
    found = sparse(Imitated(said, base, Samples(amounts)), [*single, pairs], ([0], [0, 1], range(3)), (5e-3, 9))
    exact = [one for one in found if one.missed < 5e-3 + 1e-8]
    assert {one.placed[-1].choice.terms[0].text for one in exact} == {"x*(1.0 + below_w*w + below_x*x)**-1"}
    assert all(one.kept == (0, 1) for one in exact)


def test_nothing_is_begun_that_would_be_dearer_than_the_terms_there_are():
    assert ends(VALUES["x"] - 0.5 * VALUES["x"] ** 2, terms=1) == []


def products():
    """Return columns of products to degree 2, and their names."""
    names = ["1", *VALUES, *(f"{a}*{b}" for k, a in enumerate(VALUES) for b in list(VALUES)[k:])]
    values = {"1": np.ones_like(T), **VALUES}
    return names, np.array([np.prod([values[n] for n in name.split("*")], axis=0) for name in names])


def test_a_function_is_recognised_beside_products_that_alone_say_little():
    names, base = products()
    said = 0.8 * VALUES["z"] * (VALUES["y"] - 0.9) - 1.3 * np.exp(VALUES["x"] / 0.5)
    single = choices_of(families_of("x", VALUES["x"], ()), (ONE,))
    best = grown(Imitated(said, base, Samples(VALUES)), [single], (UNKNOWN, 8))[0]
    assert [names[k] for k in best.kept] == ["z", "y*z"]
    assert [t.text for t in best.placed[0].choice.terms] == ["exp(rise_x**-1*x)"]
    assert abs(best.placed[0].values["rise_x"] - 0.5) < 1e-3


def test_what_stands_beside_a_given_row_is_the_fewest_products():
    names, base = products()
    rate = np.sqrt(VALUES["x"])
    said = -1.1 * rate + 0.4 * VALUES["z"] - 0.7 * VALUES["x"] * VALUES["z"]
    kept = beside(Imitated(said, np.vstack([rate, base]), Samples(VALUES)), [0], UNKNOWN)
    assert sorted(["rate", *names][k] for k in kept) == ["rate", "x*z", "z"]
