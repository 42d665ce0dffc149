"""Nodes are made when somebody asks for them, and nobody can tell."""

from typing import Any

import pytest
from asyncua import ua

from softplc.publishers.opcua.address_space import NAMESPACE, TagIndex, node_id
from tests.publishers_opcua.conftest import Served, serve

pytestmark = pytest.mark.asyncio(loop_scope="module")
HIERARCHY = {ua.NodeId(ua.ObjectIds.Organizes), ua.NodeId(ua.ObjectIds.HasComponent)} | {
    ua.NodeId(ua.ObjectIds.HasProperty)
}


def space_of(served: Served) -> Any:
    return served.server._server.iserver.aspace


def made(served: Served) -> set[str]:
    """The ids of our nodes that there are by now."""
    return {each.Identifier for each in space_of(served).keys() if each.NamespaceIndex == NAMESPACE}  # noqa: SIM118


async def test_only_what_a_client_asked_for_is_made() -> None:
    async with serve() as served:
        folders = {"/softplc", "/softplc/Tasks", "/softplc/Sources", "/softplc/Axes"}
        assert folders == made(served)
        async with served.client() as client:
            await client.read_values([client.get_node("ns=2;s=AxisX.Position"), client.get_node("ns=2;s=AxisY.Raw")])
            assert made(served) == folders  # values are read out of the arrays

            await client.get_node("ns=2;s=AxisX.Position.EURange").read_browse_name()
            assert made(served) == folders | {"AxisX", "AxisX.Position", "AxisX.Position.EURange"}


async def test_every_reference_leads_to_a_node_that_leads_back(served: Served) -> None:
    space, todo, seen = space_of(served), [node_id("/softplc")], set()
    while todo:
        here = todo.pop()
        seen.add(here)
        for reference in space[here].references:
            if reference.IsForward and reference.ReferenceTypeId in HIERARCHY:
                there = space[reference.NodeId]
                back = next(each for each in there.references if not each.IsForward)
                assert (back.NodeId, back.ReferenceTypeId) == (here, reference.ReferenceTypeId)
                value = there.attributes[ua.AttributeIds.BrowseName].value.Value.Value
                assert value == reference.BrowseName
                kind = next(each.NodeId for each in there.references if each.ReferenceTypeId.Identifier == 40)
                assert kind == reference.TypeDefinition
                todo.append(reference.NodeId)
    assert {node_id(tag.name) for tag in served.exchange.table} <= seen


@pytest.mark.parametrize(
    "unknown",
    [
        ua.NodeId("AxisX.Position", 1),
        ua.NodeId("AxisX.Position", 3),
        ua.NodeId(b"AxisX.Position", 2),
        ua.NodeId(7, 2),
        ua.NodeId("", 2),
        ua.NodeId(".", 2),
        ua.NodeId("AxisX.", 2),
        ua.NodeId(".Position", 2),
        ua.NodeId("AxisX.Position.", 2),
        ua.NodeId("AxisX.Position.EnumStrings", 2),
        ua.NodeId("AxisX.Reason.EURange", 2),
        ua.NodeId("AxisX.Position.EURange.EURange", 2),
        ua.NodeId("/softplc/Axes/AxisX", 2),
    ],
    ids=str,
)
async def test_what_is_no_node_is_unknown_and_leaves_nothing_behind(served: Served, unknown: Any) -> None:
    space, before = space_of(served), len(space_of(served).keys())
    assert unknown not in space
    assert space.get(unknown) is None
    with pytest.raises(KeyError):
        space[unknown]
    assert unknown not in TagIndex(served.exchange.table)
    assert before == len(space.keys())


async def test_the_index_of_tags_goes_by_node_id(served: Served) -> None:
    table = served.exchange.table
    index = TagIndex(table)
    assert [index[each] for each in index] == list(range(len(table))) == list(range(len(index)))
