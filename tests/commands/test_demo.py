import numpy as np
import pytest

from odescope.commands.demo import (
    FORCE_RMS,
    NOISE,
    PAPER_TABLE,
    START,
    cart_pendulum,
    run_demo,
    simulate_log,
    table_two,
    write_demo,
)
from odescope.errors import InputError, Stopped
from odescope.events import Monitor
from odescope.library.tape import evaluate, write_tape
from odescope.model.model import Model
from odescope.model.relation import Relation, RelationTerm
from odescope.recordings.readers import read_records
from odescope.study.toml import read_study, study_toml

M1, MC, A1, BC, G = 1.0, 0.8, 0.18, 10.0, 9.81
I1 = 0.7 * M1 * A1**2

# The truth of the paper's Table 2, normalised to a denominator 1 + q cos^2(phi).
TABLE = {
    "x_ddot": {
        "u": 0.55556,
        "x_dot": -5.5556,
        "phi_dot**2*sin(phi)": 0.1,
        "phi_dot*cos(phi)": 0.01816,
        "cos(phi)*sin(phi)": 3.2059,
        "x_ddot*cos(phi)**2": -0.3268,
    },
    "phi_ddot": {
        "u*cos(phi)": -1.8155,
        "x_dot*cos(phi)": 18.155,
        "phi_dot**2*cos(phi)*sin(phi)": -0.3268,
        "phi_dot": -0.18155,
        "sin(phi)": -32.059,
        "phi_ddot*cos(phi)**2": -0.3268,
    },
}


@pytest.fixture(scope="module")
def log():
    return simulate_log(3, 1)


def lagrange(columns, joint_friction):
    """The accelerations that solve the raw equations of motion, at columns x, phi, x_dot, phi_dot, u."""
    _, phi, speed, spin, u = columns
    matrix = np.array([[0 * phi + MC + M1, M1 * A1 * np.cos(phi)], [M1 * A1 * np.cos(phi), 0 * phi + I1 + M1 * A1**2]])
    right = np.array(
        [
            u - BC * speed + M1 * A1 * np.sin(phi) * spin**2,
            -joint_friction * spin - M1 * G * A1 * np.sin(phi),
        ]
    )
    return np.linalg.solve(np.moveaxis(matrix, -1, 0), right.T[..., None])[..., 0].T


@pytest.mark.parametrize("joint_friction", [0.01, 0.15, 0.0])
def test_the_reference_model_solves_the_equations_of_lagrange(joint_friction):
    rng = np.random.default_rng(0)
    columns = rng.uniform(-1, 1, (5, 300)) * np.array([[2.0], [10.0], [4.0], [15.0], [60.0]])
    model = cart_pendulum(joint_friction)
    assert model.variables == ("x", "phi", "x_dot", "phi_dot", "u")
    values = [evaluate(write_tape(model.variables, [q.numerator, q.denominator]), columns) for q in model.quotients]
    for (top, bottom), expected in zip(values, lagrange(columns, joint_friction), strict=True):
        np.testing.assert_allclose(top / bottom, expected, rtol=1e-11, atol=1e-10)


def test_the_reference_model_has_the_coefficients_of_table_2():
    rows = table_two(cart_pendulum(), cart_pendulum())
    assert {(r.target, r.term) for r in rows} == {(t, term) for t, terms in TABLE.items() for term in terms}
    for row in rows:
        assert row.truth == row.found == pytest.approx(TABLE[row.target][row.term], rel=3e-4)


def test_the_paper_lost_the_joint_friction_and_is_a_few_per_cent_off():
    for row in table_two(cart_pendulum(), cart_pendulum()):
        if row.term in ("phi_dot*cos(phi)", "phi_dot"):
            assert row.paper is None
        else:
            assert row.paper == pytest.approx(row.truth, rel=0.045)
    assert {t: len(terms) for t, terms in PAPER_TABLE.items()} == {"x_ddot": 5, "phi_ddot": 5}


def test_a_table_shows_what_is_missing_and_what_is_too_much():
    truth = cart_pendulum()
    cart, pendulum = truth.relations
    lost = Relation(tuple(t for t in cart.terms if t.text != "phi_dot*cos(phi)"))
    extra = Relation((*pendulum.terms, RelationTerm(next(t.product for t in cart.terms if t.text == "u"), 0.25)))
    rows = {(r.target, r.term): r for r in table_two(truth, Model(truth.coordinates, truth.inputs, (lost, extra)))}
    assert rows["x_ddot", "phi_dot*cos(phi)"].found is None
    assert rows["x_ddot", "phi_dot*cos(phi)"].truth == pytest.approx(0.01816, rel=1e-3)
    assert rows["phi_ddot", "u"].truth is None
    assert rows["phi_ddot", "u"].found == -0.25  # a relation's term changes sides in the explicit form


# the log


def test_the_force_is_band_limited_and_has_its_size(log):
    assert np.sqrt(np.mean(log.force**2)) == pytest.approx(FORCE_RMS, rel=1e-12) == pytest.approx(20.0)
    power = np.abs(np.fft.rfft(log.force)) ** 2
    frequency = np.fft.rfftfreq(len(log.force), 0.001)
    assert power[frequency > 3.0].max() < 1e-20 * power.max()
    band = power[frequency <= 3.0]
    low, high = band[: len(band) // 2].sum(), band[len(band) // 2 :].sum()
    assert 0.6 < low / high < 1.6  # white below


def test_the_log_is_65_seconds_at_a_kilohertz_from_the_papers_start(log):
    np.testing.assert_allclose(log.t, np.arange(65_001) / 1000.0, atol=1e-9)
    np.testing.assert_array_equal(log.states[0], START)
    assert START[1] == pytest.approx(30 * np.pi / 32)


def test_the_states_obey_the_equations_of_motion(log):
    middle = slice(1, -1)
    accelerations = lagrange(np.vstack([log.states.T, log.force])[:, middle], 0.01)
    for k in (0, 1):
        position, speed = log.states[:, k], log.states[:, k + 2]
        slope = (position[2:] - position[:-2]) / 0.002
        assert np.abs(slope - speed[middle]).max() < 1e-4 * np.abs(speed).max()
        change = (speed[2:] - speed[:-2]) / 0.002
        assert np.abs(change - accelerations[k]).max() < 1e-3 * np.abs(accelerations[k]).max()


@pytest.mark.parametrize(("level", "size"), [(1, (0.0005, 0.0025)), (2, (0.005, 0.0025)), (3, (0.05, 0.025))])
def test_the_noise_is_white_and_of_its_level(level, size):
    assert NOISE[level] == size
    log = simulate_log(1, level)
    noise = log.measured - log.states[:, :2]
    np.testing.assert_allclose(noise.std(axis=0), size, rtol=0.02)
    assert np.abs(noise.mean(axis=0) / size).max() < 0.02
    white = [np.mean(n[1:] * n[:-1]) / n.var() for n in noise.T]
    assert np.abs([*white, np.corrcoef(noise.T)[0, 1]]).max() < 0.02


def test_a_seed_fixes_the_log_and_another_gives_another(log):
    again, other = simulate_log(3, 1), simulate_log(4, 1)
    np.testing.assert_array_equal(again.measured, log.measured)
    assert np.abs(np.corrcoef(other.force, log.force)[0, 1]) < 0.3


def test_a_level_changes_the_noise_alone(log):
    louder = simulate_log(3, 2)
    np.testing.assert_array_equal(louder.states, log.states)
    cart, angle = (louder.measured - louder.states[:, :2]).T
    quiet_cart, quiet_angle = (log.measured - log.states[:, :2]).T
    np.testing.assert_allclose(cart, 10 * quiet_cart, atol=1e-12)
    np.testing.assert_allclose(angle, quiet_angle, atol=1e-12)


def test_the_written_files_are_the_log_to_the_last_digit(log, tmp_path):
    path = write_demo(tmp_path, 3, 1, 0.01)
    study = read_study(path)
    (record,) = read_records([tmp_path / f for f in study.data.files], study.layout())
    np.testing.assert_array_equal(record.column("u"), log.force)
    np.testing.assert_array_equal(record.column("x"), log.measured[:, 0])
    np.testing.assert_array_equal(record.column("phi"), log.measured[:, 1])
    assert study.random.seed == 3
    # The library is the paper's: 35 candidates a target.
    assert [len(study.candidates(c.target)) for c in study.measured()] == [35, 35]
    assert "preset" in study_toml(study)


def test_a_demo_leaves_the_logs_of_others_alone_and_goes_on_in_its_own_folder(tmp_path):
    def demo(folder, **how):
        return run_demo(folder, 0, 1, 0.01, Monitor(**how))

    mine = tmp_path / "log.csv"
    mine.write_text("mine")
    with pytest.raises(InputError, match=r"holds log\.csv and no results of odescope"):
        demo(tmp_path)
    assert [(p.name, p.read_text()) for p in tmp_path.iterdir()] == [("log.csv", "mine")]
    write_demo(tmp_path, 1, 1, 0.01)  # a demo that was stopped
    with pytest.raises(Stopped):
        demo(tmp_path, stop=lambda: True)
    assert "seed = 0" in (tmp_path / "demo.toml").read_text()
