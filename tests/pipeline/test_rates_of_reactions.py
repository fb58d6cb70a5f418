"""Rates of reactions that go with a function of what an experiment is run at, from few uneven samples of each."""

import numpy as np
import pytest

from odescope.pipeline.identification import identify
from odescope.study.options import Data, Driven, Measured, Study

NOISE = 0.02
T = np.concatenate([[0.0], np.geomspace(0.2, 20.0, 24)])


def decays(rate, levels, seed, name="u"):
    """Return logs of M' = -rate(u) M at levels u that are constant in each, by its solution."""
    rng, logs = np.random.default_rng(seed), []
    for k, u in enumerate(levels):
        m = (1.0 + 0.5 * k) * np.exp(-rate(u) * T)
        logs.append({"t": T, "M": m * (1.0 + NOISE * rng.standard_normal(len(T))), name: np.full(len(T), u)})
    return logs


def identified(logs, unit=None, name="u"):
    inputs = {name: Driven(hold="zero", unit=unit)}
    return identify(Study(data=Data(time="t"), coordinates={"M": Measured(unit="mol/L")}, inputs=inputs), logs).model


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, 1])
def test_a_root_of_the_initiator_is_found_where_a_fraction_of_it_imitates_it(seed):
    """The monomer of a radical polymerisation: the root stands before the monomer, as the fraction did."""
    model = identified(decays(lambda u: 0.4 * np.sqrt(u), [0.02, 0.1, 0.3, 0.05], seed))
    (term,) = (t for t in model.relations[0].terms if t.text != "M_dot")
    assert term.text == "M*sqrt(u)"
    assert abs(term.coefficient - 0.4) < 4.0 * term.std_error


@pytest.mark.parametrize(
    ("name", "unit", "zero"),
    [("u", "°C", 273.15), ("T_bath", None, 0.0), pytest.param("u", "K", 0.0, marks=pytest.mark.slow)],
)
def test_a_rate_that_goes_with_temperature_goes_by_arrhenius(name, unit, zero):
    """A temperature is known by its unit, or is called one and stays where kelvins do."""

    def rate(u):
        return 0.2 * np.exp(6000.0 * (1.0 / 330.0 - 1.0 / (u + zero)))

    model = identified(decays(rate, np.array([313.0, 323.0, 333.0, 343.0, 328.0]) - zero, 0, name), unit, name)
    (energy,) = model.parameters
    assert energy.name == f"activation_{name}"
    assert abs(energy.value - 6000.0) < 4.0 * energy.std_error
    assert energy.std_error < 200.0
    assert [t.text for t in model.relations[0].terms if t.text == "M_dot"] == ["M_dot"]
    assert len(model.relations[0].terms) == 2
