"""Forces that nobody recorded and that move states by hardly more than these are read off by: noise, and no terms."""

import numpy as np
import pytest
from scipy.linalg import expm
from scipy.signal import butter, lfilter

from odescope.pipeline.identification import identify
from odescope.study.options import Data, Driven, Measured, Study

LAW = {"x": 25.0, "x_dot": 0.8, "u": -1.0}
STEP, PUSH, NOISE = 0.01, 10.0, 0.002


def log(seed, samples, share):
    """A mass on a spring, pushed by u and by white kicks: averaged over a tenth of a second a share of u."""
    rng = np.random.default_rng(seed)
    u = lfilter(*butter(2, 6.0 * STEP), rng.standard_normal(samples))
    u *= PUSH / u.std()
    whole = np.zeros((4, 4))
    whole[0, 1], whole[1, :3], whole[2, 3] = 1.0, [-LAW["x"], -LAW["x_dot"], 1.0], 1.0
    step = expm(whole * STEP)[:2]
    kicks = share * PUSH * np.sqrt(0.1 * STEP) * rng.standard_normal(samples)
    states, x = [], np.zeros(2)
    for now, then, kick in zip(u, np.append(u[1:], u[-1]), kicks, strict=True):
        states.append(x[0])
        x = step @ [*x, now, (then - now) / STEP] + [0.0, kick]
    return {"t": STEP * np.arange(samples), "x": states + NOISE * rng.standard_normal(samples), "u": u}


def found(seed, samples, share):
    """Return what was found, and how far off its coefficients are, in standard errors."""
    study = Study(data=Data(time="t"), coordinates={"x": Measured(order=2)}, inputs={"u": Driven(hold="linear")})
    result = identify(study, log(seed, samples, share))
    terms = {t.text: t for t in result.model.relations[0].terms if not t.product.bare}
    assert set(terms) == set(LAW)
    return result.refinement, [(terms[k].coefficient - c) / terms[k].std_error for k, c in LAW.items()]


@pytest.mark.parametrize("seed", [7, *(pytest.param(k, marks=pytest.mark.slow) for k in (0, 1, 2, 3, 4, 5, 6, 8, 9))])
def test_a_short_record_under_a_hundredth_of_its_force_has_no_terms_for_it(seed):
    """Ten terms or so follow it, each worth its price, and what they leave is white."""
    refinement, off = found(seed, 900, 0.01)
    assert refinement.process is not None
    assert np.abs(off).max() < 3.5


@pytest.mark.slow
@pytest.mark.parametrize("share", [0.005, 0.02])
def test_errors_of_a_long_record_hold_however_small_the_noise_is(share):
    off = np.array([found(seed, 4000, share)[1] for seed in range(8)])
    assert np.sqrt(np.mean(off**2)) < 1.3


@pytest.mark.parametrize("samples", [900, pytest.param(4000, marks=pytest.mark.slow)])
def test_without_any_none_is_found(samples):
    for seed in range(3):
        assert found(seed, samples, 0.0)[0].process is None
