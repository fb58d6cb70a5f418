"""Which potentials of a Lagrangian may imitate a function of a position."""

from types import SimpleNamespace

import pytest

from odescope.library.lagrangian import lagrangian
from odescope.pipeline.contender import _imitates
from odescope.study.options import Data, Measured, Study


@pytest.mark.parametrize(
    ("potential", "imitates"),
    [
        (("r", "r**2", "r**3", "r**4"), True),  # of gravity far out
        (("r", "r**2"), False),  # a weight on a spring
        (("r", "r**2", "cos(a)", "r*cos(a)"), False),  # which swings
        (("a**2", "r**2", "a**4"), False),
    ],
)
def test_several_powers_of_one_coordinate_may_be_a_function_of_it(potential, imitates):
    coordinates = {"r": Measured(order=2), "a": Measured(order=2, angle=True)}
    study = Study(data=Data(time="t"), coordinates=coordinates)
    rates = ["r_dot**2", "r**2*a_dot**2"]
    found = lagrangian(
        study.measured(), (), study.scope(), kinetic=rates, potential=potential, dissipation=(), forces={}
    )
    ending = SimpleNamespace(fit=SimpleNamespace(present=range(len(found))), space=SimpleNamespace(mechanisms=found))
    assert _imitates(SimpleNamespace(refinement=ending)) is imitates
