"""The emulated PLC over OPC-UA, on asyncua: one object per axis, string node ids in namespace 2.

```
ns=2;s=Heartbeat                UInt16   +1 each step, rolls over at 65535
ns=2;s=AxisX.Position           Double   measured
ns=2;s=AxisX.TruePosition       Double
ns=2;s=AxisX.TrueVelocity       Double
ns=2;s=AxisX.Count              Int32    measured, as the encoder counts
ns=2;s=AxisX.Contact            Boolean  limit switch, on an axis that bounces
ns=2;s=AxisX.Enable             Boolean  writable
ns=2;s=AxisX.FilteredPosition   Double   writable
ns=2;s=AxisX.FilteredVelocity   Double   writable
ns=2;s=AxisX.EnableIn           Boolean  of the PLC's own AOI, where it runs one: this one and the next three
ns=2;s=AxisX.dt                 Double   ms; Float where the AOI computes in REAL
ns=2;s=AxisX.y                  Double   or Float
ns=2;s=AxisX.y_dot              Double   or Float
```
Values of a step carry its time as source timestamp, and one Read sees one step. Nobody needs to log in;
everybody may write what is writable and nothing else.
"""

import asyncio
import math
from collections.abc import Callable
from datetime import UTC, datetime, timedelta
from typing import Any, Final, NamedTuple

from asyncua import Server, ua
from asyncua.crypto.permission_rules import User, UserRole

from softplc.clock import Clock
from softplc.emulator.bounce import Bounce
from softplc.emulator.memory import MemoryState
from softplc.emulator.plant import PlantStep
from softplc.emulator.program import AoiProgram
from softplc.emulator.scenario import EmulatedAxis, OpcUaEndpoint, Scenario
from softplc.errors import SoftplcError
from softplc.sample import StatusCode
from softplc.units import UNECE_NAMESPACE, per_second, unit

NAMESPACE: Final = "urn:softplc:emulator"
_INDEX: Final = 2
_EPOCH: Final = datetime(1970, 1, 1, tzinfo=UTC)
_DOUBLE: Final = ua.VariantType.Double


class _Node(NamedTuple):
    name: str
    variant: ua.VariantType
    initial: float
    quantity: str | None
    description: str


_HEARTBEAT: Final = _Node("Heartbeat", ua.VariantType.UInt16, 0, None, "+1 each step, rolls over at 65535")
_AXIS_NODES: Final = (
    _Node("Position", _DOUBLE, 0.0, "position", "Measured position"),
    _Node("TruePosition", _DOUBLE, 0.0, "position", "Position without noise"),
    _Node("TrueVelocity", _DOUBLE, 0.0, "velocity", "Velocity without noise"),
    _Node("Count", ua.VariantType.Int32, 0, None, "Measured position in encoder counts"),
    _Node("Enable", ua.VariantType.Boolean, True, None, "Enable of the observer; the plant does not heed it"),
    _Node("FilteredPosition", _DOUBLE, 0.0, "position", "For write-back"),
    _Node("FilteredVelocity", _DOUBLE, 0.0, "velocity", "For write-back"),
)

_CONTACT: Final = _Node("Contact", ua.VariantType.Boolean, False, None, "Limit switch at the stops")


def _aoi_nodes(program: AoiProgram) -> tuple[_Node, ...]:
    number = ua.VariantType.Float if program.precision == "real" else _DOUBLE
    return (
        _Node("EnableIn", ua.VariantType.Boolean, False, None, "EnableIn of the PLC's own AOI in its newest scan"),
        _Node("dt", number, 0.0, None, "Time step of the PLC's own AOI, ms"),
        _Node("y", number, 0.0, "position", "Filtered position of the PLC's own AOI"),
        _Node("y_dot", number, 0.0, "velocity", "Filtered velocity of the PLC's own AOI"),
    )


class _AnonymousOnly:
    """Everybody is the same user, one without rights over the server itself."""

    def get_user(
        self, iserver: Any, username: str | None = None, password: str | None = None, certificate: Any = None
    ) -> User | None:
        return User(role=UserRole.User) if username is None else None


class OpcUaServer:
    """Serves every step that is published, and brings what clients write into the memory."""

    def __init__(self, endpoint: OpcUaEndpoint, scenario: Scenario, memory: MemoryState, clock: Clock) -> None:
        self._endpoint = endpoint
        self._scenario = scenario
        self._clock = clock
        self._server = Server(user_manager=_AnonymousOnly())
        self._writable: list[_Writable] = []
        for index, axis in enumerate(scenario.axes):
            self._writable += [
                _Writable(_node_id(axis.name, "Enable"), ua.VariantType.Boolean, memory.enable, index),
                _Writable(_node_id(axis.name, "FilteredPosition"), _DOUBLE, memory.filtered_position, index),
                _Writable(_node_id(axis.name, "FilteredVelocity"), _DOUBLE, memory.filtered_velocity, index),
            ]

    async def prepare(self) -> None:
        """Build the address space; takes seconds and does not let anything else run meanwhile."""
        server = self._server
        server.name = "softplc emulated PLC"
        server.product_uri = NAMESPACE
        server.manufacturer_name = "softplc"
        await server.init()
        await server.set_application_uri(f"{NAMESPACE}:server")
        server.set_security_policy([ua.SecurityPolicyType.NoSecurity])
        server.set_identity_tokens([ua.AnonymousIdentityToken])
        index = await server.register_namespace(NAMESPACE)
        if index != _INDEX:
            raise SoftplcError(f"opcua: namespace {NAMESPACE} has index {index}, expected {_INDEX}")
        await _add(server.nodes.objects, _HEARTBEAT, "", None)
        for axis in self._scenario.axes:
            await self._add_axis(axis)
        for writable in self._writable:
            await server.get_node(writable.node).set_writable()
            server.set_attribute_value_setter(writable.node, writable.setter(self._clock))

    async def publish(self, step: PlantStep, timestamp: int) -> None:
        """What clients read from now on. `timestamp` is that of the step, ns UTC.

        Nothing in here gives way to other tasks, so that a client cannot read between two nodes of a step.
        """
        await self._write(_id("Heartbeat"), step.number % 65536, ua.VariantType.UInt16, timestamp)
        period_ns = round(self._scenario.period_ms * 1e6)
        for axis, state in zip(self._scenario.axes, step.axes, strict=True):
            measured = timestamp - (step.number - state.measured_in) * period_ns
            await self._write(_node_id(axis.name, "Position"), state.position, _DOUBLE, measured, state.status)
            await self._write(_node_id(axis.name, "Count"), state.count, ua.VariantType.Int32, measured, state.status)
            await self._write(_node_id(axis.name, "TruePosition"), state.true_position, _DOUBLE, timestamp)
            await self._write(_node_id(axis.name, "TrueVelocity"), state.true_velocity, _DOUBLE, timestamp)
            if isinstance(axis.motion, Bounce):
                await self._write(_node_id(axis.name, "Contact"), state.contact, ua.VariantType.Boolean, timestamp)
            if axis.aoi is not None and state.aoi is not None:
                values = (state.aoi.enable_in, state.aoi.dt, state.aoi.y, state.aoi.y_dot)
                for node, value in zip(_aoi_nodes(axis.aoi), values, strict=True):
                    await self._write(_node_id(axis.name, node.name), value, node.variant, timestamp)
        for writable in self._writable:
            if writable.changed_elsewhere():
                await self._write(writable.node, writable.value, writable.variant, timestamp)

    async def listen(self, port: int) -> str:
        """Serve clients from now on, and return the address. Raises SoftplcError when the port is taken."""
        url = f"opc.tcp://{self._endpoint.host}:{port}"
        self._server.set_endpoint(url)
        try:
            await self._server.start()
        except OSError as error:
            raise SoftplcError(f"opcua: cannot listen on {url}: {error.strerror}; choose another port") from error
        return url

    async def close(self) -> None:
        """Drop the clients and stop listening."""
        internal = self._server.iserver
        if internal.time_task is not None:  # asyncua would wait until its clock has ticked once more
            internal.time_task.cancel()
            await asyncio.gather(internal.time_task, return_exceptions=True)
            internal.time_task = None
        await self._server.stop()

    async def _write(
        self, node: ua.NodeId, value: float, variant: ua.VariantType, timestamp: int, status: int = StatusCode.GOOD
    ) -> None:
        when = _EPOCH + timedelta(microseconds=timestamp // 1000)
        await self._server.write_attribute_value(
            node,
            ua.DataValue(
                ua.Variant(value, variant), ua.StatusCode(status), SourceTimestamp=when, ServerTimestamp=when
            ),
        )

    async def _add_axis(self, axis: EmulatedAxis) -> None:
        parent = await self._server.nodes.objects.add_object(_id(axis.name), ua.QualifiedName(axis.name, _INDEX))
        contact = (_CONTACT,) if isinstance(axis.motion, Bounce) else ()
        for node in (*_AXIS_NODES, *contact, *(_aoi_nodes(axis.aoi) if axis.aoi else ())):
            symbol = {"position": axis.unit, "velocity": per_second(axis.unit), None: None}[node.quantity]
            await _add(parent, node, f"{axis.name}.", symbol)


class _Writable:
    """A node that clients may write, and its place in the memory, which the other protocol may write too."""

    def __init__(self, node: ua.NodeId, variant: ua.VariantType, values: list[Any], index: int) -> None:
        self.node = node
        self.variant = variant
        self._values = values
        self._index = index
        self._shown = values[index]

    @property
    def value(self) -> Any:
        """What the memory holds."""
        return self._values[self._index]

    def changed_elsewhere(self) -> bool:
        """True when the memory holds another value than the node shows."""
        both_nan = math.isnan(self.value) and math.isnan(self._shown)
        return self.value != self._shown and not both_nan

    def setter(self, clock: Clock) -> Callable[[Any, ua.AttributeIds, ua.DataValue], None]:
        """What asyncua calls instead of storing a written value, of the right type by then."""

        def take(node: Any, attribute: ua.AttributeIds, value: ua.DataValue) -> None:
            if value.SourceTimestamp is None:  # a client need not send one
                value.SourceTimestamp = _EPOCH + timedelta(microseconds=clock.utc_ns() // 1000)
            node.attributes[attribute].value = value
            if value.Value is not None and value.Value.Value is not None:
                self._values[self._index] = self._shown = value.Value.Value

        return take


async def _add(parent: Any, node: _Node, prefix: str, symbol: str | None) -> None:
    """Add a variable, with its unit as the property EngineeringUnits where it has one."""
    name = prefix + node.name
    variable = await parent.add_variable(_id(name), ua.QualifiedName(node.name, _INDEX), node.initial, node.variant)
    text = ua.DataValue(ua.Variant(ua.LocalizedText(node.description), ua.VariantType.LocalizedText))
    await variable.write_attribute(ua.AttributeIds.Description, text)
    if symbol is not None:
        known = unit(symbol)
        information = ua.EUInformation(
            UNECE_NAMESPACE, known.unit_id, ua.LocalizedText(known.symbol), ua.LocalizedText(known.name)
        )
        await variable.add_property(
            _id(f"{name}.EngineeringUnits"),
            ua.QualifiedName("EngineeringUnits", 0),
            information,
            datatype=ua.NodeId(ua.ObjectIds.EUInformation),
        )


def _id(name: str) -> ua.NodeId:
    return ua.NodeId(name, _INDEX)


def _node_id(axis: str, name: str) -> ua.NodeId:
    return _id(f"{axis}.{name}")
