"""Is a softplc scanning? Ask its own server for the heartbeat twice, as any client would."""

import asyncio
import struct
from collections.abc import AsyncIterator

from softplc.config.models import Config
from softplc.errors import ConfigError
from softplc.publishers.modbus.config import ModbusPublisher
from softplc.publishers.opcua.config import APPLICATION_URI, OpcUaPublisher

_HEARTBEAT_REGISTER = 7
_LOOK = 0.1  # seconds between two looks


def check_health(config: Config | None, timeout: float) -> str:
    """An empty text when the heartbeat moves within `timeout` seconds, otherwise what is wrong.

    Without a configuration the Modbus server's default port is asked.
    """
    publishers = config.publishers if config is not None else (ModbusPublisher(type="modbus"),)
    for publisher in sorted(publishers, key=lambda publisher: publisher.type):  # Modbus first: it is asked faster
        host = "127.0.0.1" if publisher.host in ("0.0.0.0", "::") else publisher.host
        if isinstance(publisher, ModbusPublisher):
            where = f"Modbus server {host}:{publisher.port}"
            return asyncio.run(_judge(_modbus_heartbeats(host, publisher.port, publisher.unit_id), timeout, where))
        if isinstance(publisher, OpcUaPublisher) and config is not None:
            where = f"OPC-UA server {host}:{publisher.port}"
            beats = _opcua_heartbeats(host, publisher, config.tasks[0].name)
            return asyncio.run(_judge(beats, timeout, where))
    return "the configuration has no publisher that could be asked"


async def _judge(heartbeats: AsyncIterator[int], timeout: float, where: str) -> str:
    seen = set()
    try:
        async with asyncio.timeout(timeout):
            async for heartbeat in heartbeats:
                seen.add(heartbeat)
                if len(seen) > 1:
                    return ""
    except TimeoutError:
        return f"{where}: the heartbeat does not move" if seen else f"{where}: no answer within {timeout:g} s"
    except (OSError, EOFError, struct.error) as error:
        return f"{where}: {error or 'connection closed'}"
    return f"{where}: no heartbeat to be read"


async def _modbus_heartbeats(host: str, port: int, unit_id: int) -> AsyncIterator[int]:
    reader, writer = await asyncio.open_connection(host, port)
    try:
        while True:
            writer.write(struct.pack(">HHHBBHH", 1, 0, 6, unit_id, 4, _HEARTBEAT_REGISTER, 1))
            reply = await reader.readexactly(11)
            yield struct.unpack(">H", reply[9:])[0]
            await asyncio.sleep(_LOOK)
    finally:
        writer.close()


async def _opcua_heartbeats(host: str, publisher: OpcUaPublisher, task: str) -> AsyncIterator[int]:
    """Heartbeats of a task; from a secured server as the one client that it always trusts, itself."""
    from asyncua import Client, ua  # noqa: PLC0415  takes seconds to import
    from asyncua.crypto.security_policies import SecurityPolicyBasic256Sha256  # noqa: PLC0415

    client = Client(f"opc.tcp://{host}:{publisher.port}")
    try:
        if publisher.security is not None:
            from softplc.certificates import read_pair  # noqa: PLC0415  only where there is one

            own, key = read_pair(publisher.security.certificate, publisher.security.private_key)
            client.application_uri = APPLICATION_URI
            client.security_policy = SecurityPolicyBasic256Sha256(own, own, key, ua.MessageSecurityMode.Sign)
            client.uaclient.set_security(client.security_policy)
        async with client:
            node = client.get_node(f"ns=2;s=Tasks.{task}.Heartbeat")
            while True:
                value = await node.read_data_value(raise_on_bad_status=False)
                if value.StatusCode is not None and value.StatusCode.is_good() and value.Value is not None:
                    yield int(value.Value.Value)
                await asyncio.sleep(_LOOK)
    except (ua.UaError, ConfigError) as error:
        raise OSError(str(error)) from error
