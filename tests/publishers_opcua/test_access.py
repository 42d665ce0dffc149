"""Read-only for everybody but a configured user, who writes the writable tags: every way in is tried."""

import math
from collections.abc import AsyncIterator, Sequence
from typing import Any

import pytest
import pytest_asyncio
from asyncua import Client, ua
from asyncua.common.utils import ServiceError
from structlog.testing import capture_logs

from softplc.exchange import COMMANDS, DEAD_AFTER_AT_LEAST
from softplc.publishers.opcua.access import Users
from softplc.publishers.opcua.config import OpcUaServerUser
from tests.publishers_opcua.conftest import PASSWORD, USERS, Served

pytestmark = pytest.mark.asyncio(loop_scope="module")

CODES = ua.StatusCodes
VALUE = ua.AttributeIds.Value
ENABLE = ua.NodeId("AxisY.Enable", 2)  # writable in the exchange of the tests; AxisX.Enable is not


@pytest_asyncio.fixture(scope="module", loop_scope="module")
async def anonymous(served: Served) -> AsyncIterator[Client]:
    async with served.client() as client:
        yield client


@pytest_asyncio.fixture(scope="module", loop_scope="module")
async def engineer(served: Served) -> AsyncIterator[Client]:
    async with served.client("engineer", PASSWORD) as client:
        yield client


async def write(client: Client, items: Sequence[tuple[Any, Any, Any]]) -> list[int]:
    """Statuses of one Write request for (node id, attribute, DataValue) items."""
    request = ua.WriteParameters()
    request.NodesToWrite = [ua.WriteValue(node_id, attribute, None, value) for node_id, attribute, value in items]
    return [status.value for status in await client.uaclient.write(request)]


async def write_value(client: Client, node_id: Any, value: Any, variant_type: Any = None) -> int:
    (status,) = await write(client, [(node_id, VALUE, ua.DataValue(ua.Variant(value, variant_type)))])
    return status


def chunks(items: list[Any], size: int = 1000) -> list[list[Any]]:
    return [items[start : start + size] for start in range(0, len(items), size)]


def every_node(space: Any) -> list[Any]:
    """The ids of all nodes; ours are made when they are asked for, and their references lead to all of them."""
    found = list(space.keys())
    for node_id in found:
        references = [] if node_id.NamespaceIndex == 0 and node_id != ua.NodeId(85) else space[node_id].references
        found += [each.NodeId for each in references if each.IsForward and each.NodeId.NamespaceIndex == 2]
    return list(dict.fromkeys(found))


async def test_an_anonymous_client_writes_no_value_of_any_node(served: Served, anonymous: Client) -> None:
    space = served.server._server.iserver.aspace
    before = {node_id: space.read_attribute_value(node_id, VALUE).Value for node_id in every_node(space)}
    items = [(node_id, VALUE, ua.DataValue(value or ua.Variant(1))) for node_id, value in before.items()]

    statuses = [status for part in chunks(items) for status in await write(anonymous, part)]

    assert len(items) > 6000  # the standard's nodes and ours
    assert {CODES.BadNotWritable, CODES.BadAttributeIdInvalid, CODES.BadUserAccessDenied} == set(statuses)
    assert statuses.count(CODES.BadUserAccessDenied) == len([tag for tag in served.exchange.table if tag.writable])
    assert served.exchange.writer.commands() == []


@pytest.mark.parametrize("who", ["anonymous", "engineer"])
async def test_nobody_writes_any_other_attribute_of_our_nodes(
    served: Served, who: str, anonymous: Client, engineer: Client
) -> None:
    client = {"anonymous": anonymous, "engineer": engineer}[who]
    space = served.server._server.iserver.aspace
    ours = [node_id for node_id in every_node(space) if node_id.NamespaceIndex == 2]
    server = [ua.NodeId(i) for i in (2253, 2256, 2258, 2259, 2267, 2254, 2255)]
    items = [
        (node_id, attribute, space.read_attribute_value(node_id, attribute))
        for node_id in ours + server
        for attribute in ua.AttributeIds
        if attribute != VALUE
    ]

    statuses = [status for part in chunks(items) for status in await write(client, part)]

    assert {CODES.BadNotWritable, CODES.BadAttributeIdInvalid} == set(statuses)
    for node_id, attribute, value in items:
        assert value == space.read_attribute_value(node_id, attribute)


async def test_an_unknown_node_is_unknown_to_a_writer(engineer: Client) -> None:
    assert CODES.BadNodeIdUnknown == await write_value(engineer, ua.NodeId("AxisZ.Enable", 2), True)


async def test_a_configured_user_writes_enable_and_it_arrives_as_a_command(served: Served, engineer: Client) -> None:
    index = served.exchange.table.index("AxisY.Enable")
    served.exchange.set("AxisY.Enable", 1.0)
    await served.scan()

    with capture_logs() as logs:
        status = await write_value(engineer, ENABLE, False)

    assert CODES.GoodCompletesAsynchronously == status
    assert [(index, 0.0)] == served.exchange.writer.commands()
    assert [(entry["event"], entry["user"], entry["tag"], entry["value"]) for entry in logs] == [
        ("opcua write", "engineer", "AxisY.Enable", 0.0)
    ]
    node = engineer.get_node(ENABLE)
    assert await node.read_value() is True  # the published value is the scan process' word
    served.exchange.set("AxisY.Enable", 0.0)
    await served.scan()
    assert await node.read_value() is False


@pytest.mark.parametrize(
    ("leaf", "value", "accepted"),
    [
        ("r_x", 0.25, True),
        ("r_x", 0.0, False),
        ("r_x", -1.0, False),
        ("q_x", 0.0, True),
        ("q_x", -1e-9, False),
        ("q_x_dot", math.nan, False),
        ("q_x_dot", math.inf, False),
        ("BleedFactor", 0.5, True),
        ("BleedFactor", 1.0, False),
        ("BleedFactor", 0.0, False),
        ("BleedEnable", True, True),
        ("Reset", True, True),
    ],
)
async def test_a_configured_user_writes_the_tuning_within_its_limits(
    served: Served, engineer: Client, leaf: str, value: float, accepted: bool
) -> None:
    await served.scan()
    status = await write_value(engineer, ua.NodeId(f"AxisY.{leaf}", 2), value)

    taken = served.exchange.writer.commands()
    if accepted:
        assert (status, taken) == (
            CODES.GoodCompletesAsynchronously,
            [(served.exchange.table.index(f"AxisY.{leaf}"), float(value))],
        )
    else:
        assert (status, taken) == (CODES.BadOutOfRange, [])


async def test_a_configured_user_writes_nothing_else(served: Served, engineer: Client) -> None:
    items = [
        (ua.NodeId(tag.name, 2), VALUE, ua.DataValue(ua.Variant(1.0)))
        for tag in served.exchange.table
        if not tag.writable
    ]

    assert {CODES.BadNotWritable} == set(await write(engineer, items))
    assert served.exchange.writer.commands() == []


@pytest.mark.parametrize(
    ("value", "expected"),
    [
        (ua.DataValue(ua.Variant(1, ua.VariantType.UInt16)), CODES.BadTypeMismatch),
        (ua.DataValue(ua.Variant(1.0, ua.VariantType.Double)), CODES.BadTypeMismatch),
        (ua.DataValue(ua.Variant("true")), CODES.BadTypeMismatch),
        (ua.DataValue(ua.Variant(None)), CODES.BadTypeMismatch),
        (ua.DataValue(ua.Variant([True], ua.VariantType.Boolean)), CODES.BadTypeMismatch),
        (ua.DataValue(ua.Variant(True), ua.StatusCode(CODES.UncertainInitialValue)), CODES.BadWriteNotSupported),
    ],
)
async def test_a_value_of_another_kind_is_refused(
    served: Served, engineer: Client, value: ua.DataValue, expected: int
) -> None:
    assert [expected] == await write(engineer, [(ENABLE, VALUE, value)])
    assert served.exchange.writer.commands() == []


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf, 10.1, -0.1])
async def test_a_number_that_is_not_finite_or_outside_the_range_is_refused(value: float) -> None:
    from softplc.publishers.opcua.access import _judge
    from softplc.tags import Tag

    tag = Tag("AxisX.r_x", "mm2", range=(0.0, 10.0), writable=True)

    assert CODES.BadOutOfRange == _judge(tag, ua.Variant(value, ua.VariantType.Double))
    assert _judge(tag, ua.Variant(10.0, ua.VariantType.Double)) == 0


async def test_a_full_command_ring_is_told_to_the_writer(served: Served, engineer: Client) -> None:
    statuses = [await write_value(engineer, ENABLE, True) for _ in range(COMMANDS)]

    assert {CODES.GoodCompletesAsynchronously} == set(statuses[:-1])
    assert CODES.BadResourceUnavailable == statuses[-1]
    assert len(served.exchange.writer.commands()) == COMMANDS - 1


async def test_a_write_to_a_dead_scan_process_is_refused(served: Served, engineer: Client) -> None:
    served.clock.advance(DEAD_AFTER_AT_LEAST + 0.1)
    await served.server.publish()

    assert CODES.BadNoCommunication == await write_value(engineer, ENABLE, True)
    assert served.exchange.writer.commands() == []
    await served.scan()


async def test_access_levels_tell_each_session_what_it_may_write(anonymous: Client, engineer: Client) -> None:
    read, write_too = {ua.AccessLevel.CurrentRead}, {ua.AccessLevel.CurrentRead, ua.AccessLevel.CurrentWrite}
    for client, allowed in ((anonymous, read), (engineer, write_too)):
        assert write_too == await client.get_node(ENABLE).get_access_level()
        assert allowed == await client.get_node(ENABLE).get_user_access_level()
        assert read == await client.get_node("ns=2;s=AxisX.Enable").get_user_access_level()


@pytest.mark.parametrize(
    ("user", "password"),
    [("admin", ""), ("admin", "admin"), ("Admin", PASSWORD), ("engineer", ""), ("engineer", PASSWORD + "x"),
     ("Engineer", PASSWORD), ("nobody", "anything")],
)  # fmt: skip
async def test_a_wrong_name_or_password_is_refused(served: Served, user: str, password: str) -> None:
    client = served.client(user, password)
    with pytest.raises(ua.UaStatusCodeError) as refusal:
        await client.connect()

    assert CODES.BadIdentityTokenRejected == refusal.value.code


async def test_refused_logins_are_logged_once_a_minute(served: Served) -> None:
    served.clock.advance(61.0)
    with capture_logs() as logs:
        for _ in range(3):
            with pytest.raises(ua.UaStatusCodeError):
                await served.client("admin", "admin").connect()
    await served.scan()

    assert [(entry["event"], entry["log_level"]) for entry in logs] == [("opcua log-in refused", "warning")]


async def test_two_users_are_not_confused_by_names_and_passwords_that_run_together() -> None:
    users = Users([OpcUaServerUser(name="engine", password=USERS[0].password)])

    for name, password in (("engineo", PASSWORD[1:]), ("", PASSWORD), (None, PASSWORD), ("engine", None)):
        with pytest.raises(ServiceError) as refusal:
            users.get_user(None, name, password)
        assert CODES.BadIdentityTokenRejected == refusal.value.code
    assert users.get_user(None, "engine", PASSWORD).name == "engine"


async def test_node_management_is_not_there(anonymous: Client, engineer: Client, served: Served) -> None:
    before = len(served.server._server.iserver.aspace.keys())
    for client in (anonymous, engineer):
        requests: list[Any] = [
            client.nodes.objects.add_object(2, "Mine"),
            client.nodes.objects.add_variable(2, "Mine", 1.0),
            client.delete_nodes([client.get_node(ENABLE)]),
            client.get_node(ENABLE).add_reference(client.nodes.objects, ua.ObjectIds.Organizes),
            client.uaclient.delete_references([ua.DeleteReferencesItem(SourceNodeId=ENABLE)]),
        ]
        for request in requests:
            with pytest.raises(ua.UaStatusCodeError) as refusal:
                await request
            assert CODES.BadServiceUnsupported == refusal.value.code
    assert before == len(served.server._server.iserver.aspace.keys())


async def test_register_server_is_not_there_even_without_a_session(served: Served) -> None:
    stranger = served.client()
    await stranger.connect_sessionless()
    server = ua.RegisteredServer(ServerUri="urn:stranger", ServerNames=[ua.LocalizedText("stranger")])
    try:
        with pytest.raises(ua.UaStatusCodeError) as refusal:
            await stranger.uaclient.register_server(server)
        assert CODES.BadServiceUnsupported == refusal.value.code
        assert [found.ApplicationUri for found in await stranger.find_servers()] == ["urn:softplc:server"]
    finally:
        await stranger.disconnect_sessionless()


async def test_methods_and_history_are_not_there(engineer: Client) -> None:
    method = ua.CallMethodRequest(ua.NodeId(2253), ua.NodeId(11492), [ua.Variant(1, ua.VariantType.UInt32)])

    (called,) = await engineer.uaclient.call([method])
    with pytest.raises(ua.UaStatusCodeError) as refusal:
        await engineer.get_node("ns=2;s=AxisX.Position").read_raw_history()

    assert CODES.BadNotImplemented == called.StatusCode.value
    assert CODES.BadHistoryOperationUnsupported == refusal.value.code


async def test_triggering_is_not_there(engineer: Client) -> None:
    request = ua.SetTriggeringRequest(Parameters=ua.SetTriggeringParameters(1, 1, [2], []))

    with pytest.raises(ua.UaStatusCodeError) as refusal:
        await engineer.uaclient._send_request(request)

    assert CODES.BadServiceUnsupported == refusal.value.code
