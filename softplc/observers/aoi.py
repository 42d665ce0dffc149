"""The Logix AOI: two-state constant-velocity Kalman observer with scalar arithmetic, batch over axes."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Annotated, ClassVar, Final, Literal, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from softplc.kernel.batch import aoi as batch
from softplc.kernel.batch.aoi_options import AoiBatchOptions
from softplc.kernel.batch.coast import aoi_coast
from softplc.kernel.reference.aoi_options import AoiOptions
from softplc.model import Model
from softplc.observers.aoi_options import Bleed, GainLimits, Gate, Positive
from softplc.observers.axes import AxisPlace, require_one_group
from softplc.observers.kernel import Flags, Given, Numbers, StateKernel
from softplc.observers.leaves import LEAVES, Leaf
from softplc.observers.observer import AxisObserver

OFF: Final = AoiOptions()
Exponent = Annotated[int, Field(ge=0, le=3)]
_EXPONENTS: Final = "two whole numbers from 0 to 3, of q_x and of q_x_dot, as in [1, 1]"
_REFERENCE: Final = "first_sample, or a number"
_TUNING: Final = ("q_x", "q_x_dot", "r_x", "BleedEnable", "BleedThresh", "BleedFactor")


class AoiConfig(Model):
    """The AOI's observer with its tuning. Variances are per update, in the axis' unit (`unit: mm` makes mm)."""

    type: Literal["aoi"]
    precision: Literal["lreal", "real"] = "lreal"
    """lreal: float64. real: every operation rounded to float32, as a Logix REAL computes."""
    q_x: Annotated[float, Field(ge=0, json_schema_extra={"x-unit": "unit²"})] = 0.001
    """Process noise added to the position variance in each scan, unit². Bigger follows faster and smooths less."""
    q_x_dot: Annotated[float, Field(ge=0, json_schema_extra={"x-unit": "(unit/s)²"})] = 0.1
    """Process noise added to the velocity variance in each scan, (unit/s)². Bigger: velocity adapts faster."""
    r_x: Annotated[float, Field(gt=0, json_schema_extra={"x-unit": "unit²"})]
    """Measurement noise variance of each sample, unit². Bigger smooths more and lags more."""
    bleed: Bleed | None = None
    """Velocity damping near rest; leave it out for none."""
    q_mode: Literal["per_scan", "dt", "white_accel"] = "per_scan"
    """Process noise: q per scan; q·Δt (q_x in unit²/s, q_x_dot in unit²/s³); or that of white acceleration."""
    q_exponents: Annotated[tuple[Exponent, Exponent], Field(json_schema_extra={"x-expected": _EXPONENTS})] | None = (
        None
    )
    """Powers of Δt for q_x and for q_x_dot in place of q_mode: [1, 1] is dt, [2, 1] takes q_x by Δt²."""
    r_mode: Literal["per_sample", "density"] = "per_sample"
    """Measurement noise: r_x per sample, or r_x/Δt (r_x in unit²·s), which does not hang on the period."""
    min_r: Annotated[Positive | None, Field(json_schema_extra={"x-unit": "unit²"})] = None
    """Least measurement noise that is used, per sample, whatever r_x says. Bigger smooths at least so much."""
    joseph: bool = False
    """Correct the covariance in the Joseph form, which rounding and gains that are not optimal do not spoil."""
    gain_limits: GainLimits | None = None
    """Bounds for the gains; with joseph: true."""
    gate: Gate | None = None
    """Innovation gate that rejects outliers; leave it out for none."""
    on_s_not_positive: Literal["keep", "reinitialise"] = "keep"
    """S ≤ 0: predict on for good, as the AOI's own text does, or start anew on that sample."""
    skipped_time: Literal["accumulate", "lose"] = "accumulate"
    """Time of scans without a usable sample: add it to the next step, or lose it as the AOI's own text does."""
    reference: Annotated[
        Literal["first_sample"] | float | None, Field(json_schema_extra={"x-expected": _REFERENCE, "x-unit": "unit"})
    ] = None
    """Position that is taken off before rounding and added again after; for large positions in real."""

    @model_validator(mode="after")
    def _fits_the_precision(self) -> Self:
        if self.precision == "real":
            tiny, most = float(np.finfo(np.float32).tiny), float(np.finfo(np.float32).max)
            for name, least in (("q_x", 0.0), ("q_x_dot", 0.0), ("r_x", tiny), ("min_r", tiny)):
                value = getattr(self, name)
                if value is not None and not least <= value <= most:
                    raise ValueError(f"{name} {value:g} does not fit a REAL, expected {least:.3g} to {most:.3g}")
        return self

    @model_validator(mode="after")
    def _options_fit_each_other(self) -> Self:
        if self.q_exponents is not None and self.q_mode != "per_scan":
            raise ValueError(f"q_exponents with q_mode: {self.q_mode}, expected one of them")
        if self.gain_limits is not None and not self.joseph:
            raise ValueError(
                "gain_limits without joseph: true, expected both: the plain form holds for no other gain"
            )
        return self

    @property
    def options(self) -> AoiOptions:
        """The options as the kernel takes them."""
        bleed, gate = self.bleed, self.gate
        K0_limits, K1_limits = self.gain_limits.pairs() if self.gain_limits else (OFF.K0_limits, OFF.K1_limits)
        return AoiOptions(
            joseph=self.joseph,
            min_r=OFF.min_r if self.min_r is None else self.min_r,
            K0_limits=K0_limits,
            K1_limits=K1_limits,
            q_exponents=self._exponents,
            white_accel=self.q_mode == "white_accel",
            r_density=self.r_mode == "density",
            bleed_on_innovation=bleed is not None and bleed.bleed_on == "innovation",
            bleed_velocity=bleed.velocity_limit if bleed else None,
            gate=gate.sigma if gate else None,
            gate_most=gate.most_in_a_row if gate else 0,
            reinitialise=self.on_s_not_positive == "reinitialise",
            reference=self.reference,
        )

    @property
    def _exponents(self) -> tuple[int, int]:
        return self.q_exponents or ((1, 1) if self.q_mode == "dt" else (0, 0))

    tuning_fields: ClassVar[Mapping[str, str]] = {
        "GateSigma": "gate.sigma",
        "GateMost": "gate.most_in_a_row",
        "BleedThresh": "bleed.threshold",
        "BleedFactor": "bleed.factor",
        "BleedVelocity": "bleed.velocity_limit",
    }

    @property
    def group_key(self) -> tuple[str, ...]:
        """Axes of one task whose configurations have the same key are stepped by one observer.

        Those without options are on their own: their step is the shorter one.
        """
        return (self.type, self.precision) if self.options == OFF else (self.type, self.precision, "options")

    @property
    def estimates(self) -> tuple[str, ...]:
        """Leaves beside Position and Velocity."""
        return ("Innovation", "S", "K0", "K1", "P00", "P01", "P11", "NIS", *(("Rejected",) if self.gate else ()))

    @property
    def tuning(self) -> tuple[str, ...]:
        """Leaves of the tuning, named as the AOI names its inputs; those of options where they are in use."""
        bleed, options = self.bleed, self.options
        optional = (
            ("min_r", self.min_r is not None),
            ("GateSigma", self.gate is not None),
            ("GateMost", self.gate is not None),
            ("BleedOn", bleed is not None and options.bleed_on_innovation),
            ("BleedVelocity", options.bleed_velocity is not None),
        )
        return (*_TUNING, *(leaf for leaf, used in optional if used))

    @property
    def variants(self) -> Mapping[str, Leaf]:
        """Tuning leaves that the modes give another unit and meaning."""
        a, b = (1, 1) if self.q_mode == "white_accel" else self._exponents
        chosen = {
            "q_x": ("Process noise of the position", ("u2", "u2/s", "u2/s2", "u2/s3")[a]),
            "q_x_dot": ("Process noise of the velocity", ("(u/s)2", "u2/s3", "u2/s4", "u2/s5")[b]),
            "r_x": ("Measurement noise, as a density", "u2.s" if self.r_mode == "density" else "u2"),
        }
        return {
            name: replace(LEAVES[name], unit=unit, description=description)
            for name, (description, unit) in chosen.items()
            if unit != LEAVES[name].unit
        }

    @property
    def remarks(self) -> tuple[str, ...]:
        """What works, but not as one would wish, in words."""
        if self.bleed is None or self.bleed.bleed_gate != "residual":
            return ()
        return (
            "bleed also acts on a well-tracked ramp and makes its velocity read low; "
            "bleed_gate: velocity leaves moving axes alone",
        )

    @staticmethod
    def build(
        places: Sequence[AxisPlace], configs: Sequence["AoiConfig"], step: batch.Step = batch.step
    ) -> AxisObserver:
        """One observer that steps all these axes; `configs` has one entry for each place. `step` may be compiled.

        Raises ValueError when the configurations differ in their `group_key`, or the axes' blocks in their tags.
        """
        require_one_group(places, configs)
        kernel = AoiKernel(configs, step)
        return AxisObserver(places, kernel.dtype, kernel)


class AoiKernel(StateKernel):
    """The AOI of n axes of the same precision."""

    def __init__(self, configs: Sequence[AoiConfig], step: batch.Step = batch.step) -> None:
        self._step = step
        self.dtype = np.dtype(np.float32 if configs[0].precision == "real" else np.float64)
        bleeds = [config.bleed for config in configs]
        chosen = [config.options for config in configs]
        options = None if all(one == OFF for one in chosen) else AoiBatchOptions(self.dtype, chosen)
        self._tuning = batch.AoiTuning(
            self.dtype,
            q_x=[config.q_x for config in configs],
            q_x_dot=[config.q_x_dot for config in configs],
            r_x=[config.r_x for config in configs],
            BleedEnable=[bleed is not None for bleed in bleeds],
            BleedThresh=[bleed.threshold if bleed else 0.0 for bleed in bleeds],
            BleedFactor=[bleed.factor if bleed else 1.0 for bleed in bleeds],
            options=options,
        )
        self._state = state = batch.AoiBatchState(len(configs), self.dtype)
        self._absolute = np.zeros(len(configs)) if any(one.reference is not None for one in chosen) else None
        self._position: Numbers = state.y if self._absolute is None else self._absolute
        self._dt_ms = np.zeros(len(configs))
        estimates = {
            "Position": self._position,
            "Innovation": state.y_res,
            "S": state.S,
            "K0": state.K0,
            "K1": state.K1,
            "P00": state.P0,
            "P01": state.P1,
            "P11": state.P3,
        }
        if "Rejected" in configs[0].estimates:
            estimates["Rejected"] = state.rejected
        tuned = {leaf: getattr(self._tuning, leaf) for leaf in _TUNING}
        if options is not None:
            tuned |= {
                "min_r": options.min_r,
                "GateSigma": options.gate,
                "GateMost": options.gate_most,
                "BleedOn": options.bleed_on_innovation,
                "BleedVelocity": options.bleed_velocity,
            }
        super().__init__(state, estimates, {leaf: tuned[leaf] for leaf in configs[0].tuning})

    def step(self, given: Given) -> NDArray[np.uint8]:
        """One scan; the AOI takes its time step in milliseconds."""
        state = self._state
        np.multiply(given.dt, 1000.0, out=self._dt_ms)
        results = self._step(state, self._tuning, EnableIn=given.enable, x=given.z, dt=self._dt_ms, rows=given.rows)
        if self._absolute is not None:
            np.add(state.offset, state.y, out=self._absolute)
        return results

    def shift(self, rows: Flags, by: NDArray[np.float64]) -> None:
        """The origin of these axes moves; what their positions are relative to stays."""
        super().shift(rows, by)
        if self._absolute is not None:
            np.add(self._state.offset, self._state.y, out=self._absolute, where=rows)

    def coast(self, dt: NDArray[np.float64], rows: Flags) -> bool:
        """Equations (2) to (12)."""
        aoi_coast(self._state, self._tuning, dt * 1000.0, rows)
        if self._absolute is not None:
            np.copyto(self._absolute, self._state.offset + self._state.y, where=rows)
        return True

    def predict(self, dt: NDArray[np.float64]) -> tuple[Numbers, Numbers]:
        """Equations (2) and (3)."""
        return self._position + self._state.y_dot * dt, self._state.y_dot
