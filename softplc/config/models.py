"""The configuration file as models: tasks, sources, axes, publishers, logging, real-time options."""

from typing import Annotated, Literal

from pydantic import Field, field_validator

from softplc.config.axis import Axis
from softplc.drivers.modbus.config import ModbusSource
from softplc.drivers.opcua.config import OpcUaSource
from softplc.drivers.replay import ReplaySource
from softplc.kernel.compiled import available
from softplc.model import Model, Name
from softplc.publishers.modbus.config import ModbusPublisher
from softplc.publishers.opcua.config import OpcUaPublisher

Source = Annotated[OpcUaSource | ModbusSource | ReplaySource, Field(discriminator="type")]
Publisher = Annotated[OpcUaPublisher | ModbusPublisher, Field(discriminator="type")]


class Task(Model):
    """A cyclic task (IEC 61131-3): its axes are scanned together on a fixed time grid."""

    name: Name = "main"
    """How axes refer to it."""
    period_ms: Annotated[float, Field(ge=1, le=60_000)] = 50.0
    """Time between scans, ms. q_x and q_x_dot are per scan: another period makes another filter."""
    priority: Annotated[int, Field(ge=0, le=31)] = 16
    """Of tasks due at the same instant the lowest number goes first; 0 is the highest priority."""


KernelChoice = Literal["auto", "numpy", "compiled"]


class RealTime(Model):
    """Options of the scan process that may need permission; one that is refused is a warning and nothing more."""

    cpu_affinity: tuple[Annotated[int, Field(ge=0)], ...] | None = None
    """CPUs that the scan process may run on."""
    fifo_priority: Annotated[int, Field(ge=1, le=99)] | None = None
    """SCHED_FIFO with this priority (CAP_SYS_NICE). Bigger goes before more of the machine's other work."""
    lock_memory: bool = False
    """mlockall: no page of the scan process is swapped out (CAP_IPC_LOCK)."""
    gc_freeze: bool = True
    """Take what exists at start out of the garbage collector's sight."""
    kernel: KernelChoice = "auto"
    """How the AOI computes, with the same bits either way. compiled needs the extra of that name and compiles before
    the first scan; auto does so from 10 000 axes in one task, where it is installed."""

    @field_validator("kernel")
    @classmethod
    def _is_installed(cls, kernel: KernelChoice) -> KernelChoice:
        if kernel == "compiled" and not available():
            raise ValueError(
                "compiled needs numba, which is not installed here, expected auto or numpy, "
                "or: pip install 'softplc[compiled]'"
            )
        return kernel


class Log(Model):
    """What is logged and how."""

    level: Literal["debug", "info", "warning", "error"] = "info"
    """The least that is logged."""
    format: Literal["auto", "console", "json"] = "auto"
    """auto: console on a terminal, JSON otherwise."""


class Config(Model):
    """A softplc configuration: sources are read by tasks, axes are observed, publishers serve them."""

    tasks: Annotated[tuple[Task, ...], Field(min_length=1)] = (Task(),)
    """Cyclic tasks; one named main at 50 ms when left out."""
    sources: Annotated[tuple[Source, ...], Field(min_length=1)]
    """Where positions come from: PLCs, devices, recordings."""
    axes: Annotated[tuple[Axis, ...], Field(min_length=1)]
    """The positions that are filtered."""
    publishers: tuple[Publisher, ...] = ()
    """Servers for HMIs and PLCs."""
    realtime: RealTime = RealTime()
    """Options of the scan process that may need permission."""
    log: Log = Log()
    """What is logged and how."""

    def as_json(self) -> str:
        """What the file sets, for another process; defaults are left out, for a model may refuse an unused key."""
        return self.model_dump_json(exclude_unset=True)

    def task_of(self, axis: Axis) -> Task:
        """The task that scans an axis. Raises StopIteration when load() did not check the name."""
        return self.tasks[0] if axis.task is None else next(task for task in self.tasks if task.name == axis.task)
