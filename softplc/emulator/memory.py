"""What clients may write into the emulated PLC: one memory, whichever protocol they write it with."""

from dataclasses import dataclass, field


@dataclass(slots=True)
class MemoryState:
    """Per axis, in the order of the scenario: enable, and a filtered position and velocity that are written back.

    The plant does not heed them. They are there for an observer to read its enable from and to write its
    results to, as in a PLC program.
    """

    axes: int
    enable: list[bool] = field(init=False)
    filtered_position: list[float] = field(init=False)
    filtered_velocity: list[float] = field(init=False)

    def __post_init__(self) -> None:
        self.enable = [True] * self.axes
        self.filtered_position = [0.0] * self.axes
        self.filtered_velocity = [0.0] * self.axes
