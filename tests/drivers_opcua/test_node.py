import uuid

import pytest
from hypothesis import given
from hypothesis import strategies as st

from softplc.drivers.opcua.node import BrowsePathAddress, NodeIdAddress, parse_address

GUID = "09087e75-8e5e-499b-954f-f2a9603db28a"


@pytest.mark.parametrize(
    ("text", "address"),
    [
        ("ns=2;s=AxisX.Position", NodeIdAddress(2, "AxisX.Position")),
        ("ns=2;s=a;b=c/d & e", NodeIdAddress(2, "a;b=c/d & e")),
        ('ns=3;s="DB_Axis"."Position"[2]', NodeIdAddress(3, '"DB_Axis"."Position"[2]')),
        ("ns=4;s=|var|PLC.Application.GVL.rPos", NodeIdAddress(4, "|var|PLC.Application.GVL.rPos")),
        ("ns=3;i=1001", NodeIdAddress(3, 1001)),
        ("i=2258", NodeIdAddress(0, 2258)),
        (f"ns=2;g={GUID}", NodeIdAddress(2, uuid.UUID(GUID))),
        ("ns=1;b=AQID", NodeIdAddress(1, b"\x01\x02\x03")),
        ("nsu=urn:plc:line4;s=AxisX.Position", NodeIdAddress("urn:plc:line4", "AxisX.Position")),
        ("nsu=http://acme.com/a%3Bb%25;i=7", NodeIdAddress("http://acme.com/a;b%", 7)),
    ],
)
def test_node_ids_of_every_kind_are_understood(text: str, address: NodeIdAddress):
    assert address == parse_address(text)


@pytest.mark.parametrize(
    ("text", "steps"),
    [
        ("/Objects/2:Axis/2:Position", ((0, "Objects"), (2, "Axis"), (2, "Position"))),
        ("Objects/2:Axis/2:Position", ((0, "Objects"), (2, "Axis"), (2, "Position"))),
        ("/Root/Objects/2:Axis", ((0, "Objects"), (2, "Axis"))),
        ("/0:Objects/0:Server/ServiceLevel", ((0, "Objects"), (0, "Server"), (0, "ServiceLevel"))),
        ("/Objects/2:Axis.Position", ((0, "Objects"), (2, "Axis.Position"))),
        ("/Objects/2:a&/b/2:c&&d", ((0, "Objects"), (2, "a/b"), (2, "c&d"))),
        ("/Objects/2:Axis: left", ((0, "Objects"), (2, "Axis: left"))),
        ("/Objects/nsu=http://acme.com/plc;Axis/2:P", ((0, "Objects"), ("http://acme.com/plc", "Axis"), (2, "P"))),
    ],
)
def test_browse_paths_are_understood_with_and_without_leading_slash(
    text: str, steps: tuple[tuple[int | str, str], ...]
):
    assert BrowsePathAddress(steps) == parse_address(text)


@pytest.mark.parametrize(
    ("text", "found", "right"),
    [
        ("AxisX.Position", "'AxisX.Position' is neither", "ns=2;s=AxisX.Position"),
        ("", "''", "browse path"),
        (" ns=2;s=a", "blanks", "ns=2;s=AxisX.Position"),
        ("ns=two;s=a", "ns=two", "0 … 65535"),
        ("ns=70000;s=a", "ns=70000", "0 … 65535"),
        ("ns=-1;s=a", "ns=-1", "0 … 65535"),
        ("ns=2;i=abc", "i=abc", "s=abc"),
        ("ns=2;i=4294967296", "i=4294967296", "4294967295"),
        ("ns=2;g=123", "g=123", "09087e75"),
        ("ns=2;b=###", "b=###", "M/Rb"),
        ("ns=2;x=1", "x=", "s= (string)"),
        ("ns=2;s=", "nothing follows s=", ""),
        ("nsu=;s=a", "nsu= is empty", "urn:plc"),
        ("svr=1;ns=2;s=a", "another server", ""),
        ("/2:Axis/2:Position", "does not begin", "/Objects/2:AxisX"),
        ("/Objects", "names a folder", "/Objects/2:AxisX/2:Position"),
        ("/Objects//2:Position", "empty step", "/Objects/2:AxisX"),
        ("/Objects/2:", "empty step", "/Objects/2:AxisX"),
        ("/Objects/2:Axis&", "ends with &", "&&"),
        ("/Objects/nsu=urn:plc/Axis", "without ;", "nsu=urn:plc:line4;AxisX"),
    ],
)
def test_a_wrong_address_is_told_what_was_found_and_what_would_be_right(text: str, found: str, right: str):
    with pytest.raises(ValueError) as error:
        parse_address(text)

    assert found in str(error.value)
    assert right in str(error.value)


names = st.text(min_size=1)
namespaces = st.one_of(st.integers(0, 0xFFFF), names)
identifiers = st.one_of(
    st.integers(0, 0xFFFFFFFF), names.filter(lambda s: s == s.strip()), st.uuids(), st.binary(min_size=1)
)


@given(namespaces, identifiers)
def test_a_printed_node_id_parses_back(namespace: int | str, identifier: int | str | uuid.UUID | bytes):
    address = NodeIdAddress(namespace, identifier)

    assert address == parse_address(str(address))


@given(st.lists(st.tuples(namespaces, names), min_size=1))
def test_a_printed_browse_path_parses_back(steps: list[tuple[int | str, str]]):
    address = BrowsePathAddress(((0, "Objects"), *steps))

    if str(address) == str(address).strip():
        assert address == parse_address(str(address))
