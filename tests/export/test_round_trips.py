"""Four models with delays, run by the tools of every language along a record of ten seconds, beside the free run."""

import numpy as np
import pytest
from exported_models import RECORD, ROUND_TRIPS
from scipy.integrate import solve_ivp
from test_antimony import simulator
from test_c import Compiled, needs_compiler
from test_casadi import module as casadi_module
from test_fmu import built, simulated  # noqa: F401 (a fixture)
from test_matlab import needs_octave, octave, written
from test_python import module as python_module

from odescope.export.programs.matlab import to_matlab
from odescope.model.model import without_delays

TOLERANCE = 1e-6  # of the largest that each state is
every_model = pytest.mark.parametrize("trip", ROUND_TRIPS.values(), ids=ROUND_TRIPS)


@every_model
def test_the_delay_counts(trip):
    early = type(trip)(without_delays(trip.model), trip.inputs, trip.start)
    assert trip.largest(early.exact) > 1e-3
    assert np.ptp(trip.exact, axis=0).min() > 0.1


@needs_compiler
@every_model
def test_c(trip, tmp_path):
    found = Compiled(trip.model, tmp_path).follow(trip.start, trip.inputs, RECORD, 2e-3)
    assert trip.largest(found) < TOLERANCE


@every_model
def test_python(trip):
    derivative, now, found = python_module(trip.model)["derivative"], np.array(trip.start), [trip.start]
    hold = trip.model.inputs[0].hold

    def recorded(time):
        if hold == "linear":
            return [np.interp(time, RECORD, trip.inputs[:, 0])]
        return trip.inputs[max(np.searchsorted(RECORD, time, side="right") - 1, 0)]

    for begin, end, _, _, sample in trip.pieces():
        # Off the corners by next to nothing, where a held input is what it is between them.
        inside = begin + 1e-9, end - 1e-9
        now = solve_ivp(lambda s, y: derivative(s, y, recorded), inside, now, rtol=1e-10, atol=1e-12).y[:, -1]
        now = now + 2e-9 * derivative(end - 1e-9, now, recorded)
        found += [now] * int(sample >= 0)
    assert trip.largest(np.array(found)) < TOLERANCE


@every_model
def test_casadi(trip):
    found = casadi_module(trip.model)["simulate"](trip.start, RECORD, trip.inputs)
    assert trip.largest(found) < TOLERANCE


@every_model
def test_fmu_in_co_simulation(trip, built):  # noqa: F811
    found = simulated(built(trip.model), "CoSimulation", trip.model, trip.inputs, trip.start, t=RECORD)
    assert trip.largest(found) < TOLERANCE


@every_model
def test_fmu_in_model_exchange(trip, built):  # noqa: F811
    # Constant: FMPy's integrator is not told where inputs have corners.
    steady = type(trip)(trip.model, np.full_like(trip.inputs, trip.inputs[0, 0]), trip.start)
    unit, options = built(trip.model), {"t": RECORD, "relative_tolerance": 1e-9}
    found = simulated(unit, "ModelExchange", trip.model, steady.inputs, trip.start, **options)
    assert steady.largest(found) < TOLERANCE


OCTAVE = """
log = dlmread('{name}.txt'); pieces = dlmread('{name}_pieces.txt');
if strcmp('{hold}', 'zero')
    u = @(s) log(max(sum(log(:, 1) <= s), 1), 2);
else
    line = @(j, s) log(j, 2) + (log(j + 1, 2) - log(j, 2)) * (s - log(j, 1)) / (log(j + 1, 1) - log(j, 1));
    u = @(s) line(min(floor(max(s, 0) / log(2, 1)) + 1, rows(log) - 1), max(s, 0));
end
options = odeset('RelTol', 1e-9, 'AbsTol', 1e-11);
x = {start}'; out(end + 1, 1:numel(x)) = x';
for k = 1:size(pieces, 1)
    short = 1e-9 * (pieces(k, 2) - pieces(k, 1));
    [~, run] = ode45(@(t, x) {name}(t, x, u), pieces(k, 1:2) + short * [1, -1], x, options);
    x = run(end, :)';
    if pieces(k, 3) >= 0
        out(end + 1, 1:numel(x)) = x';
    end
end
"""


@pytest.mark.slow
@needs_octave
@pytest.mark.parametrize("trip", ROUND_TRIPS.values(), ids=ROUND_TRIPS)
def test_matlab(trip, tmp_path):
    (tmp_path / "plant.m").write_text(to_matlab(trip.model, "plant").files["plant.m"])
    np.savetxt(tmp_path / "plant.txt", np.column_stack([RECORD, trip.inputs]), "%.17g")
    np.savetxt(tmp_path / "plant_pieces.txt", [[b, e, s] for b, e, _, _, s in trip.pieces()], "%.17g")
    start, hold = written([trip.start]), trip.model.inputs[0].hold
    found = octave(tmp_path, "out = [];" + OCTAVE.format(name="plant", hold=hold, start=start))
    assert trip.largest(found) < TOLERANCE


def test_antimony():
    trip = ROUND_TRIPS["network"]
    running, spelling = simulator(trip.model)
    running.integrator.relative_tolerance, running.integrator.absolute_tolerance = 1e-11, 1e-13
    for name, value in zip(trip.model.states, trip.start, strict=True):
        running[spelling[name]] = value
    found = [trip.start]
    for begin, end, value, _, sample in trip.pieces():
        running["feed"] = value[0]
        running.simulate(begin, end, 2)
        found += [[running[spelling[s]] for s in trip.model.states]] * int(sample >= 0)
    assert trip.largest(np.array(found)) < TOLERANCE
