"""Logs of a few dozen samples, as of a first experiment, from which no filter tells the noise."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from odescope import Data, Measured, Study, identify


def identified(name, t, y):
    return identify(Study(data=Data(time="t"), coordinates={name: Measured(order=1)}), {"t": t, name: y})


@pytest.mark.parametrize("seed", range(4))
def test_noise_that_a_filter_let_pass_is_no_noise_of_the_process(seed):
    """A capacitor: of seed 0 the filter leaves two fifths of the noise, and the law seemed to miss the record."""
    t = np.linspace(0.0, 20.0, 41)
    y = np.round(9.0 * np.exp(-t / 4.7) + 0.05 * np.random.default_rng(seed).standard_normal(41), 2)
    result = identified("V", t, y)
    assert result.refinement.process is None
    assert result.refinement.space.segments.noise[0] == pytest.approx(0.05, rel=0.3)
    (rate,) = (q for q in result.coefficients if q.term == "V")
    assert abs(rate.coefficient + 1.0 / 4.7) < 3.0 * rate.std_error


@pytest.mark.parametrize("seed", range(4))
def test_a_root_is_told_from_61_samples(seed):
    """h' = -.02 sqrt(h), .5 m to .01 m: a fraction of three numbers is as near as the record lets it be."""
    t = np.linspace(0.0, 60.0, 61)
    y = np.round((np.sqrt(0.5) - 0.01 * t) ** 2 + 0.002 * np.random.default_rng(seed).standard_normal(61), 3)
    result = identified("h", t, y)
    (relation,) = result.model.relations
    assert [q.text for q in relation.terms] == ["h_dot", "sqrt(h)"]
    assert relation.terms[1].coefficient == pytest.approx(0.02, abs=3.0 * relation.terms[1].std_error)


@pytest.mark.parametrize("seed", range(4))
def test_an_epidemic_of_15_days_has_its_law(seed):
    """A boarding school in 1978, about: of degree 3 there are 20 candidates for S and as many for I."""
    t = np.arange(15.0)
    run = solve_ivp(
        lambda _, x: (-0.0022 * x[0] * x[1], 0.0022 * x[0] * x[1] - 0.44 * x[1]),
        (0.0, 14.0),
        (762.0, 1.0),
        t_eval=t,
        rtol=1e-9,
    ).y
    susceptible, infected = np.round(run + 4.0 * np.random.default_rng(seed).standard_normal(run.shape))
    study = Study(data=Data(time="t"), coordinates={"S": Measured(), "I": Measured()})
    result = identify(study, {"t": t, "S": susceptible, "I": infected})
    laws = [{q.text for q in relation.terms} for relation in result.model.relations]
    assert laws == [{"S_dot", "I*S"}, {"I_dot", "I", "I*S"}]
    assert any("15 samples cannot decide between all of the default library" in note for note in result.notes)


def test_hares_and_lynxes_of_21_years_have_a_law():
    """Pelts in thousands, 1900 to 1920 (Hudson Bay Company; Elton and Nicholson, J. Anim. Ecol. 11, 1942).

    Of the 21 samples filtering leaves 19, for which there are 20 candidates of degree 3.
    """
    hares = (30, 47.2, 70.2, 77.4, 36.3, 20.6, 18.1, 21.4, 22, 25.4, 27.1)
    hares += (40.3, 57, 76.6, 52.3, 19.5, 11.2, 7.6, 14.6, 16.2, 24.7)
    lynxes = (4, 6.1, 9.8, 35.2, 59.4, 41.7, 19, 13, 8.3, 9.1, 7.4, 8)
    lynxes += (12.3, 19.5, 45.7, 51.1, 29.7, 15.8, 9.7, 10.1, 8.6)
    study = Study(data=Data(time="year"), coordinates={"hare": Measured(), "lynx": Measured()})
    result = identify(study, {"year": np.arange(1900.0, 1921.0), "hare": np.array(hares), "lynx": np.array(lynxes)})
    prey, predator = ({q.text: q.coefficient for q in relation.terms} for relation in result.model.relations)
    assert set(prey) == {"hare_dot", "hare", "hare*lynx"}
    assert -prey["hare"] == pytest.approx(0.55, abs=0.1)
    assert prey["hare*lynx"] == pytest.approx(0.028, abs=0.005)
    assert {"lynx", "hare*lynx"} <= set(predator)
    assert any("21 samples cannot decide" in note for note in result.notes)


@pytest.mark.parametrize(
    ("rates", "angle", "start", "seconds", "samples", "law"),
    [
        (lambda _, x: [x[1], -4.0 * x[0] - 0.3 * x[1]], False, 1.0, 25.0, 1000, {"x", "x_dot"}),
        pytest.param(
            lambda _, x: [x[1], -9.0 * x[0] - 0.5 * x[1]],
            False,
            1.0,
            20.0,
            1000,
            {"x", "x_dot"},
            marks=pytest.mark.slow,
        ),
        (lambda _, x: [x[1], -9.81 * np.sin(x[0]) - 0.25 * x[1]], True, 0.7, 20.0, 2000, {"sin(x)", "x_dot"}),
    ],
    ids=["spring", "stiffer", "pendulum"],
)
def test_what_a_solver_errs_by_at_its_usual_tolerance_is_no_forcing(rates, angle, start, seconds, samples, law):
    """Its steps come at a rate of their own, and what they err by is smooth: sines of time follow it."""
    t = np.linspace(0.0, seconds, samples)
    x = solve_ivp(rates, (0.0, seconds), (start, 0.0), t_eval=t).y[0]
    study = Study(data=Data(time="t"), coordinates={"x": Measured(order=2, angle=angle)})
    result = identify(study, {"t": t, "x": x})
    (relation,) = result.model.relations
    assert {q.text for q in relation.terms} == {"x_ddot", *law}
