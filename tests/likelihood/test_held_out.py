"""What searches do not see: parts of records that are there."""

from dataclasses import replace

import numpy as np
import pytest
from process_cases import LENGTH, SIGMA, Q, cut
from small_systems import SPRING, SPRING_STEP, drive, shots, spring_run

from odescope.likelihood.evaluator import Evaluator
from odescope.likelihood.held_out import SEARCHED, free_run_errors, held_out, thinned, without_held_out
from odescope.likelihood.search import search
from odescope.likelihood.search_space import SearchSpace

NOISE, SPREAD = 2e-4, np.array([1e-4, 5e-4])


@pytest.fixture(scope="module")
def space():
    data = shots(spring_run(SPRING.theta), drive(), SPRING_STEP, NOISE, np.random.default_rng(1), SPREAD)
    return SearchSpace(Evaluator(data, 2), SPRING.mechanisms, SPRING.frame)


@pytest.mark.parametrize("last", [1, 3, 4])
def test_a_record_of_a_few_averages_beside_others_is_not_held_out(space, last):
    count = len(space.segments.filtered)
    both = space.on(replace(space.segments, runs=((0, count - last), (count - last, count))))
    parts = held_out(both.segments)
    assert all(low < high for low, high in parts)
    assert all(high <= count - last for _, high in parts)
    errors = free_run_errors(both, SPRING.theta)
    assert np.all((errors > 0.0) & (errors < 0.01))


def test_joined_segments_of_a_record_have_one_initial_state(space):
    found = search(space, SPRING.theta)
    assert np.isfinite(found.width)
    taken = len(space.segments.runs) * found.fit.x0.shape[1] + len(found.fit.free)
    assert found.scale == pytest.approx(found.fit.data_cost / (space.segments.samples - taken), rel=1e-12)


@pytest.mark.parametrize("lengths", [(100, 27), (30, 20, 25, 40, 35, 10), (12,) * 11])
def test_what_searches_see_and_what_is_held_out_have_nothing_in_common(lengths):
    total = sum(lengths)
    segments = cut(np.zeros((total, 2)), np.zeros((total, 1)), drive(total), SIGMA, Q, lengths)
    seen = without_held_out(segments)
    covered = np.concatenate([np.arange(s, s + c) for s, c in zip(seen.start, seen.count, strict=True)])
    out = np.concatenate([np.arange(low, high) for low, high in held_out(segments)])
    assert not set(covered) & set(out)
    assert 0.1 < len(out) / total < 0.25
    # Between them no more than the segment that holds the edge is lost.
    assert total - len(covered) - len(out) < LENGTH * len(held_out(segments))
    follows = np.append(seen.start[1:] == (seen.start + seen.count)[:-1], False)
    borders = {high for _, high in segments.runs}
    np.testing.assert_array_equal(
        seen.joined, follows & ~np.array([e in borders for e in (seen.start + seen.count).tolist()])
    )


def test_of_records_that_are_a_segment_each_searches_see_shorter_ones():
    lengths = (36, 36)
    segments = cut(np.zeros((72, 2)), np.zeros((72, 1)), drive(72), SIGMA, Q, lengths).cut_anew(36)
    assert segments.count.tolist() == [36, 36]
    seen = without_held_out(segments)
    covered = np.concatenate([np.arange(s, s + c) for s, c in zip(seen.start, seen.count, strict=True)])
    out = np.concatenate([np.arange(low, high) for low, high in held_out(segments)])
    assert not set(covered) & set(out)
    assert len(covered) >= 0.6 * 72


@pytest.mark.parametrize("lengths", [(70_000,), (30_000, 9_000, 21_000)])
def test_a_search_sees_stretches_of_a_long_record_from_all_over_it(lengths):
    total = sum(lengths)
    nothing = np.zeros((total, 2))
    segments = cut(nothing, nothing[:, :1], np.zeros((total, 3, 1)), 1.0, [1.0, 1.0], lengths)
    part = thinned(segments)
    assert 0.99 * SEARCHED < part.count.sum() < 1.01 * SEARCHED
    assert np.diff(np.append(part.start, total), prepend=0).max() < total / 10
    ends = part.start + part.count
    assert np.array_equal(
        part.joined[:-1],
        np.isin(ends[:-1], segments.start[1:])
        & (ends[:-1] == part.start[1:])
        & ~np.isin(ends[:-1], np.cumsum(lengths)),
    )
    assert not part.joined[-1]
    short = cut(nothing[:20_000], nothing[:20_000, :1], np.zeros((20_000, 3, 1)), 1.0, [1.0, 1.0], (20_000,))
    assert thinned(short) is short
