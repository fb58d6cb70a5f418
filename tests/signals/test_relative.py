import numpy as np
import pytest

from odescope.recordings.coordinate import Coordinate
from odescope.recordings.record import Record, Records
from odescope.signals.differentiators import Spectral
from odescope.signals.estimate import estimate_signals
from odescope.signals.outliers import gate_outliers
from odescope.signals.relative import relative_noise

T = 0.05 * np.arange(400)
SIGNAL = 5.0 * np.exp(-0.3 * T) + 0.1
X = (Coordinate("x", 1),)


def logged(values):
    return Records((Record(T, values[:, None], ("x",)),))


@pytest.mark.parametrize("seed", range(5))
def test_the_share_that_goes_with_the_reading_is_found(seed):
    rng = np.random.default_rng(seed)
    constant, proportional = 0.02, 0.05
    noise = np.hypot(constant, proportional * SIGNAL) * rng.standard_normal(len(T))
    found = relative_noise([noise], [SIGNAL])
    true = (proportional * SIGNAL) ** 2
    share = float(true.mean() / (true.mean() + constant**2))
    assert found is not None
    assert found.share == pytest.approx(share, abs=0.12)
    # The oracle is the variance that the noise was drawn with.
    drawn = true + constant**2
    assert found.variance(SIGNAL) == pytest.approx(drawn / drawn.mean(), rel=0.6)


@pytest.mark.parametrize("seed", range(20))
def test_white_noise_does_not_go_with_the_reading(seed):
    rng = np.random.default_rng(seed)
    assert relative_noise([0.1 * rng.standard_normal(len(T))], [SIGNAL]) is None
    assert relative_noise([0.1 * rng.standard_normal(60)], [SIGNAL[:60]]) is None


def test_what_a_filter_leaves_of_the_signal_is_no_noise():
    assert relative_noise([0.05 * SIGNAL * np.sin(2.0 * T)], [SIGNAL]) is None


def test_few_outliers_where_the_signal_is_large_are_no_noise_that_goes_with_it():
    rest = 0.01 * np.random.default_rng(1).standard_normal(len(T))
    rest[[3, 9]] = 0.5
    assert relative_noise([rest], [SIGNAL]) is None


@pytest.mark.parametrize("seed", range(5))
def test_samples_that_are_as_wrong_as_their_size_has_it_stay_and_weigh_less(seed):
    rng = np.random.default_rng(seed)
    records = logged(SIGNAL * (1.0 + 0.05 * rng.standard_normal(len(T))))
    gated = gate_outliers(records, X, Spectral())
    assert sum(int(np.count_nonzero(run.counted("x") == 0.0)) for run in gated) <= 1
    channel = estimate_signals(records, X, [], Spectral()).channels[0]
    weight = channel.weight(SIGNAL)
    assert weight[-1] > 20.0 * weight[0]
    # Noise and weight together give the deviation of a sample; the noise is the root mean square of all.
    assert channel.noise / np.sqrt(weight[:100]) == pytest.approx(0.05 * SIGNAL[:100], rel=0.3)


def test_a_sample_that_is_off_for_its_size_is_gated_all_the_same():
    values = SIGNAL * (1.0 + 0.05 * np.random.default_rng(2).standard_normal(len(T)))
    values[300] += 0.5
    gated = gate_outliers(logged(values), X, Spectral())
    assert gated.runs[0].counted("x")[300] == 0.0
