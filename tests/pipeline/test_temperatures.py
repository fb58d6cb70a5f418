"""Rates that go with a temperature, which is known by its unit, in a reactor whose reaction gives off heat."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from odescope.pipeline.identification import identify
from odescope.study.library_options import Candidates
from odescope.study.options import Data, Driven, Measured, Study

PERIOD, END, ENERGY, FACTOR, HEAT, NOISE = 0.02, 30.0, 8750.0, 7.2e10, 209.0, 0.01
COOLED = {"flow": (0.6, 1.6), "coolant": (280.0, 297.0), "cooling": 3.0}
IGNITES = {"flow": (0.8, 1.2), "coolant": (290.0, 303.0), "cooling": 2.09}


def stepped(rng, low, high, hold):
    levels = rng.uniform(low, high, int(END / hold) + 2)
    return lambda t: levels[(np.asarray(t) / hold).astype(int)]


def logged(seed, flow, coolant, cooling):
    """Return three recordings of c' = q (1 - c) - r and T' = q (350 - T) + 209 r + k (Tc - T), r = k0 exp(-E/T) c."""
    rng, t, logs = np.random.default_rng(seed), np.arange(0.0, END, PERIOD), []
    for _ in range(3):
        q, jacket = stepped(rng, *flow, 3.0), stepped(rng, *coolant, 2.0)

        def rate(now, x, q=q, jacket=jacket):
            r = FACTOR * np.exp(-ENERGY / x[1]) * x[0]
            return [q(now) * (1 - x[0]) - r, q(now) * (350 - x[1]) + HEAT * r + cooling * (jacket(now) - x[1])]

        x = solve_ivp(rate, (0.0, END), [0.5, 350.0], t_eval=t, rtol=1e-8, atol=1e-10, max_step=PERIOD).y
        c, temperature = (row + NOISE * row.std() * rng.standard_normal(len(t)) for row in x)
        logs.append({"t": t, "c": c, "T": temperature, "q": q(t), "Tc": jacket(t)})
    return logs


def study(**library):
    return Study(
        data=Data(time="t"),
        coordinates={"c": Measured(), "T": Measured(unit="K")},
        inputs={"q": Driven(), "Tc": Driven(unit="K")},
        library=Candidates(**library),
    )


def exact(model, name):
    """Say whether both balances are those of the reactor, its energy within four standard errors."""
    (energy,) = model.parameters
    held = [{t.product.text for t in r.terms[1:]} for r in model.relations]
    rate = [text for text in held[0] if "exp" in text]
    within = energy.name == name and abs(energy.value - ENERGY) < 4.0 * energy.std_error
    return within and held == [{"q", "c*q", *rate}, {"q", "T*q", "T", "Tc", *rate}] and len(rate) == 1


@pytest.mark.slow
@pytest.mark.parametrize(("seed", "how"), [(3, COOLED), *((seed, IGNITES) for seed in range(4))])
def test_the_rate_is_found_in_both_balances_where_no_library_names_it(seed, how):
    assert exact(identify(study(), logged(seed, **how)).model, "activation_T")


@pytest.mark.slow
@pytest.mark.parametrize(("seed", "how"), [(0, COOLED), (1, COOLED), (2, COOLED), (1, IGNITES)])
def test_a_rate_that_the_library_names_is_found_in_both_balances(seed, how):
    library = {"basis": ("c", "T", "q", "Tc", "exp(-E/T)"), "degree": 2, "parameters": {"E": (1e3, 2e4)}}
    assert exact(identify(study(**library), logged(seed, **how)).model, "E")


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(3))
def test_a_reactor_that_ignites_under_a_steady_flow_has_its_law(seed):
    """Its temperature rises by a hundred kelvins within a few samples: no products, and nothing in a large library."""
    coordinates, inputs = {"c": Measured(), "T": Measured(unit="K")}, {"Tc": Driven(unit="K")}
    logs = [{n: v for n, v in log.items() if n != "q"} for log in logged(seed, **IGNITES | {"flow": (1.0, 1.0)})]
    model = identify(Study(data=Data(time="t"), coordinates=coordinates, inputs=inputs), logs).model
    held = [{t.product.text for t in r.terms[1:]} for r in model.relations]
    (rate,) = (text for text in held[0] if "exp" in text)
    assert held == [{"1", "c", rate}, {"1", "T", "Tc", rate}]
    assert abs(model.parameters[0].value - ENERGY) < 4.0 * model.parameters[0].std_error


def stepped_bath(seed, rates, start):
    """Return two recordings of a and b in a bath whose temperature is stepped, by `rates` (a, b, T)."""
    rng, t, logs = np.random.default_rng(seed), np.arange(0.0, END, PERIOD), []
    for _ in range(2):
        bath = stepped(rng, 300.0, 345.0, 4.0)
        x = solve_ivp(
            lambda now, x, bath=bath: rates(*x, bath(now)),
            (0.0, END),
            rng.uniform(*start),
            t_eval=t,
            rtol=1e-9,
            atol=1e-11,
            max_step=PERIOD,
        ).y
        a, b = (row + 0.5 * NOISE * row.std() * rng.standard_normal(len(t)) for row in x)
        logs.append({"t": t, "a": a, "b": b, "T": bath(t)})
    return logs


def in_a_row(a, b, temperature):
    first, second = 2e6 * np.exp(-5000.0 / temperature) * a, 5e9 * np.exp(-7800.0 / temperature) * b
    return [-first, first - second]


def there_and_back(a, b, temperature):
    there, back = 2e6 * np.exp(-5000.0 / temperature) * a, 3e10 * np.exp(-8500.0 / temperature) * b
    return [back - there, there - back]


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, 1, 2])
@pytest.mark.parametrize(
    ("rates", "start", "energies", "terms"),
    [
        (in_a_row, ([1.0, 0.0], [3.0, 0.5]), (5000.0, 7800.0), [1, 2]),
        (there_and_back, ([1.0, 0.0], [3.0, 1.5]), (5000.0, 8500.0), [2, 2]),
    ],
    ids=["in a row", "there and back"],
)
def test_two_reactions_have_energies_of_their_own(rates, start, energies, terms, seed):
    kelvins = Study(data=Data(time="t"), coordinates={"a": Measured(), "b": Measured()}, inputs={"T": Driven(unit="K")})
    model = identify(kelvins, stepped_bath(seed, rates, start)).model
    found = sorted(model.parameters, key=lambda p: p.value)
    assert [len(r.terms) - 1 for r in model.relations] == terms
    assert all(abs(p.value - e) < 4.0 * p.std_error for p, e in zip(found, energies, strict=True))
    assert all("exp" in t.text for r in model.relations for t in r.terms[1:])
