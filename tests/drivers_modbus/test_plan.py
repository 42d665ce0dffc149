"""The planner covers every value once, whole, within the limits, in as few requests as there can be."""

from functools import cache

import pytest
from hypothesis import given
from hypothesis import strategies as st

from softplc.drivers.modbus.address import Table
from softplc.drivers.modbus.plan import Limits, Request, Span, plan, split


def registers(*places: tuple[int, int], table: Table = Table.HOLDING) -> list[Span]:
    return [Span(table, start, length) for start, length in places]


def ranges(requests: tuple[Request, ...]) -> list[tuple[int, int]]:
    return [(request.start, request.count) for request in requests]


def test_neighbours_share_one_request():
    assert ranges(plan(registers((4, 2), (0, 2), (2, 2)), Limits())) == [(0, 6)]


def test_a_gap_up_to_max_gap_is_read_along_and_a_larger_one_is_not():
    spans = registers((0, 2), (10, 2), (21, 1))

    assert ranges(plan(spans, Limits(max_gap=8))) == [(0, 12), (21, 1)]
    assert ranges(plan(spans, Limits(max_gap=7))) == [(0, 2), (10, 2), (21, 1)]
    assert ranges(plan(spans, Limits(max_gap=9))) == [(0, 22)]


def test_a_value_is_never_split_at_the_limit():
    spans = registers(*((2 * i, 2) for i in range(70)))

    assert ranges(plan(spans, Limits(max_registers=125))) == [(0, 124), (124, 16)]


def test_each_table_has_its_own_requests_and_its_own_limit():
    spans = [Span(table, 3, 1) for table in Table] + [Span(Table.COIL, 3 + 1999, 1), Span(Table.COIL, 3 + 2000, 1)]

    requests = plan(spans, Limits(max_gap=5000))

    assert [(r.table, r.start, r.count) for r in requests] == [
        (Table.COIL, 3, 2000),
        (Table.COIL, 2003, 1),
        (Table.DISCRETE, 3, 1),
        (Table.HOLDING, 3, 1),
        (Table.INPUT, 3, 1),
    ]
    assert [r.size for r in requests] == [250, 1, 1, 2, 2]


def test_overlapping_and_equal_values_share():
    assert ranges(plan(registers((0, 4), (2, 2), (2, 2), (3, 1)), Limits())) == [(0, 4)]


def test_a_value_longer_than_the_limit_is_refused():
    with pytest.raises(ValueError, match="4 registers cannot be read with at most 2"):
        plan(registers((0, 4)), Limits(max_registers=2))


def test_a_refused_request_is_first_tried_without_its_gaps():
    (request,) = plan(registers((0, 2), (4, 2), (6, 2)), Limits())

    assert ranges(split(request, Limits())) == [(0, 2), (4, 4)]


def test_a_refused_request_without_gaps_is_halved_between_values_until_one_is_left():
    (request,) = plan(registers((0, 2), (2, 4), (6, 1)), Limits())

    left, right = split(request, Limits())

    assert ranges((left, right)) == [(0, 2), (2, 5)]
    assert split(left, Limits()) == ()
    assert ranges(split(right, Limits())) == [(2, 4), (6, 1)]


SPANS = st.lists(
    st.builds(Span, st.sampled_from(list(Table)), st.integers(0, 60), st.sampled_from([1, 1, 2, 4])), max_size=12
)
LIMITS = st.builds(Limits, st.integers(4, 20), st.integers(4, 20), st.integers(0, 8))


@given(SPANS, LIMITS)
def test_every_value_is_covered_whole_and_once_within_limit_and_gap(spans, limits):
    requests = plan(spans, limits)

    assert sorted(span for request in requests for span in request.spans) == sorted(set(spans))
    for request in requests:
        assert request.count <= limits.of(request.table)
        stop = request.start
        for span in request.spans:
            assert request.table is span.table
            assert span.start - stop <= (limits.max_gap if stop > request.start else 0)
            stop = max(stop, span.stop)
        assert request.start == request.spans[0].start
        assert request.start + request.count == stop
    assert requests == plan(reversed(spans), limits)


@given(st.lists(st.builds(Span, st.just(Table.INPUT), st.integers(0, 14), st.sampled_from([1, 2, 4])), max_size=7), LIMITS)
def test_no_cover_has_fewer_requests(spans, limits):
    assert len(plan(spans, limits)) == fewest(tuple(sorted(set(spans))), limits)


@cache
def fewest(spans: tuple[Span, ...], limits: Limits) -> int:
    """Fewest requests, by trying every set of values that may be in one request with the first."""
    if not spans:
        return 0
    first, rest = spans[0], spans[1:]
    best = len(spans)
    for mask in range(2 ** len(rest)):
        chosen = [span for i, span in enumerate(rest) if mask >> i & 1]
        stop, allowed = first.stop, True
        for span in chosen:
            allowed &= span.start - stop <= limits.max_gap
            stop = max(stop, span.stop)
        if allowed and stop - first.start <= limits.max_registers:
            left = tuple(span for i, span in enumerate(rest) if not mask >> i & 1)
            best = min(best, 1 + fewest(left, limits))
    return best


@given(SPANS, LIMITS)
def test_splitting_ends_with_every_value_alone(spans, limits):
    requests = list(plan(spans, limits))
    alone = []
    while requests:
        parts = split(request := requests.pop(), limits)
        if not parts:
            alone.append(request)
            continue
        assert sorted(span for part in parts for span in part.spans) == sorted(request.spans)
        assert all(part.count <= limits.of(part.table) for part in parts)
        requests += parts

    assert sorted(span for request in alone for span in request.spans) == sorted(set(spans))
    assert all((r.start, r.count) == (r.spans[0].start, r.spans[0].length) for r in alone)
