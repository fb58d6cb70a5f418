"""Libraries that are tried beside the default one keep to what a study says of its coordinates."""

from odescope.events import Monitor
from odescope.parallel.workers import Threads
from odescope.pipeline.wider import basis_of, with_basis
from odescope.pipeline.work import Work
from odescope.study.options import Data, Driven, Measured, Study

STUDY = Study(
    data=Data(time="t"),
    coordinates={
        "x": Measured(order=2, cyclic=True),
        "phi": Measured(order=2, angle=True),
        "th": Measured(order=2),
    },
    inputs={"u": Driven(), "t": Driven()},
)


def test_neither_a_cyclic_coordinate_nor_an_angle_itself_nor_the_time_enters():
    basis = basis_of(STUDY, ["th"])
    assert set(basis) == {"x_dot", "phi_dot", "th", "th_dot", "u", "sin(phi)", "cos(phi)", "sin(th)", "cos(th)"}
    study = with_basis(Work(STUDY, Monitor(), Threads(1)), basis, 2).study
    factors = {str(factor.text) for term in study.candidates("phi_ddot") for factor, _ in term.factors}
    assert "th" in factors
    assert not {"x", "phi", "t"} & factors
