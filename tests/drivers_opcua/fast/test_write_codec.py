"""The contract with asyncua's codec for writing: the same bytes out, the same statuses in."""

import struct
from typing import Any

import numpy as np
import pytest
from asyncua import ua
from asyncua.ua.ua_binary import nodeid_to_binary, struct_to_binary
from hypothesis import given, settings
from hypothesis import strategies as st

from softplc.drivers.opcua.fast.plain import SlowState
from softplc.drivers.opcua.fast.write import Target, WritePlan, encoded, fits
from softplc.drivers.opcua.session import link_errors
from softplc.drivers.opcua.values import NUMBER_TYPES, encode
from softplc.errors import LinkError
from tests.drivers_opcua.fast.messages import SCALARS

EDGES = [float(2**bits + step) for bits in (7, 8, 15, 16, 31, 32, 53) for step in (-1, 0, 1)]
EDGES += [2.0**63, 2.0**64, np.nextafter(2.0**63, 0), np.nextafter(2.0**64, 0), 0.5, 1.5, 254.5, 255.5, 3.5e38]
EDGES += [0.0, 1.0, 3.4028234663852886e38, float(np.nextafter(3.4028234663852886e38, np.inf)), np.inf, np.nan]
floats = st.sampled_from([sign * edge for edge in EDGES for sign in (1.0, -1.0)]) | st.floats()


class Encoded:
    def __init__(self, request: Any) -> None:
        self.body = bytearray(struct_to_binary(request))


class Line:
    url = "opc.tcp://plc"

    def encode(self, request: Any, response: type) -> Encoded:
        return Encoded(request)


def nodes() -> st.SearchStrategy[ua.NodeId]:
    return st.text(max_size=9).map(lambda name: ua.NodeId(name, 2)) | st.integers(1, 2**32 - 1).map(ua.NodeId)


def writes() -> st.SearchStrategy[list[tuple[Any, float]]]:
    target = st.tuples(nodes(), st.sampled_from(SCALARS), st.none() | st.integers(0, 9))
    return st.lists(st.tuples(target, floats), min_size=1, max_size=20)


def plan_for(count: int) -> WritePlan:
    return plan_of([(ua.NodeId("x", 2), ua.VariantType.Double, None)] * count)


def plan_of(targets: list[Target]) -> WritePlan:
    kinds = np.array([kind.value for _, kind, _ in targets], np.uint8)
    return WritePlan(Line(), [encoded(target) for target in targets], kinds, SlowState())


def variant_of(value: float, kind: ua.VariantType, index: int | None) -> ua.Variant:
    variant = encode(value, kind)
    return variant if index is None else ua.Variant([variant.Value], kind, is_array=True)


@settings(deadline=None)
@given(writes())
def test_values_laid_into_the_request_are_the_bytes_that_asyncua_encodes(asked: list[tuple[Any, float]]):
    fit = fits(np.array([value for _, value in asked]), np.array([target[1].value for target, _ in asked], np.uint8))
    assert fit.tolist() == [encode(value, target[1]) is not None for target, value in asked]

    sent = [pair for pair, taken in zip(asked, fit, strict=True) if taken]
    if not sent:
        return
    plan = plan_of([target for target, _ in sent])
    plan.lay(np.ones(len(sent)))
    body = bytes(plan.lay(np.array([value for _, value in sent])).body)
    writes = [
        ua.WriteValue(
            node,
            ua.AttributeIds.Value,
            None if index is None else str(index),
            ua.DataValue(variant_of(value, kind, index), StatusCode=None),
        )
        for (node, kind, index), value in sent
    ]
    assert body.endswith(struct.pack("<i", len(writes)) + b"".join(struct_to_binary(write) for write in writes))


def test_every_number_type_can_be_laid():
    assert set(SCALARS) == NUMBER_TYPES


def response(statuses: list[int], tail: bytes = b"\0\0\0\0") -> bytes:
    head = struct_to_binary(ua.WriteResponse())[:28]
    assert head.startswith(nodeid_to_binary(ua.WriteResponse().TypeId))
    return head + struct.pack(f"<i{len(statuses)}I", len(statuses), *statuses) + tail


@given(st.lists(st.integers(0, 2**32 - 1), min_size=1), st.data())
def test_statuses_are_those_of_the_answer_and_a_spoilt_answer_is_a_link_error(
    statuses: list[int], data: st.DataObject
):
    plan, body = plan_for(len(statuses)), response(statuses)
    assert plan.take(body).tolist() == statuses
    with pytest.raises(LinkError), link_errors("plc"):
        plan.take(body[: data.draw(st.integers(0, len(body) - 1))])
    with pytest.raises(LinkError), link_errors("plc"):
        plan_for(len(statuses) + 1).take(body)


def test_a_refused_write_tells_the_service_result():
    body = bytearray(response([0]))
    body[16:20] = (0x801F0000).to_bytes(4, "little")
    with pytest.raises(LinkError, match="BadUserAccessDenied"), link_errors("plc"):
        plan_for(1).take(bytes(body))
