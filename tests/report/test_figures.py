from dataclasses import replace

import msgspec
import numpy as np
import pytest
from matplotlib import rcParams
from matplotlib.figure import Figure
from pages import identified, samples

import odescope
from odescope import report
from odescope.errors import InputError
from odescope.model.scores import PathScore
from odescope.report.figures.catalogue import draw_job, pictures
from odescope.report.figures.draw_grids import draw_accuracy
from odescope.report.figures.draw_path import draw_path
from odescope.report.figures.processes import painters
from odescope.report.figures.style import plain, product, saved
from odescope.report.searches import searched


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


def test_recorded_lines_pass_through_the_samples_and_miss_no_peak(result):
    data, truth = samples()
    figure = report.plot_signals(result)
    for name in ("x", "y", "u"):
        panel = next(ax for ax in figure.axes if ax.get_ylabel().startswith(name))
        drawn = {line.get_label(): line for line in panel.get_lines()}
        t, value = drawn["recorded"].get_data()
        step = np.rint(t / 0.02).astype(int)
        # Drawn to five digits of the span, and more points than the eye tells apart.
        assert np.abs(value - data[name][step]).max() < 1e-4 * np.ptp(data[name])
        assert (step[0], step[-1]) == (0, len(data["t"]) - 1)
        assert len(step) > 500
        for extreme in (np.min, np.max):
            assert extreme(value) == pytest.approx(extreme(data[name]), abs=1e-4 * np.ptp(data[name]))
        if name == "u":
            assert "filtered" not in drawn
            continue
        t, value = drawn["filtered"].get_data()
        error = value - truth[name][np.rint(t / 0.02).astype(int)]
        assert np.std(error) < 0.9e-4  # less than the noise that was added


def test_samples_that_do_not_count_are_marked_and_do_not_press_the_lines_flat():
    data, _ = samples()
    data = data | {"x": data["x"].copy()}
    far = {300: 0.5, 900: -0.4, 1500: 1e4}
    for k, by in far.items():
        data["x"][k] += by
    study = odescope.Study(
        data=odescope.Data(time="t"),
        coordinates={"x": odescope.Measured(), "y": odescope.Measured()},
        inputs={"u": odescope.Driven()},
        likelihood=odescope.LikelihoodSearch(enabled=False),
    )
    result = odescope.identify(study, data)
    assert [n for n in result.notes if "samples of x do not count" in n and "outliers" in n]
    figure = report.plot_signals(result)
    panel = next(ax for ax in figure.axes if ax.get_ylabel().startswith("x"))
    drawn = {line.get_label(): line.get_data() for line in panel.get_lines()}
    t, value = drawn["does not count"]
    assert {300, 900, 1500} <= set(np.rint(t / 0.02).astype(int))
    at = {int(k): y for k, y in zip(np.rint(t / 0.02), value, strict=True)}
    assert at[300] == pytest.approx(data["x"][300], abs=1e-3)
    low, high = panel.get_ylim()
    assert low < at[1500] < high
    assert np.ptp(drawn["recorded"][1]) > 0.4 * (high - low)
    assert not set(far) & set(np.rint(drawn["recorded"][0] / 0.02).astype(int))
    removed = next(line for ax in figure.axes for line in ax.get_lines() if line.get_label() == "removed")
    assert np.abs(removed.get_ydata()).max() < 0.3


def test_the_cutoff_and_the_floor_part_the_spectrum(result):
    """Noise of 1e-4 at 50 Hz stands at 2 s^2 dt = 4e-10 a hertz; the three sines that drive end at 0.7 Hz."""
    for panel in report.plot_spectra(result).axes:
        drawn = {line.get_label(): line for line in panel.get_lines()}
        floor, cutoff = drawn["noise floor"].get_ydata()[0], drawn["cutoff"].get_xdata()[0]
        frequency, power = drawn["periodogram"].get_data()
        assert floor == pytest.approx(4e-10, rel=0.2)
        assert 0.7 < cutoff < 10.0
        assert np.mean(power[frequency > 1.2 * cutoff]) == pytest.approx(floor, rel=0.1)
        assert np.mean(power[(frequency > 0.35 * cutoff) & (frequency < 0.6 * cutoff)]) > 10.0 * floor


def test_free_run_and_targets_are_the_truth_to_within_the_noise(result):
    """The record is noisy in the fourth digit; a free run from its start stays that close to the end."""
    data, truth = samples()
    figure = report.plot_free_run(result)
    for name in ("x", "y"):
        panel = next(ax for ax in figure.axes if ax.get_ylabel().startswith(name))
        drawn = {line.get_label(): line for line in panel.get_lines()}
        t, value = drawn["free run"].get_data()
        assert t[0] == 0.0
        assert t[-1] > 39.5
        known = np.interp(t, data["t"], truth[name])
        assert np.abs(value - known).max() < 2e-3 * np.std(truth[name])
        t, value = drawn["measured"].get_data()
        assert np.abs(value - np.interp(t, data["t"], data[name])).max() < 1e-4 * np.ptp(data[name])
    figure = report.plot_targets(result, truth)
    for name in ("x_dot", "y_dot"):
        panel = next(ax for ax in figure.axes if ax.get_ylabel().startswith(name))
        drawn = {line.get_label(): line for line in panel.get_lines()}
        assert drawn.keys() >= {"estimated", "truth", "model"}
        for label, allowed in (("truth", 1e-4), ("model", 1e-3), ("estimated", 5e-3)):
            t, value = drawn[label].get_data()
            error = value - np.interp(t, data["t"], truth[name])
            # Drawn to a millisecond of the forty seconds.
            drawing = 5e-4 * np.std(np.gradient(truth[name], data["t"]))
            assert np.std(error) < allowed * np.std(truth[name]) + drawing, label


def test_the_path_shows_every_model_its_spread_and_the_choice(result):
    path = (
        PathScore(9, 0.011, 0.004, None, None, False),
        PathScore(8, 0.012, 0.02, "x**3 in x_dot", 9.0, True),  # the bar ends below zero
        PathScore(7, 0.4, 0.1, "u in x_dot", 1e4, False),
        PathScore(6, 0.5, 0.0, "x in x_dot", 1e5, False),
    )
    scores = msgspec.structs.replace(result.model.scores, path=path)
    figure = report.plot_path(replace(result, model=replace(result.model, scores=scores)))
    (ax,) = figure.axes
    drawn = lines(figure)
    assert np.array_equal(np.transpose(drawn["model on the path"].get_data()), [(9, 0.011), (7, 0.4), (6, 0.5)])
    assert np.array_equal(np.transpose(drawn["chosen"].get_data()), [(8, 0.012)])
    assert drawn["chosen"].get_marker() == "D"
    assert ax.get_yscale() == "log"
    foot, head = ax.get_ylim()
    assert 0.0 < foot < 0.007
    assert head > 0.5
    (bars,) = ax.collections
    for step, bar in zip(path, bars.get_segments(), strict=True):
        (left, low), (right, high) = bar
        assert left == right == step.terms
        assert high == pytest.approx(step.error + step.spread)
        below = step.error - step.spread
        assert low == pytest.approx(below) if below > 0.0 else 0.0 < low < foot
    with pytest.raises(InputError, match="no path"):
        report.plot_path(replace(result, model=replace(result.model, scores=None)))


@pytest.mark.parametrize("error", [None, 0.0])
def test_a_path_of_which_an_error_is_not_known_or_zero_is_drawn(error):
    figure = draw_path((PathScore(3, error, None, None, None, True), PathScore(2, 0.1, 0.0, "x", 4.0, False)))
    assert saved(figure, "path")[1].startswith(b"\x89PNG")


def test_a_target_may_be_named(result):
    assert isinstance(report.plot_candidates(result, "y_dot"), Figure)
    with pytest.raises(InputError, match="did you mean 'y_dot'"):
        report.plot_correlation(result, "y_dt")


def test_the_correlations_are_the_cosines_of_the_factor(result):
    (image,) = report.plot_correlation(result, "y_dot").axes[0].get_images()
    cosines = result.searches[1].problem.factor.gram
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


@pytest.mark.parametrize("targets", [1, 4, 5, 13])
def test_the_accuracy_of_many_targets_has_panels_that_can_be_read(result, targets):
    figure = draw_accuracy(searched(result) * targets)
    panels = figure.axes[:targets]
    assert len(panels) == targets
    boxes = [ax.get_window_extent() for ax in panels]
    width = figure.get_window_extent()
    assert all(box.width > 0.12 * width.width and width.y0 < box.y0 and box.y1 < width.y1 for box in boxes)
    assert not any(a.overlaps(b) for k, a in enumerate(boxes) for b in boxes[:k])


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
    from odescope.model.display import equations_html

    assert "&lt;b&gt;" in equations_html(result.model.quotients, ["<b>"])
    bare = replace(result.model, scores=None)
    assert "<li>" not in bare._repr_html_()
    assert isinstance(odescope.to_mathml(bare), str)


def test_every_stage_has_its_time_and_its_memory(result):
    assert list(result.memory) == list(result.seconds)
    assert all(seconds > 0.0 for seconds in result.seconds.values())
