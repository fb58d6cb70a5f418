import subprocess
import sys

import numpy as np
import pytest
from matplotlib import rcParams
from matplotlib.figure import Figure
from pages import identified
from scipy.integrate import solve_ivp

import odescope
from odescope import report
from odescope.errors import InputError
from odescope.report.figures.paint import painters
from odescope.report.figures.pictures import draw_job, pictures
from odescope.report.figures.style import plain, product, saved


@pytest.fixture(scope="module")
def result():
    return identified()[0]


def test_each_figure_is_a_function_of_a_result(result):
    before = dict(rcParams)
    for name in report.__all__:
        if name.startswith("plot_"):
            assert isinstance(getattr(report, name)(result), Figure)
    assert dict(rcParams) == before


def points(line):
    """Return the points of a line where it is not interrupted."""
    x, y = np.asarray(line.get_xdata(), dtype=float), np.asarray(line.get_ydata(), dtype=float)
    return x[np.isfinite(y)], y[np.isfinite(y)]


def test_signals_are_drawn_as_recorded_and_as_filtered_with_every_extreme(result):
    figure = report.plot_signals(result)
    (run,), (kept,), (begin,) = result.records.runs, result.signals.columns, result.signals.start
    time = begin - run.t[0] + result.signals.period * np.arange(kept.shape[1])
    wide = [ax for ax in figure.axes if ax.get_ylabel()]
    drawn = {ax.get_ylabel()[:1]: {own.get_label(): points(own) for own in ax.get_lines()} for ax in wide}
    for name in ("x", "y", "u"):
        x, y = drawn[name]["recorded"]
        column = run.column(name)
        assert (y.min(), y.max()) == pytest.approx((column.min(), column.max()), abs=1e-4 * np.ptp(column))
        assert np.abs(y - np.interp(x, run.t - run.t[0], column)).max() < 1e-3 * np.ptp(column)
    for name in ("x", "y"):
        x, y = drawn[name]["filtered"]
        signal = kept[result.signals.row(name)]
        assert np.abs(y - np.interp(x, time, signal)).max() < 1e-3 * np.ptp(signal)
        assert len(x) > 100


def test_spectra_bear_the_levels_and_cutoffs_that_were_found(result):
    for ax, channel in zip(report.plot_spectra(result).axes, result.signals.channels, strict=True):
        found = {line.get_label(): line for line in ax.get_lines()}
        assert found["cutoff"].get_xdata()[0] == channel.cutoff
        assert found["noise floor"].get_ydata()[0] == pytest.approx(2 * 1e-8 * 0.02, rel=0.2)  # 2 s^2 dt


def test_targets_and_free_run_are_drawn_where_the_true_system_goes(result):
    """The system of `pages.samples` is known: its right-hand side, and SciPy's run of it from where the part begins."""
    signals, (columns,) = result.signals, result.signals.columns
    x, y, u = (columns[signals.row(name)] for name in ("x", "y", "u"))
    time = signals.start[0] + signals.period * np.arange(len(x))
    for ax, right in zip(report.plot_targets(result).axes[::2], (-x + 0.5 * y + u, 1 - 2 * y + x * y), strict=True):
        for label in ("estimated", "model"):
            at, values = points(next(line for line in ax.get_lines() if line.get_label() == label))
            assert np.abs(values - np.interp(at, time, right)).max() < 0.02 * np.ptp(right)

    first = len(x) - len(x) // 5
    states = solve_ivp(
        lambda t, s: (-s[0] + 0.5 * s[1] + np.interp(t, time, u), 1.0 - 2.0 * s[1] + s[0] * s[1]),
        (time[first], time[-1]), (x[first], y[first]), dense_output=True, rtol=1e-8, max_step=signals.period,
    ).sol  # fmt: skip
    for k, ax in enumerate(report.plot_free_run(result).axes):
        at, values = points(next(line for line in ax.get_lines() if line.get_label() == "model"))
        assert at[0] == pytest.approx(time[first], abs=1e-4)
        assert at[-1] == pytest.approx(time[-1], abs=1e-4)
        assert np.abs(values - states(at)[k]).max() < 5e-3


def test_a_target_may_be_named(result):
    assert isinstance(report.plot_candidates(result, "y_dot"), Figure)
    with pytest.raises(InputError, match="did you mean 'y_dot'"):
        report.plot_correlation(result, "y_dt")


def test_the_correlations_are_the_cosines_of_the_factor(result):
    (image,) = report.plot_correlation(result, "y_dot").axes[0].get_images()
    cosines = result.searches[1].problem.factor.correlations()
    assert np.abs(np.asarray(image.get_array()) - cosines).max() <= 0.005 + 1e-9


def test_drawing_apart_and_here_gives_the_same_bytes(result):
    told = report.summary(result)
    some = pictures(told)[3:5]
    with painters() as painter:
        painter.begin(pictures(told)[4:6])  # the last of which nobody will want
        drawn = painter.paint(some)
    assert drawn == {p.name: draw_job(p.job) for p in some}


def test_a_process_that_does_not_draw_is_made_up_for(result, monkeypatch):
    monkeypatch.setattr("sys.executable", "/bin/false")
    picture = pictures(report.summary(result))[5]
    with painters() as painter:
        assert painter.paint([picture]) == {picture.name: draw_job(picture.job)}


def test_labels_bear_any_text():
    figure = Figure()
    figure.text(0.5, 0.5, plain("$x^ <b>\x00\u4e2d & \n" + "long " * 40))
    svg, png = saved(figure, "name")
    assert "<b>" not in svg
    assert "$x^ &lt;b&gt;" in svg
    assert "\x00" not in svg
    assert png.startswith(b"\x89PNG")
    assert product("x_dot**2*sin(phi)*y**-1") == "x_dot²·sin(phi)·y⁻¹"
    assert len(plain("a" * 100)) == 40


def test_notebooks_show_equations_escaped(result):
    for shown in (result, result.model):
        html = shown._repr_html_()
        assert html.count("<math") == 2
        assert "No denominator vanishes" in html
        assert "<img" not in html
        latex = shown._repr_latex_()
        assert latex.startswith("$$")
        assert r"\dot{x} = " in latex
    from dataclasses import replace

    from odescope.model.notebook import model_html

    assert "&lt;b&gt;" in model_html(result.model, ["<b>"])
    bare = replace(result.model, scores=None)
    assert "<li>" not in bare._repr_html_()
    assert isinstance(odescope.to_mathml(bare), str)


MEMORY = """
import numpy as np
from odescope import Spectral, Study, identify
from odescope.study.options import Data, Filtering, LikelihoodSearch, Measured


class Hungry:
    def derivatives(self, channel, period, order):
        held = np.ones(40_000_000)  # 320 MB
        return Spectral().derivatives(channel, period, order)


t = 0.02 * np.arange(1500)
x = np.cos(2.0 * t) + 1e-4 * np.random.default_rng(0).standard_normal(len(t))
study = Study(
    data=Data(time="t"), coordinates={"x": Measured(order=2)}, signals=Filtering(differentiator=Hungry()),
    likelihood=LikelihoodSearch(enabled=False),
)
memory = identify(study, {"t": t, "x": x}).memory
print(memory["records"], memory["signals"], memory["model"])
"""


def test_the_memory_of_a_stage_is_told_in_bytes_where_it_was_taken():
    told = subprocess.run([sys.executable, "-c", MEMORY], check=True, capture_output=True, text=True).stdout
    records, signals, model = map(int, told.split())
    assert 3e7 < records < 1e9
    assert 3e8 < signals - records < 6e8
    assert model - signals < 2e8
