import numpy as np
import pytest

from odescope import Candidates, Data, Driven, Measured, Study, identify
from odescope.commands.demo import NOISE, simulate_log

TRUTH = {
    ("kinetic", "x_dot**2"): 0.9,
    ("kinetic", "phi_dot*x_dot*cos(phi)"): 0.18,
    ("kinetic", "phi_dot**2"): 0.02754,
    ("potential", "cos(phi)"): -1.766,
    ("dissipation", "x_dot**2"): 5.0,
    ("dissipation", "phi_dot**2"): 0.075,
    ("force", "u"): 1.0,
}


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, 8])  # with false turns and without
def test_mechanisms_are_found_where_the_start_is_lost_in_segments_of_usual_length(monkeypatch, seed):
    monkeypatch.setitem(NOISE, 5, (1.0, 0.5))
    log = simulate_log(seed, 5, 0.15)
    study = Study(
        data=Data(time="t"),
        coordinates={"x": Measured(order=2, cyclic=True), "phi": Measured(order=2, angle=True)},
        inputs={"u": Driven()},
        library=Candidates(form="lagrangian"),
    )
    found = identify(study, {"t": log.t, "x": log.measured[:, 0], "phi": log.measured[:, 1], "u": log.force})
    coefficients = {(m.kind, m.term): m.coefficient for m in found.model.mechanisms}
    assert coefficients.keys() == TRUTH.keys()
    assert np.allclose([coefficients[k] / c for k, c in TRUTH.items()], 1.0, atol=0.1)
