"""The scenario of an emulated PLC as a model: its axes, what moves them, what spoils their measurement."""

from typing import Annotated, Literal

from pydantic import Field, model_validator

from softplc.emulator.faults import Fault
from softplc.emulator.motion import Motion, RampHold
from softplc.emulator.noise import Noise, UniformNoise
from softplc.emulator.program import AoiProgram
from softplc.model import Model, Name

_RESERVED = "Heartbeat"  # the node beside the axes


class EmulatedAxis(Model):
    """One axis: true motion, and a sensor that measures it with noise, in steps, and with faults."""

    name: Name
    """How its nodes begin, as in AxisX.Position."""
    unit: Annotated[str, Field(max_length=16)] = "mm"
    """Unit of the position; velocity is in unit/s."""
    motion: Motion = RampHold(type="ramp_hold")
    """How it really moves; left out, ramp_hold."""
    noise: Noise = UniformNoise(type="uniform")
    """What the sensor adds to the true position; left out, uniform."""
    quantum: Annotated[float, Field(gt=0)] | None = None
    """Resolution of the sensor, unit: measurements are multiples of it."""
    counts_per_unit: Annotated[float, Field(gt=0)] = 1000.0
    """Count = measured position · counts_per_unit, rounded, as a 32-bit encoder counts; it wraps around."""
    faults: tuple[Fault, ...] = ()
    """What goes wrong with the sensor, and when."""
    aoi: AoiProgram | None = None
    """The PLC runs the AOI on this axis and serves EnableIn, dt, y and y_dot; leave it out for a PLC without."""


class OpcUaEndpoint(Model):
    """The OPC-UA server of the emulated PLC."""

    host: str = "127.0.0.1"
    """Address to listen on; 0.0.0.0 for all."""
    port: Annotated[int, Field(ge=0, le=65535)] = 4841
    """TCP port; 0 takes a free one."""


class ModbusEndpoint(Model):
    """The Modbus TCP server of the emulated PLC; it answers every unit id."""

    host: str = "127.0.0.1"
    """Address to listen on; 0.0.0.0 for all."""
    port: Annotated[int, Field(ge=0, le=65535)] = 5021
    """TCP port; 0 takes a free one."""
    byte_order: Literal["ABCD", "CDAB", "BADC", "DCBA"] = "ABCD"
    """Order of the bytes of values in two registers; ABCD is big-endian, CDAB swaps the words."""


class Scenario(Model):
    """An emulated PLC: axes that move on a fixed time grid, served over OPC-UA, Modbus or both."""

    period_ms: Annotated[float, Field(ge=1, le=60_000)] = 50.0
    """Time between two steps of the plant, ms."""
    seed: Annotated[int, Field(ge=0, le=2**63 - 1)] = 0
    """The same seed gives the same noise and the same faults."""
    axes: Annotated[tuple[EmulatedAxis, ...], Field(min_length=1, max_length=1000)]
    """At least one."""
    opcua: OpcUaEndpoint | None = None
    """Leave it out for no OPC-UA server."""
    modbus: ModbusEndpoint | None = None
    """Leave it out for no Modbus server."""

    @model_validator(mode="after")
    def _consistent(self) -> "Scenario":
        if self.opcua is None and self.modbus is None:
            raise ValueError("found neither opcua nor modbus, expected at least one of them")
        if self.opcua and self.modbus and self.opcua.port == self.modbus.port != 0:
            raise ValueError(f"opcua and modbus both have port {self.opcua.port}, expected two different ports")
        names = [axis.name for axis in self.axes]
        for name in names:
            if name == _RESERVED:
                raise ValueError(f"axes: {name} is the name of the PLC's heartbeat, expected another name")
            if names.count(name) > 1:
                raise ValueError(f"axes: found {name} {names.count(name)} times, expected different names")
        return self

    @property
    def period(self) -> float:
        """Seconds between two steps."""
        return self.period_ms / 1000.0
