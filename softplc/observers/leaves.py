"""The catalogue of an axis' tags: what each last name part means, in which unit, on every observer that has it.

An observer names the leaves that it fills; the same name means the same thing everywhere. Units are written for an
axis of unit u: "u/s" is mm/s where the axis is in mm.
"""

import math
import sys
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Final

from softplc.tags import DataType
from softplc.units import per_second, squared


@dataclass(frozen=True, slots=True)
class Leaf:
    """One tag that an axis may have.

    `limits` are those of a value that is written to a tuning tag on any observer, both allowed; the observer's own
    configuration may narrow them. Without limits its value is fixed when the observer is built, and nobody writes it.
    """

    name: str
    unit: str
    description: str
    data_type: DataType = DataType.DOUBLE
    limits: tuple[float, float] | None = None

    def unit_of(self, axis_unit: str) -> str:
        """The unit's symbol for an axis in this unit. Raises KeyError for a pattern that is not known."""
        return _UNITS[self.unit](axis_unit)


_UNITS: Final[Mapping[str, Callable[[str], str]]] = {
    "": lambda _: "",
    "s": lambda _: "s",
    "1/s": lambda _: "1/s",
    "1/s2": lambda _: "1/s2",
    "Hz": lambda _: "Hz",
    "u": lambda u: u,
    "u2": squared,
    "u/s": per_second,
    "u/s2": lambda u: f"{u}/s2" if u else "1/s2",
    "u2/s": lambda u: f"{squared(u) or 1}/s",
    "u2/s2": lambda u: f"{squared(u) or 1}/s2",
    "u2/s3": lambda u: f"{squared(u) or 1}/s3",
    "u2/s4": lambda u: f"{squared(u) or 1}/s4",
    "u2/s5": lambda u: f"{squared(u) or 1}/s5",
    "u2.s": lambda u: f"{squared(u)}.s" if u else "s",
    "(u/s)2": lambda u: squared(per_second(u)),
    "(u/s2)2": lambda u: f"({u}/s2)2" if u else "1/s4",
    "1/u": lambda u: f"1/{u}" if u else "",
}

_OUTPUTS: Final = (
    Leaf("Position", "u", "Filtered position"),
    Leaf("Velocity", "u/s", "Filtered velocity"),
)
_INPUTS: Final = (Leaf("Raw", "u", "Position as read from the source"),)
_ESTIMATES: Final = (
    Leaf("Innovation", "u", "Measurement minus predicted position, y"),
    Leaf("S", "u2", "Innovation variance"),
    Leaf("K0", "", "Kalman gain for the position"),
    Leaf("K1", "1/s", "Kalman gain for the velocity"),
    Leaf("P00", "u2", "Variance of the position estimate"),
    Leaf("P01", "u2/s", "Covariance of position and velocity estimates"),
    Leaf("P11", "(u/s)2", "Variance of the velocity estimate"),
    Leaf("Acceleration", "u/s2", "Estimated acceleration"),
    Leaf("K2", "1/s2", "Kalman gain for the acceleration"),
    Leaf("P02", "u2/s2", "Covariance of position and acceleration estimates"),
    Leaf("P12", "u2/s3", "Covariance of velocity and acceleration estimates"),
    Leaf("P22", "(u/s2)2", "Variance of the acceleration estimate"),
    Leaf("HoldProbability", "", "How probable it is that the axis is at rest"),
    Leaf("CruiseProbability", "", "How probable it is that the axis moves at constant speed"),
    Leaf("ManoeuvreProbability", "", "How probable it is that the axis accelerates"),
    Leaf("Cutoff", "Hz", "Cutoff frequency of the low pass in this scan"),
    Leaf("NIS", "", "Normalised innovation squared, y²/S; its mean is 1 when the tuning is consistent"),
    Leaf("Impacts", "", "Impacts at the stops since the start of the service", DataType.UINT32),
    Leaf("Contact", "", "The axis touches its stop", DataType.BOOLEAN),
    Leaf("MinEigenvalue", "", "Smallest eigenvalue of P, not below 0 in a valid covariance"),
    Leaf("CovarianceValid", "", "P is finite and has no negative eigenvalue", DataType.BOOLEAN),
    Leaf("Dt", "s", "Time step that the observer used in this scan"),
)
_NOW: Final = (
    Leaf("PositionNow", "u", "Position carried on to now, by Horizon"),
    Leaf("VelocityNow", "u/s", "Velocity carried on to now, by Horizon"),
    Leaf("Horizon", "s", "How far PositionNow and VelocityNow are carried on: age of the sample and dead time"),
)
_STATE: Final = (
    Leaf("Age", "s", "Time since the newest sample arrived"),
    Leaf("Skipped", "", "Scans without a usable sample or time step while enabled", DataType.UINT32),
    Leaf("Rejected", "", "Samples that the innovation gate rejected", DataType.UINT32),
    Leaf("State", "", "What the outputs are made of: 1 when the observer follows its input", DataType.UINT16),
    Leaf("Quality", "", "0 Bad, 1 Uncertain, 2 Good", DataType.UINT16),
    Leaf("Reason", "", "Why the outputs are not Good; 0 when they are", DataType.UINT16),
    Leaf("Enabled", "", "The observer runs", DataType.BOOLEAN),
    Leaf("WriteState", "", "The worst of the axis' write-backs: 1 when all is written", DataType.UINT16),
    Leaf("Consistency", "", "1 when the tuning fits; other numbers say what is wrong with it", DataType.UINT16),
)
_COMMANDS: Final = (
    Leaf("Enable", "", "Command: run the observer", DataType.BOOLEAN),
    Leaf("Reset", "", "Command: on its rising edge the observer starts anew with the next sample", DataType.BOOLEAN),
)
_CONSTANTS: Final = (
    Leaf("NISLow", "", "95 % of consistent windows have a mean NIS from here to NISHigh"),
    Leaf("NISHigh", "", "95 % of consistent windows have a mean NIS from NISLow to here"),
    Leaf("AutocorrelationLimit", "", "95 % of consistent windows have a smaller AutocorrelationMax"),
)
_JUDGED: Final = (
    Leaf("NISMean", "", "Mean of NIS over the window"),
    Leaf("Autocorrelation", "", "Autocorrelation of the innovations at lag 1, over the window"),
    Leaf("AutocorrelationMax", "", "Largest autocorrelation of the innovations by amount, over all lags"),
    Leaf("Outside", "", "Fraction of the window's innovations outside ±2√S; 0.0455 when consistent"),
    Leaf("PositionDelta", "u", "Position minus the PLC's own y, in the newest scan that stepped"),
    Leaf("VelocityDelta", "u/s", "Velocity minus the PLC's own y_dot, in the newest scan that stepped"),
    Leaf("PositionDeltaMax", "u", "Largest PositionDelta by amount since start, enable or reset"),
    Leaf("VelocityDeltaMax", "u/s", "Largest VelocityDelta by amount since start, enable or reset"),
)
_FROM_ZERO: Final = (0.0, sys.float_info.max)
_ABOVE_ZERO: Final = (sys.float_info.min, sys.float_info.max)
_FACTOR: Final = (sys.float_info.min, math.nextafter(1.0, 0.0))
_YES_NO: Final = (0.0, 1.0)
_COUNT: Final = (0.0, 65535.0)
_TUNING: Final = (
    Leaf("q_x", "u2", "Process noise of the position, per scan", limits=_FROM_ZERO),
    Leaf("q_x_dot", "(u/s)2", "Process noise of the velocity, per scan", limits=_FROM_ZERO),
    Leaf("r_x", "u2", "Measurement noise, per sample", limits=_ABOVE_ZERO),
    Leaf("BleedEnable", "", "Velocity damping near rest", DataType.BOOLEAN, _YES_NO),
    Leaf("BleedThresh", "u", "Deviation below which the velocity bleeds", limits=_FROM_ZERO),
    Leaf("BleedFactor", "", "What the velocity is multiplied by in each such scan", limits=_FACTOR),
    Leaf("Q", "(u/s)2", "Process noise of the velocity, per scan", limits=_FROM_ZERO),
    Leaf("R", "u2", "Measurement noise, per sample", limits=_ABOVE_ZERO),
    Leaf("q_x_ddot", "(u/s2)2", "Process noise of the acceleration, per scan", limits=_FROM_ZERO),
    Leaf("q_jerk", "u2/s5", "Spectral density of the white jerk", limits=_FROM_ZERO),
    Leaf("min_r", "u2", "Least measurement noise that is used, per sample", limits=_ABOVE_ZERO),
    Leaf("GateSigma", "", "Innovation beyond so many times √S is rejected", limits=_ABOVE_ZERO),
    Leaf(
        "GateMost",
        "",
        "So many rejected samples in a row; the next one starts the observer anew",
        DataType.UINT16,
        limits=_COUNT,
    ),
    Leaf(
        "BleedOn",
        "",
        "Deviation that the threshold is for: 0 after the correction, 1 innovation",
        DataType.UINT16,
        limits=_YES_NO,
    ),
    Leaf("BleedVelocity", "u/s", "Speed below which the velocity may bleed", limits=_ABOVE_ZERO),
    Leaf("Band", "u", "Width of the activation band at a stop"),
    Leaf("Restitution", "", "What an impact leaves of the speed, reversed", limits=_FROM_ZERO),
    Leaf("LowerStop", "u", "Position of the lower stop"),
    Leaf("UpperStop", "u", "Position of the upper stop"),
    Leaf("top_speed", "u/s", "Speed at which the machine travels", limits=_ABOVE_ZERO),
    Leaf("top_acceleration", "u/s2", "Acceleration with which the machine gets there", limits=_ABOVE_ZERO),
    Leaf("window", "", "Samples that are averaged", DataType.UINT16, limits=_COUNT),
    Leaf("cycle", "s", "Sampling period that the block believes in", limits=_ABOVE_ZERO),
    Leaf("alpha", "", "Gain for the position, α", limits=_ABOVE_ZERO),
    Leaf("beta", "", "Gain for the velocity times Δt, β", limits=_ABOVE_ZERO),
    Leaf("sigma_w", "u/s2", "Standard deviation of the acceleration", limits=_ABOVE_ZERO),
    Leaf("sigma_v", "u", "Standard deviation of the measurement", limits=_ABOVE_ZERO),
    Leaf("min_cutoff", "Hz", "Cutoff frequency at rest", limits=_ABOVE_ZERO),
    Leaf("cutoff_slope", "1/u", "Rise of the cutoff with the speed, the paper's β", limits=_FROM_ZERO),
    Leaf("d_cutoff", "Hz", "Cutoff frequency of the velocity", limits=_ABOVE_ZERO),
)

_ALL: Final = (*_OUTPUTS, *_INPUTS, *_ESTIMATES, *_NOW, *_JUDGED, *_STATE, *_COMMANDS, *_CONSTANTS, *_TUNING)
LEAVES: Final = {leaf.name: leaf for leaf in _ALL}
"""Every leaf by its name."""
COMMANDS: Final = tuple(leaf.name for leaf in _COMMANDS)
"""Leaves that a client may write to make the observer do something."""
STATE: Final = (*(leaf.name for leaf in _STATE), *COMMANDS)
"""Leaves that are always Good: they say how the axis is, not what it estimates."""
CONSTANTS: Final = tuple(leaf.name for leaf in _CONSTANTS)
"""Leaves that never change."""
JUDGED: Final = tuple(leaf.name for leaf in _JUDGED)
"""Leaves that carry a status of their own: they compare the estimates, over time or with somebody else's."""
NOW: Final = tuple(leaf.name for leaf in _NOW)
"""Leaves of an axis with a dead time: the estimate carried on to now."""
ESTIMATES: Final = tuple(leaf.name for leaf in (*_OUTPUTS, *_ESTIMATES, *_NOW))
"""Leaves that carry the status of the estimate, on some observer or other."""
ALWAYS_WRITTEN: Final = ("Quality", "State")
"""Leaves that are written back however the axis is, because they say so."""
WRITE_BACK: Final = (*ESTIMATES, *JUDGED, "Consistency", *ALWAYS_WRITTEN)
"""Leaves that may be written back into a source, where the axis has them."""
