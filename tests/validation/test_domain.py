"""What is said where data leave the domain of a model."""

from dataclasses import replace

import numpy as np
import pytest
from test_validate import TRUE

from odescope.validation.domain import outside_domain


@pytest.mark.parametrize(
    ("origin", "ends"),
    [
        (0.0, ("5", "35.5", "0", "30")),
        (1.7e9, ("1700000005", "1700000035.5", "1700000000", "1700000030")),
    ],
)
def test_numbers_are_told_by_as_many_digits_as_show_that_they_differ(origin, ends):
    model = replace(TRUE, domain={"u": (origin, origin + 30.0)})
    (told,) = outside_domain(model, {"u": [origin + np.linspace(5.0, 35.5, 1000)]})
    assert told.startswith(f"u is from {ends[0]} to {ends[1]}, and 16 % of it")
    assert told.endswith(f"{ends[2]} to {ends[3]}")


def test_data_within_the_domain_and_what_noise_adds_are_not_told():
    model = replace(TRUE, domain={"u": (-1.0, 1.0)})
    assert list(outside_domain(model, {"u": [np.linspace(-1.03, 1.03, 500)]})) == []


@pytest.mark.parametrize(("share", "told"), [(1.0, "all of it"), (0.9995, "99 % of it"), (0.256, "26 % of it")])
def test_how_much_is_outside_is_told_without_powers_of_ten(share, told):
    model = replace(TRUE, domain={"u": (-1.0, 1.0)})
    samples = np.where(np.arange(2000) < 2000 * share, 5.0, 0.0)
    assert f", and {told} outside the data" in next(outside_domain(model, {"u": [samples]}))


def test_what_never_came_to_be_known_is_not_judged():
    model = replace(TRUE, domain={"u": (-1.0, 1.0)})
    assert list(outside_domain(model, {"u": [np.zeros(0)]})) == []
