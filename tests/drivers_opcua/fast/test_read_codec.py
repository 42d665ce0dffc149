"""The contract with asyncua's codec: the same bytes give the same values, statuses and timestamps."""

import math

import numpy as np
import pytest
from asyncua import ua
from asyncua.ua.ua_binary import struct_to_binary
from hypothesis import given, settings
from hypothesis import strategies as st

from softplc.drivers.opcua.binding import Binding, put
from softplc.drivers.opcua.fast.plain import SlowState
from softplc.drivers.opcua.fast.read import ReadPlan
from softplc.drivers.opcua.node import NodeIdAddress
from softplc.drivers.opcua.session import link_errors
from softplc.errors import LinkError
from softplc.tags import Image
from tests.drivers_opcua.fast.messages import data_values, numbers, read_response, reference, value_lists

few = settings(max_examples=50, deadline=None)  # each of up to 3600 records
ARRIVAL, NOW = 12.5, 1_700_000_000_000_000_000


class Line:
    """Stands where the session stands, for plans that are given their answers directly."""

    url = "opc.tcp://plc"

    def encode(self, request: object, response: type) -> None:
        return None


def bind(uses: list[list[int | None]]) -> list[Binding]:
    """A binding for each record, used with these indices (None: whole) at one position after the other."""
    positions = iter(range(sum(len(indices) for indices in uses)))
    return [
        Binding(NodeIdAddress(2, f"n{number}"), [(next(positions), index) for index in indices], problem="")
        for number, indices in enumerate(uses)
    ]


def make_plan(bindings: list[Binding]) -> ReadPlan:
    return ReadPlan(Line(), bindings, SlowState())


def take(plan: ReadPlan, body: bytes, image: Image, arrival: float, now: int) -> None:
    """As `read` does when this answer comes."""
    with link_errors("plc"):
        plan.take(body, image, arrival, now)


def by_asyncua(body: bytes, bindings: list[Binding]) -> Image:
    image = Image(sum(len(binding.uses) for binding in bindings))
    for binding, data in zip(bindings, reference(ua.ReadResponse, body).Results, strict=True):
        put(binding, data, image, ARRIVAL, NOW)
    return image


def same(left: Image, right: Image) -> None:
    np.testing.assert_array_equal(left.values, right.values)
    np.testing.assert_array_equal(left.statuses, right.statuses)
    np.testing.assert_array_equal(left.source_timestamps, right.source_timestamps)
    np.testing.assert_array_equal(left.arrivals, right.arrivals)


def compare(plan: ReadPlan, body: bytes, uses: list[list[int | None]]) -> None:
    reading, image = bind(uses), Image(sum(map(len, uses)))
    expected = by_asyncua(body, reading)
    take(plan, body, image, ARRIVAL, NOW)

    same(image, expected)
    assert [binding.problem for binding in plan.bindings] == [binding.problem for binding in reading]


@few
@given(value_lists(), st.data())
def test_every_encoding_of_a_data_value_gives_what_asyncua_gives(records: list[bytes], data: st.DataObject):
    some = st.lists(st.sampled_from([None, None, 0, 2]), min_size=0, max_size=2)
    every_third = data.draw(some)
    uses = [every_third if number % 3 == 2 else [None] for number in range(len(records))]
    plan = make_plan(bind(uses))
    body = read_response(records)

    compare(plan, body, uses)
    for binding in plan.bindings:
        binding.problem = ""
    plan.renew()
    compare(plan, body, uses)  # by the layout that it remembers now
    assert plan._slow.messages == 0


@given(st.lists(st.tuples(data_values(numbers()), data_values(numbers())), min_size=1, max_size=30))
def test_a_layout_that_changes_from_message_to_message_is_seen(pairs: list[tuple[ua.DataValue, ua.DataValue]]):
    uses: list[list[int | None]] = [[None]] * len(pairs)
    plan = make_plan(bind(uses))
    bodies = [read_response([struct_to_binary(pair[side]) for pair in pairs]) for side in (0, 1)]
    for body in (*bodies, *bodies):
        image = Image(len(pairs))
        take(plan, body, image, ARRIVAL, NOW)
        same(image, by_asyncua(body, bind(uses)))
    assert (plan._slow.messages, plan._slow.values) == (0, 0)


def test_an_array_of_more_nulls_than_bytes_is_refused_at_once():
    nulls = b"\x01\x80" + (361_000_000).to_bytes(4, "little")  # asyncua would work on this for two minutes
    with pytest.raises(LinkError, match="361000000 nulls"):
        take(make_plan(bind([[None]])), read_response([nulls]), Image(1), ARRIVAL, NOW)


def outcome(body: bytes, count: int) -> Image | None:
    """What asyncua says of a body: an image, or None when it raises or has another number of results."""
    try:
        answer = reference(ua.ReadResponse, body)
        answer.ResponseHeader.ServiceResult.check()
        if len(answer.Results) != count:
            return None
        return by_asyncua(body, bind([[None]] * count))
    except Exception:
        return None


def check_spoilt(body: bytes, count: int, plan: ReadPlan | None = None) -> None:
    plan = plan or make_plan(bind([[None]] * count))
    image, expected = Image(count), outcome(body, count)
    if expected is None:
        with pytest.raises(LinkError):
            take(plan, body, image, ARRIVAL, NOW)
        assert np.isnan(image.values).all()
    else:
        take(plan, body, image, ARRIVAL, NOW)
        same(image, expected)


@few
@given(value_lists(), st.data())
def test_a_body_cut_short_is_a_link_error_and_never_a_number(records: list[bytes], data: st.DataObject):
    body = read_response(records)
    plan = make_plan(bind([[None]] * len(records)))
    take(plan, body, Image(len(records)), ARRIVAL, NOW)  # even when its layout is remembered
    for cut in (data.draw(st.integers(4, len(body) - 1)), len(body) - 5):
        if outcome(body[:cut], len(records)) is None:
            with pytest.raises(LinkError):
                take(plan, body[:cut], Image(len(records)), ARRIVAL, NOW)


@few
@given(value_lists(), st.data())
def test_spoilt_bytes_are_what_asyncua_takes_them_for_or_a_link_error(records: list[bytes], data: st.DataObject):
    body = bytearray(read_response(records))
    plan = make_plan(bind([[None]] * len(records)))
    take(plan, bytes(body), Image(len(records)), ARRIVAL, NOW)
    for _ in range(data.draw(st.integers(1, 3))):
        body[data.draw(st.integers(4, min(len(body) - 1, 200)))] = data.draw(st.integers(0, 255))
    check_spoilt(bytes(body), len(records), plan)
    check_spoilt(bytes(body), len(records))


@few
@given(st.binary(max_size=200), st.integers(0, 5))
def test_garbage_is_a_link_error_or_what_asyncua_takes_it_for(garbage: bytes, count: int):
    head = read_response([])[:32]
    for body in (garbage, head[:4] + garbage, head[:28] + count.to_bytes(4, "little") + garbage):
        check_spoilt(body, count)


def test_a_count_of_results_that_is_not_the_asked_is_a_link_error():
    one = struct_to_binary(ua.DataValue(ua.Variant(1.5)))
    for count in (-1, 0, 1, 3, 2**31 - 1):
        with pytest.raises(LinkError):
            take(make_plan(bind([[None]] * 2)), read_response([one, one], count=count), Image(2), ARRIVAL, NOW)


def test_diagnostics_and_a_service_result_take_the_way_through_asyncua():
    records = [struct_to_binary(ua.DataValue(ua.Variant(1.5)))] * 2
    diagnostics = struct_to_binary(ua.DiagnosticInfo(SymbolicId=3))
    body = read_response(records, tail=(1).to_bytes(4, "little") + diagnostics)
    plan = make_plan(bind([[None]] * 2))
    image = Image(2)
    take(plan, body, image, ARRIVAL, NOW)
    assert (image.values.tolist(), plan._slow.messages) == ([1.5, 1.5], 1)

    refused = bytearray(read_response(records))
    refused[16:20] = (0x80020000).to_bytes(4, "little")
    with pytest.raises(LinkError, match="BadInternalError"):
        take(plan, bytes(refused), image, ARRIVAL, NOW)


def test_one_bad_tag_among_thousands_moves_the_others_and_none_is_wrong():
    good = [struct_to_binary(ua.DataValue(ua.Variant(float(number)))) for number in range(3000)]
    bad = struct_to_binary(ua.DataValue(None, ua.StatusCode(0x808C0000)))
    plan = make_plan(bind([[None]] * 3000))
    for place in (0, 1, 1499, 2999):
        image = Image(3000)
        take(plan, read_response([*good[:place], bad, *good[place + 1 :]]), image, ARRIVAL, NOW)
        expected = np.arange(3000.0)
        expected[place] = math.nan
        np.testing.assert_array_equal(image.values, expected)
    assert (plan._slow.messages, plan._slow.values) == (0, 0)
