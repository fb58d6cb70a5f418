import numpy as np
import pytest
from matplotlib import rcParams
from matplotlib.figure import Figure
from pages import identified

import odescope
from odescope import report
from odescope.errors import InputError
from odescope.report.paint import painters
from odescope.report.pictures import draw_job, pictures
from odescope.report.style import plain, product, saved


@pytest.fixture(scope="module")
def result():
    return identified()[0]


def lines(figure):
    return {line.get_label(): line for ax in figure.axes for line in ax.get_lines()}


def test_each_figure_is_a_function_of_a_result(result):
    before = dict(rcParams)
    for name in report.__all__:
        if name.startswith("plot_"):
            assert isinstance(getattr(report, name)(result), Figure)
    assert dict(rcParams) == before


def test_the_lines_are_those_of_the_result(result):
    found = lines(report.plot_signals(result))
    x = result.records.runs[0].column("x")
    assert np.nanmax(found["recorded"].get_ydata()) <= max(x.max(), result.records.runs[0].column("u").max()) + 1e-3
    spectra = lines(report.plot_spectra(result))
    assert spectra["cutoff"].get_xdata()[0] == result.signals.channels[1].cutoff
    assert spectra["noise floor"].get_ydata()[0] == pytest.approx(2 * 1e-8 * 0.02, rel=0.2)  # 2 s^2 dt
    run = lines(report.plot_free_run(result))
    assert np.abs(run["model"].get_ydata()[:50] - run["record, filtered"].get_ydata()[:50]).max() < 1e-2
    target = report.plot_targets(result, identified()[1])
    assert {"estimated", "truth", "model"} < set(lines(target))


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

    from odescope.model.display import equations_html

    assert "&lt;b&gt;" in equations_html(result.model.quotients, ["<b>"])
    bare = replace(result.model, scores={})
    assert "<li>" not in bare._repr_html_()
    assert isinstance(odescope.to_mathml(bare), str)


def test_memory_of_the_stages(result):
    peaks = [result.memory[name] for name in ("records", "regression", "likelihood")]
    assert peaks == sorted(peaks)
    assert 5e7 < peaks[0] < 1e11
