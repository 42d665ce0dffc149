"""Which Reads are plain, in requests that asyncua encoded."""

from typing import Any

import pytest
from asyncua import ua
from asyncua.common.utils import Buffer
from asyncua.ua.ua_binary import nodeid_to_binary, struct_from_binary, struct_to_binary
from hypothesis import given
from hypothesis import strategies as st

from softplc.publishers.opcua.fast.requests import Remembered, parse_head, parse_nodes
from softplc.tags import DataType, TagTable
from tests.publishers_opcua.fast.conftest import served

VALUE = ua.AttributeIds.Value
TOKEN = ua.NodeId(b"t" * 32, 0, ua.NodeIdType.ByteString)


def table(count: int) -> TagTable:
    return served([(DataType.DOUBLE, 1.0, 0, 1)] * count, 1).table


def read_value(number: int, **other: Any) -> ua.ReadValueId:
    return ua.ReadValueId(**{"NodeId": ua.NodeId(f"X.t{number}é", 2), "AttributeId": VALUE, **other})


def request(nodes: list[ua.ReadValueId], max_age: float = 0.0, stamps: int = 2, **header: Any) -> bytes:
    body = ua.ReadRequest(Parameters=ua.ReadParameters(max_age, ua.TimestampsToReturn(stamps), nodes))
    body.RequestHeader = ua.RequestHeader(**{"AuthenticationToken": TOKEN, "RequestHandle": 4711, **header})
    encoded: bytes = struct_to_binary(body)
    return encoded


def parse(body: bytes, count: int = 5, most: int = 10) -> tuple[int, int, list[int]] | None:
    head = parse_head(body, nodeid_to_binary(TOKEN))
    if head is None:
        return None
    tags = parse_nodes(body[head.nodes :], table(count), most)
    return None if tags is None else (head.handle, head.stamps, tags.tolist())


@pytest.mark.parametrize("stamps", [0, 1, 2, 3])
def test_a_plain_read_is_understood(stamps: int) -> None:
    body = request([read_value(3), read_value(0), read_value(3)], 1000.0, stamps, TimeoutHint=5, ReturnDiagnostics=3)

    assert parse(body) == (4711, stamps, [3, 0, 3])


def test_empty_texts_are_as_good_as_none() -> None:
    node = read_value(1, IndexRange="", DataEncoding=ua.QualifiedName("", 0))

    assert parse(request([node], AuditEntryId="")) == (4711, 2, [1])


@pytest.mark.parametrize(
    "node",
    [
        read_value(5),
        read_value(1, NodeId=ua.NodeId("X.t1é", 3)),
        read_value(1, NodeId=ua.NodeId(2258)),
        read_value(1, NodeId=ua.NodeId(b"X.t1", 2)),
        read_value(1, AttributeId=ua.AttributeIds.DisplayName),
        read_value(1, IndexRange="0:1"),
        read_value(1, DataEncoding=ua.QualifiedName("Default Binary", 0)),
        read_value(1, DataEncoding=ua.QualifiedName("Default XML", 0)),
        read_value(1, DataEncoding=ua.QualifiedName(None, 1)),
    ],
    ids=repr,
)
def test_a_read_with_something_else_in_it_is_not_plain(node: ua.ReadValueId) -> None:
    assert parse(request([read_value(0), node])) is None


@pytest.mark.parametrize(
    "body",
    [
        request([]),
        request([read_value(0)] * 11),
        request([read_value(0)], max_age=-1.0),
        request([read_value(0)], max_age=float("nan")),
        request([read_value(0)], AuthenticationToken=ua.NodeId(b"s" * 32, 0, ua.NodeIdType.ByteString)),
        request([read_value(0)], AuditEntryId="who"),
        request([read_value(0)], AdditionalHeader=ua.ExtensionObject(ua.NodeId(1, 1), b"x")),
        request([read_value(0)]) + b"\0",
        request([read_value(0)])[:-1],
    ],
    ids=["none", "too many", "age", "no age", "token", "audit", "additional", "more", "less"],
)
def test_what_others_have_to_judge_is_not_plain(body: bytes) -> None:
    assert parse(body) is None


@given(
    data=st.one_of(st.binary(max_size=8), st.sampled_from([b"0", b"1", b"\x02", b"\xff" * 4, b"\0" * 4])),
    at=st.integers(0, 200),
)
def test_what_is_taken_for_plain_is_what_asyncua_decodes(data: bytes, at: int) -> None:
    good = request([read_value(0), read_value(1)], 3.5, 1)
    body = good[:at] + data + good[at + len(data) :]

    found = parse(body)

    if found is not None:
        asked = struct_from_binary(ua.ReadRequest, Buffer(body))
        assert found[:2] == (asked.RequestHeader.RequestHandle, asked.Parameters.TimestampsToReturn)
        assert [read_value(number) for number in found[2]] == [
            ua.ReadValueId(node.NodeId, node.AttributeId, node.IndexRange or None)
            for node in asked.Parameters.NodesToRead
        ]


def test_what_was_not_asked_for_the_longest_is_forgotten() -> None:
    remembered = Remembered(20)
    for nodes in (b"a" * 8, b"b" * 8):
        remembered.put(nodes, nodes)
    assert remembered.get(b"a" * 8)

    remembered.put(b"c" * 8, 3)

    assert (len(remembered), remembered.get(b"b" * 8), remembered.get(b"a" * 8)) == (2, None, b"a" * 8)
