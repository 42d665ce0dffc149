"""The emulated PLC over Modbus TCP, on pymodbus's simulated device; `modbus_map` says what is where.

Clients read whole steps: the device takes the newest registers over at the beginning of a request, and a
request is answered without a pause. It answers one request of a connection at a time; one that is sent before
the last was answered may be lost (pymodbus 3.16).
"""

from typing import Final

from pymodbus.constants import ExcCodes
from pymodbus.server import ModbusTcpServer
from pymodbus.simulator import DataType, SimData, SimDevice

from softplc.emulator import modbus_map
from softplc.emulator.memory import MemoryState
from softplc.emulator.plant import PlantStep
from softplc.emulator.scenario import ModbusEndpoint, Scenario
from softplc.errors import SoftplcError

_ANY_UNIT: Final = 0
_COILS: Final = (1, 5, 15)
_DISCRETE: Final = (2,)
_INPUT: Final = (4,)


class ModbusServer:
    """Serves every step that is published, and brings what clients write into the memory."""

    def __init__(self, endpoint: ModbusEndpoint, scenario: Scenario, memory: MemoryState) -> None:
        self._endpoint = endpoint
        self._scenario = scenario
        self._memory = memory
        self._registers: list[int] = []
        self._contacts: list[int] = []  # sixteen in a word
        self._server: ModbusTcpServer | None = None

    async def prepare(self) -> None:
        """Nothing is slow here."""

    async def publish(self, step: PlantStep, timestamp: int) -> None:
        """What clients read from now on; Modbus has no place for the timestamp."""
        self._registers = modbus_map.registers(step, self._memory, self._endpoint.byte_order)
        self._contacts = _words([axis.contact for axis in step.axes])

    async def listen(self, port: int) -> str:
        """Serve clients from now on, and return the address. Raises SoftplcError when the port is taken."""
        host = self._endpoint.host
        device = SimDevice(_ANY_UNIT, _layout(self._memory.axes), action=self._on_request)
        self._server = ModbusTcpServer(device, address=(host, port))
        try:
            await self._server.serve_forever(background=True)
        except RuntimeError as error:  # pymodbus has no other for a port that cannot be bound
            raise SoftplcError(f"modbus: cannot listen on {host}:{port}; choose another port") from error
        return f"tcp://{host}:{port}"

    async def close(self) -> None:
        """Drop the clients and stop listening."""
        if self._server is not None:
            await self._server.shutdown()

    async def _on_request(
        self,
        function: int,
        start: int,
        address: int,
        count: int,
        current: list[int],
        written: list[int] | list[bool] | None,
    ) -> ExcCodes | None:
        """Called by the device before a request is answered; `current` is what it will read from.

        The device has refused what does not exist or is read-only.
        """
        if function in _DISCRETE:
            contacts = modbus_map.CONTACTS_AT // 16
            current[contacts : contacts + len(self._contacts)] = self._contacts
        if function in _COILS or function in _DISCRETE:
            if written is not None and address + len(written) > self._memory.axes:
                return ExcCodes.ILLEGAL_ADDRESS
            if written is not None:
                self._memory.enable[address : address + len(written)] = [bool(bit) for bit in written]
            packed = _words(self._memory.enable)
            current[: len(packed)] = packed
            return None
        if written is not None:
            self._registers[address : address + count] = [int(word) for word in written]
            modbus_map.take(self._registers, address, count, self._memory, self._endpoint.byte_order)
        current[: len(self._registers)] = self._registers
        return None


def _words(bits: list[bool]) -> list[int]:
    """Sixteen bits in each word, the first is the lowest."""
    return [
        sum(1 << position for position, bit in enumerate(bits[first : first + 16]) if bit)
        for first in range(0, len(bits), 16)
    ]


def _layout(axes: int) -> tuple[list[SimData], list[SimData], list[SimData], list[SimData]]:
    """Which addresses exist and which are writable: coils, discrete inputs, holding and input registers."""

    def registers(at: int, count: int, *, readonly: bool) -> SimData:
        return SimData(at, count=count, values=0, datatype=DataType.REGISTERS, readonly=readonly)

    holding = [registers(0, modbus_map.HEADER, readonly=True)]
    input_ = [registers(0, modbus_map.HEADER, readonly=True)]
    for index in range(axes):
        at, writable = modbus_map.axis_at(index), modbus_map.WRITABLE
        holding += [
            registers(at, writable.start, readonly=True),
            registers(at + writable.start, len(writable), readonly=False),
            registers(at + writable.stop, modbus_map.STRIDE - writable.stop, readonly=True),
        ]
        input_.append(registers(at, modbus_map.STRIDE, readonly=True))
    bits = SimData(0, values=[True] * axes, datatype=DataType.BITS)
    contacts = SimData(modbus_map.CONTACTS_AT, values=[False] * axes, datatype=DataType.BITS)
    return [bits], [bits, contacts], holding, input_
