import numpy as np
import pytest

from odescope.errors import InputError, NoModelError
from odescope.library.candidates import Library
from odescope.library.parse import Scope
from odescope.recordings.coordinate import Coordinate, Input
from odescope.regression.problem import pose
from odescope.regression.rows import NoiseWeighted, PlainRows
from odescope.selection.score import residuals
from odescope.signals.estimate import Channel, Signals

NAMES = ("phi", "phi_dot", "phi_ddot", "u")
COORDINATES, INPUTS = (Coordinate("phi", 2, angle=True),), (Input("u"),)
SCOPE = Scope.of(NAMES)


def band(rng, count, period, cutoff):
    """A smooth random signal with nothing above the cutoff."""
    spectrum = np.fft.rfft(rng.standard_normal(2 * count))
    spectrum[np.fft.rfftfreq(2 * count, period) > cutoff] = 0.0
    wave = np.fft.irfft(spectrum, 2 * count)[:count]
    return wave / wave.std()


def signals_of(seed=0, lengths=(1500,), cutoff=5.0, noise=0.0, constant=None):
    """Signals in which phi_ddot (1 + .3 cos^2) = u - 2 sin(phi), whatever phi and phi_dot are."""
    rng, columns = np.random.default_rng(seed), []
    for n in lengths:
        phi, speed, u = (2.0 * band(rng, n, 0.02, 2.0) for _ in range(3))
        u = np.full(n, constant) if constant is not None else u
        target = (u - 2.0 * np.sin(phi)) / (1 + 0.3 * np.cos(phi) ** 2)
        columns.append(np.array([phi, speed, target + noise * rng.standard_normal(n), u]))
    channels = (Channel("phi", 0.1, cutoff),)
    return Signals(NAMES, tuple(columns), (0.0,) * len(columns), 0.02, channels, COORDINATES, INPUTS)


def library_of(*texts):
    return Library.of(texts, SCOPE)


TERMS = ("1", "u", "sin(phi)", "phi_dot**2*cos(phi)", "phi_ddot*cos(phi)**2", "phi_ddot", "sin(phi)*phi_dot")
DIRECT = {
    "1": lambda phi, v, a, u: np.ones_like(phi),
    "u": lambda phi, v, a, u: u,
    "sin(phi)": lambda phi, v, a, u: np.sin(phi),
    "phi_dot**2*cos(phi)": lambda phi, v, a, u: v**2 * np.cos(phi),
    "phi_ddot*cos(phi)**2": lambda phi, v, a, u: a * np.cos(phi) ** 2,
    "phi_ddot": lambda phi, v, a, u: a,
    "phi_dot*sin(phi)": lambda phi, v, a, u: np.sin(phi) * v,
}


@pytest.fixture(scope="module")
def signals():
    return signals_of(lengths=(1500, 700, 333))


@pytest.fixture(scope="module", params=[PlainRows(), NoiseWeighted()], ids=["samples", "cosines"])
def problem(request, signals):
    return pose(signals, "phi_ddot", 2, library_of(*TERMS), request.param)


def texts(terms):
    return [t.text for t in terms]


def test_values_are_the_candidates_on_the_samples(problem, signals):
    for k, block in enumerate(problem.blocks):
        columns = signals.columns[block.record][:, block.start : block.stop]
        for j, term in enumerate(problem.terms):
            np.testing.assert_allclose(problem.values[k][j], DIRECT[term.text](*columns), rtol=1e-13, atol=1e-14)
        np.testing.assert_array_equal(problem.measured(k), columns[2])
        candidates, multipliers = np.split(problem.evaluated(k), [len(problem.terms)])
        np.testing.assert_array_equal(candidates, problem.values[k])
        np.testing.assert_allclose(candidates[list(problem.own)], multipliers * problem.measured(k), rtol=1e-13)
    assert texts(problem.terms[j] for j in problem.own) == ["phi_ddot*cos(phi)**2", "phi_ddot"]
    assert problem.terms[problem.left].text == "phi_ddot"
    assert problem.samples == signals.samples


def gram(factor):
    r = factor.r * factor.scale
    return r.T @ r


def test_training_leaves_its_fold_out_and_nothing_else(problem):
    rows = [problem.row_map.rows(v) for v in problem.values]
    assert set(problem.training) == {b.fold for b in problem.blocks}
    assert len(problem.training) > 1
    everything = sum(r.T @ r for r in rows)
    np.testing.assert_allclose(gram(problem.factor), everything, atol=1e-9 * np.abs(everything).max())
    for fold, factor in problem.training.items():
        kept = [r for r, b in zip(rows, problem.blocks, strict=True) if b.fold != fold]
        assert factor.rows == sum(map(len, kept))
        np.testing.assert_allclose(gram(factor), sum(r.T @ r for r in kept), atol=1e-9 * np.abs(everything).max())


def test_the_residual_is_what_the_explicit_prediction_leaves(problem, signals):
    xi = np.zeros((2, len(problem.terms)))
    coefficients = {"phi_ddot": 1.0, "phi_ddot*cos(phi)**2": 0.3, "u": -0.7, "sin(phi)": 1.5, "1": 0.2}
    for j, term in enumerate(problem.terms):
        xi[0, j] = coefficients.get(term.text, 0.0)
    xi[1] = -3.0 * xi[0]  # the same relation, its denominator negative
    for k, block in enumerate(problem.blocks):
        phi, _, a, u = signals.columns[block.record][:, block.start : block.stop]
        expected = a - (0.7 * u - 1.5 * np.sin(phi) - 0.2) / (1 + 0.3 * np.cos(phi) ** 2)
        left, signs = residuals(problem, xi, problem.evaluated(k))
        np.testing.assert_allclose(left, [expected, expected], atol=1e-12)
        assert signs.tolist() == [1.0, -1.0]


def test_a_denominator_that_changes_sign_predicts_nothing(problem):
    xi = np.zeros((3, len(problem.terms)))
    square = texts(problem.terms).index("phi_ddot*cos(phi)**2")
    xi[0, [problem.left, square]] = 1.0, -2.0
    xi[1, square] = -2.0  # cos^2 touches zero between samples, but keeps its sign
    left, signs = residuals(problem, xi, problem.evaluated(0))
    assert signs.tolist() == [0.0, -1.0, 0.0]
    assert not left[[0, 2]].any()
    assert left[1].any()


def test_one_fold_trains_on_all_there_is():
    short = pose(signals_of(lengths=(150,)), "phi_ddot", 2, library_of(*TERMS), PlainRows())
    assert len(short.blocks) == 1
    assert short.training == short.folds


# dependent candidates


def test_a_square_of_the_sine_beside_that_of_the_cosine_is_named_and_left_out(signals):
    library = library_of("1", "cos(phi)**2", "sin(phi)", "sin(phi)**2", "u", "phi_ddot", "phi_ddot*cos(phi)**2")
    for choice in (PlainRows(), NoiseWeighted()):
        posed = pose(signals, "phi_ddot", 2, library, choice)
        ((term, others),) = posed.dependent
        assert term.text == "sin(phi)**2"
        assert texts(others) == ["1", "cos(phi)**2"]
        assert "sin(phi)**2" not in texts(posed.terms)
        assert len(posed.terms) == len(library) - 1 == posed.factor.width


def test_a_constant_input_is_named_and_left_out():
    library = library_of("1", "sin(phi)", "u", "u*sin(phi)", "u*cos(phi)", "phi_ddot")
    posed = pose(signals_of(constant=1.7), "phi_ddot", 2, library, NoiseWeighted())
    assert {t.text: texts(o) for t, o in posed.dependent} == {"u": ["1"], "u*sin(phi)": ["sin(phi)"]}
    assert texts(posed.terms) == ["1", "sin(phi)", "u*cos(phi)", "phi_ddot"]


def test_the_relation_itself_is_no_dependence_to_be_left_out():
    library = library_of(*TERMS)
    for choice in (PlainRows(), NoiseWeighted()):
        posed = pose(signals_of(noise=0.0), "phi_ddot", 2, library, choice)
        assert posed.dependent == ()
        support = [
            k for k, t in enumerate(posed.terms) if t.text in ("u", "sin(phi)", "phi_ddot", "phi_ddot*cos(phi)**2")
        ]
        xi = posed.factor.solve(support, posed.left)
        assert posed.factor.residual(xi) < 1e-12


def test_fewer_cosines_than_candidates_make_none_of_them_dependent():
    angles = ("1", "sin(phi)", "cos(phi)", "sin(phi)*cos(phi)", "cos(phi)**2")
    speeds = ("1", "phi_dot", "phi_dot**2", "u", "u**2", "u*phi_dot", "phi_ddot")
    library = Library.of(angles, SCOPE) * Library.of(speeds, SCOPE)
    signals = signals_of(lengths=(220,), cutoff=2.5)
    posed = pose(signals, "phi_ddot", 2, library, NoiseWeighted())
    assert posed.factor.rows < len(library) < signals.samples
    assert posed.dependent == ()
    assert len(posed.terms) == len(library)


def test_products_of_the_target_are_compared_by_what_multiplies_it(signals):
    library = library_of("u", "sin(phi)", "phi_ddot", "phi_ddot*cos(phi)**2", "phi_ddot*sin(phi)**2")
    for choice in (PlainRows(), NoiseWeighted()):
        ((term, others),) = pose(signals, "phi_ddot", 2, library, choice).dependent
        assert term.text == "phi_ddot*sin(phi)**2"
        assert texts(others) == ["phi_ddot", "phi_ddot*cos(phi)**2"]


# what cannot be posed


def test_a_candidate_that_vanishes_is_left_out(signals):
    still = signals_of(constant=0.0)
    posed = pose(still, "phi_ddot", 2, library_of("u", "u*phi_dot", "sin(phi)", "phi_ddot", "u*phi_ddot"), PlainRows())
    assert texts(posed.terms) == ["sin(phi)", "phi_ddot"]
    with pytest.raises(NoModelError, match="every candidate that holds phi_ddot vanishes") as raised:
        pose(still, "phi_ddot", 2, library_of("sin(phi)", "u*phi_ddot"), PlainRows())
    assert raised.value.stage == "library"


@pytest.mark.parametrize("text", ["log(phi)", "sqrt(phi_dot)", "exp(exp(10*phi))"])
def test_a_candidate_that_is_not_finite_is_named(signals, text):
    with pytest.raises(InputError, match="no finite value on") as raised:
        pose(signals, "phi_ddot", 2, library_of("phi", text, "phi_ddot"), PlainRows())
    assert f"the candidate {library_of(text).terms[0]} has" in str(raised.value)
    count = int(str(raised.value).split(" samples")[0].split()[-1])
    assert 0 < count < signals.samples


def test_a_candidate_too_large_to_square_is_named(signals):
    with pytest.raises(InputError, match=r"the candidate exp\(70.0\*phi_dot\) reaches \S+e\+\d+ on the data"):
        pose(signals, "phi_ddot", 2, library_of("phi", "exp(70*phi_dot)", "phi_ddot"), PlainRows())


def test_a_library_without_the_target_is_refused(signals):
    with pytest.raises(InputError, match="no candidate term of the library holds the target phi_ddot"):
        pose(signals, "phi_ddot", 2, library_of("phi", "u"), PlainRows())


def test_fewer_samples_than_candidates_are_refused():
    library = Library.of(("u", "phi_dot", "sin(phi)"), SCOPE).powers(6) + library_of("phi_ddot")
    with pytest.raises(InputError, match=rf"50 samples cannot decide between {len(library)} candidate terms"):
        pose(signals_of(lengths=(50,)), "phi_ddot", 2, library, PlainRows())


def test_a_target_in_two_factors_is_refused(signals):
    with pytest.raises(InputError, match=r"phi_ddot\*\*2 is not linear in the targets"):
        pose(signals, "phi_ddot", 2, library_of("phi", "phi_ddot", "phi_ddot**2"), PlainRows())
