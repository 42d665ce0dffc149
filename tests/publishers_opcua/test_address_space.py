"""What a client sees when it browses: the golden list of every node, its ids, types, units and ranges."""

from pathlib import Path
from typing import Any

import pytest
from asyncua import Client, Node, ua

from softplc.publishers.opcua.properties import DEFAULT_RANGE, DEFAULT_RANGES, engineering_units, eu_range
from softplc.tags import Tag
from softplc.units import UNECE_NAMESPACE, UNITS
from tests.publishers_opcua.conftest import Served

pytestmark = pytest.mark.asyncio(loop_scope="module")

GOLDEN = Path(__file__).with_name("golden.txt")
IDS = ua.AttributeIds


def plain(value: Any) -> str:
    """Value of a property in few characters."""
    if isinstance(value, ua.Range):
        return f"{value.Low:g} to {value.High:g}"
    if isinstance(value, ua.EUInformation):
        return f"{value.UnitId} {value.DisplayName.Text}"
    return "; ".join(text.Text for text in value)


async def describe(node: Node, path: str = "") -> list[str]:
    """One line for each node below: path, id, type definition, data type, access level, value of a property."""
    lines = []
    for child in await node.get_children(refs=ua.ObjectIds.HierarchicalReferences):
        name = await child.read_browse_name()
        here = f"{path}/{name.Name}"
        type_definition = ua.ObjectIdNames[(await child.read_type_definition()).Identifier]
        fields = [here, child.nodeid.to_string(), type_definition]
        if await child.read_node_class() == ua.NodeClass.Variable:
            fields.append((await child.read_data_type_as_variant_type()).name)
            fields.append("+".join(sorted(level.name for level in await child.get_access_level())))
            if type_definition == "PropertyType":
                fields.append(plain(await child.read_value()))
        lines.append(" | ".join(fields))
        lines += await describe(child, here)
    return lines


async def test_the_whole_address_space_is_as_agreed(client: Client, tmp_path: Path) -> None:
    root = client.get_node("ns=2;s=/softplc")

    lines = await describe(root, "Objects/softplc")

    proposal = tmp_path / "golden.txt"
    proposal.write_text("\n".join(lines) + "\n", encoding="utf-8")
    assert GOLDEN.read_text(encoding="utf-8").splitlines() == lines, (
        f"clients rely on these; if meant, take {proposal}"
    )


async def test_our_namespace_is_index_two_and_the_uris_are_fixed(client: Client) -> None:
    assert await client.get_namespace_array() == [
        "http://opcfoundation.org/UA/",
        "urn:softplc:server",
        "urn:softplc:tags",
    ]
    server_array = await client.get_node(ua.ObjectIds.Server_ServerArray).read_value()
    assert server_array == ["urn:softplc:server"]
    endpoints = await client.get_endpoints()
    assert {"urn:softplc:server"} == {endpoint.Server.ApplicationUri for endpoint in endpoints}
    assert {ua.MessageSecurityMode.None_} == {endpoint.SecurityMode for endpoint in endpoints}
    tokens = {token.TokenType for endpoint in endpoints for token in endpoint.UserIdentityTokens}
    assert {ua.UserTokenType.Anonymous, ua.UserTokenType.UserName} == tokens


async def test_the_server_tells_who_it_is(client: Client) -> None:
    info = await client.get_node(ua.ObjectIds.Server_ServerStatus_BuildInfo).read_value()

    assert (info.ProductName, info.ManufacturerName, info.ProductUri) == ("softplc", "softplc", "urn:softplc")


async def test_every_tag_has_its_description(served: Served, client: Client) -> None:
    for tag in served.exchange.table:
        description = await client.get_node(f"ns=2;s={tag.name}").read_description()
        assert (tag.name, tag.description) == (tag.name, description.Text)


async def test_every_reference_can_be_followed_back(served: Served, client: Client) -> None:
    for block in served.exchange.table.blocks:
        node = client.get_node(f"ns=2;s={block.tags[0].name}")
        path = await node.get_path(as_string=True)
        assert path[:3] == ["0:Root", "0:Objects", "2:softplc"]
        assert f"2:{block.name}" == path[4]


async def test_a_block_named_like_a_folder_has_its_own_node(client: Client) -> None:
    for folder in ("Tasks", "Sources", "Axes"):
        node = await client.nodes.objects.get_child(["2:softplc", f"2:{folder}"])
        assert f"/softplc/{folder}" == node.nodeid.Identifier  # a slash is in no configured name


@pytest.mark.parametrize(
    ("symbol", "unit_id"),
    [
        ("mm", 5066068), ("m", 5067858), ("in", 4804168), ("mm/s", 4403510), ("m/s", 5067859), ("rad", 4405297),
        ("deg", 17476), ("r/min", 5394509), ("mm2", 5066059), ("s", 5457219), ("ms", 4403766), ("", 4404786),
        ("1/s", 4405559), ("mm2/s", 4403511), ("rev", 5059636), ("(mm/s)2", -1), ("count", -1),
    ],
)  # fmt: skip
async def test_unit_ids_are_those_of_the_opc_foundations_table(symbol: str, unit_id: int) -> None:
    information = engineering_units(symbol)

    assert unit_id == information.UnitId
    assert (unit_id != -1) == (information.NamespaceUri == UNECE_NAMESPACE)
    assert symbol == information.DisplayName.Text


async def test_no_two_units_share_a_code() -> None:
    codes = [unit.code for unit in UNITS.values() if unit.code]

    assert len(codes) == len(set(codes))


async def test_the_range_is_the_tags_own_or_a_stated_default() -> None:
    assert eu_range(Tag("a.b", "mm", range=(-1.0, 5.0))) == (-1.0, 5.0)
    assert DEFAULT_RANGES["deg"] == eu_range(Tag("a.b", "deg"))
    assert eu_range(Tag("a.b", "furlong")) == DEFAULT_RANGE
