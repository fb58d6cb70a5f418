"""Minimum and maximum per pixel, against a look at every point."""

import numpy as np
import pytest

pytest.importorskip("nicegui")

from odescope.workbench.overview import BLOCK, MOST_POINTS, Overview, extremes


def pieces(values, rng, count):
    cuts = np.sort(rng.integers(0, len(values), count))
    return np.split(values, cuts)


def by_pixel(t, y, begin, end, pixels):
    """The least and the greatest value of every pixel, one by one."""
    found = []
    for k in range(pixels):
        low, high = begin + k * (end - begin) / pixels, begin + (k + 1) * (end - begin) / pixels
        own = y[(t >= low) & (t < high) & np.isfinite(y)]
        found.append((own.min(), own.max()) if len(own) else (np.inf, -np.inf))
    return np.array(found)


@pytest.mark.parametrize("count", [700, 40_000, MOST_POINTS + 50_000, pytest.param(1_500_000, marks=pytest.mark.slow)])
@pytest.mark.parametrize("part", [(0.0, 1.0), (0.31, 0.62)])
def test_every_pixel_shows_its_extremes(count, part):
    rng = np.random.default_rng(count)
    t = np.cumsum(rng.uniform(0.5, 1.5, count))
    y = np.cumsum(rng.standard_normal(count)) + 40.0 * (rng.random(count) < 1e-4)
    y[rng.random(count) < 1e-3] = np.nan
    line = Overview.of(pieces(t, np.random.default_rng(1), 5), pieces(y, np.random.default_rng(1), 5))
    begin, end = (t[0] + p * (t[-1] - t[0]) for p in part)
    pixels = 200
    x, drawn = line.window(begin, end, pixels)
    assert np.all(np.diff(x) > 0.0)
    assert np.isfinite(drawn).all()
    assert len(x) <= 2 * pixels + 4
    assert set(zip(x, drawn, strict=True)) <= set(zip(t, y, strict=True))  # points of the line, none made up
    wanted, found = by_pixel(t, y, begin, end, pixels), by_pixel(x, drawn, begin, end, pixels)
    # Of blocks that lie across an edge the extreme may be drawn one pixel on; nothing is lost.
    for k in range(1, pixels - 1):
        near = found[k - 1 : k + 2]
        assert near[:, 0].min() <= wanted[k, 0] + 1e-12
        assert near[:, 1].max() >= wanted[k, 1] - 1e-12
    inside = (t >= begin) & (t <= end) & np.isfinite(y)
    assert drawn.min() <= y[inside].min()
    assert drawn.max() >= y[inside].max()


def test_a_close_look_shows_every_point():
    t = np.arange(1_000_000) * 1e-3
    y = np.sin(t)
    x, drawn = Overview.of([t], [y]).window(500.0, 500.2, 1000)
    np.testing.assert_array_equal(drawn, y[499_999:500_202][: len(drawn)])
    assert x[0] <= 500.0
    assert x[-1] >= 500.2


def test_pieces_make_no_difference():
    rng = np.random.default_rng(3)
    t, y = np.arange(600_000.0), rng.standard_normal(600_000)
    whole = Overview.of([t], [y])
    cut = Overview.of(np.split(t, [100, 100, 250_000]), np.split(y, [100, 100, 250_000]))
    for begin, end in ((0.0, 599_999.0), (99.0, 101.0), (249_990.0, 250_010.0), (-5.0, -1.0), (7e5, 8e5)):
        one, other = whole.window(begin, end, 100), cut.window(begin, end, 100)
        if end - begin < 1000.0:
            np.testing.assert_array_equal(one, other)
        assert one[1].max(initial=-9.0) == other[1].max(initial=-9.0)


@pytest.mark.parametrize("count", [0, 1, BLOCK - 1, BLOCK, 3 * BLOCK + 5])
def test_blocks_keep_their_extremes_whatever_is_missing(count):
    y = np.random.default_rng(count).standard_normal(count)
    y[::7] = np.nan
    kept = extremes(y)
    assert np.all(np.diff(kept) > 0)
    for first in range(0, count, BLOCK):
        own = y[first : first + BLOCK]
        inside = y[kept[(kept >= first) & (kept < first + BLOCK)]]
        if np.isfinite(own).any():
            assert (np.nanmin(inside), np.nanmax(inside)) == (np.nanmin(own), np.nanmax(own))


def test_nothing_to_draw_is_no_error():
    line = Overview.of([np.empty(0)], [np.empty(0)])
    assert line.span == (0.0, 1.0)
    assert len(line.window(0.0, 1.0, 100)[0]) == 0
    t = np.arange(10.0)
    assert len(Overview.of([t], [np.full(10, np.nan)]).window(0.0, 9.0, 100)[0]) == 0
