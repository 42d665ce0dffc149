"""The extended Kalman filter with a unilateral constraint: axes that stop or bounce at end stops, and the DHVPO."""

import math
from collections.abc import Mapping, Sequence
from typing import Annotated, Any, ClassVar, Literal, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from softplc.kernel.batch import ducekf as batch
from softplc.kernel.batch.coast import ducekf_coast
from softplc.kernel.batch.dhvpo import DhvpoBatch
from softplc.kernel.batch.end_stops import EndStopsBatch
from softplc.model import Model
from softplc.observers.axes import AxisPlace, require_one_group
from softplc.observers.kernel import Flags, Given, Numbers, StateKernel
from softplc.observers.observer import AxisObserver


class EndStops(Model):
    """An axis of constant velocity between end stops: it stops dead there, or bounces."""

    type: Literal["end_stops"]
    lower: Annotated[float, Field(json_schema_extra={"x-unit": "unit"})] | None = None
    """Position of the lower stop, axis unit; leave it out for none."""
    upper: Annotated[float, Field(json_schema_extra={"x-unit": "unit"})] | None = None
    """Position of the upper stop, axis unit; leave it out for none."""
    restitution: Annotated[float, Field(ge=0, le=10)] = 0.0
    """κ: an impact turns velocity v into −κ·v. 0 stops dead, 1 loses nothing."""

    @model_validator(mode="after")
    def _has_stops(self) -> Self:
        if self.lower is None and self.upper is None:
            raise ValueError("found neither lower nor upper, expected at least one stop")
        if self.lower is not None and self.upper is not None and not self.lower < self.upper:
            raise ValueError(f"lower {self.lower:g} is not below upper {self.upper:g}")
        return self


class Dhvpo(Model):
    """The discrete hybrid Van der Pol oscillator of the paper, which hits a surface at position 0."""

    type: Literal["dhvpo"]
    alpha: Annotated[float, Field(ge=0.001, le=1000)] = 1.0
    """α, damping."""
    mu: Annotated[float, Field(ge=0.001, le=1000)] = 1.0
    """μ, frequency, 1/s."""
    rho: Annotated[float, Field(ge=0.001, le=1000)] = 1.5
    """ρ, radius of the oscillation, axis unit."""
    restitution: Annotated[float, Field(ge=0, le=10)] = 0.5
    """κ: an impact turns velocity v into −κ·v."""
    band_reading: Literal["above", "below"] = "above"
    """The paper's activation set lost its sign in print: above reads it (0, band], below [−band, 0)."""


class DucekfConfig(Model):
    """The filter with its model and tuning. Variances are per update, in the axis' unit (`unit: mm` makes mm)."""

    type: Literal["ducekf"]
    model: Annotated[EndStops | Dhvpo, Field(discriminator="type")]
    """What moves between impacts, and where they happen."""
    q_x: Annotated[float, Field(ge=0, json_schema_extra={"x-unit": "unit²"})] = 0.001
    """Process noise added to the position variance in each scan, unit². Bigger follows faster and smooths less."""
    q_x_dot: Annotated[float, Field(ge=0, json_schema_extra={"x-unit": "(unit/s)²"})] = 0.1
    """Process noise added to the velocity variance in each scan, (unit/s)². Bigger: velocity adapts faster."""
    r_x: Annotated[float, Field(gt=0, json_schema_extra={"x-unit": "unit²"})]
    """Measurement noise variance of each sample, unit². Bigger smooths more and lags more."""
    p_x_dot: Annotated[float, Field(gt=0, json_schema_extra={"x-unit": "(unit/s)²"})] = 10.0
    """Variance of the velocity at a start, (unit/s)². Bigger finds the speed of a moving axis sooner."""
    impact_covariance: Literal["omega", "saltation", "none"] = "saltation"
    """What an impact does to the covariance: saltation stays consistent, omega is the paper's, none its EKF's."""
    contact_from: Literal["tag", "position", "either"] = "tag"
    """How an impact is known: the axis' contact tag closes, its position says so, or whichever comes first."""
    contact_above: float = 0.5
    """A contact tag above this is closed: leave it for a Boolean, give the threshold for a force."""
    band: Annotated[float, Field(gt=0, json_schema_extra={"x-unit": "unit"})] | None = None
    """Width of the activation band at a stop, axis unit; left out it is 4·√r_x. Above the noise of the position."""
    hysteresis: Annotated[float, Field(ge=0, json_schema_extra={"x-unit": "unit"})] | None = None
    """How far beyond the band a position has to go before it may report the next contact; left out as the band."""
    hold_limit_ms: Annotated[float, Field(gt=0, le=3_600_000)] = 500.0
    """Longest wait for the contact of an estimate that is at the stop first; then the filter starts anew, ms."""

    @model_validator(mode="after")
    def _omega_exists(self) -> Self:
        if self.impact_covariance == "omega" and self.model.restitution == 0:
            raise ValueError(
                "impact_covariance omega divides by the restitution, which is 0, expected saltation or none"
            )
        return self

    tuning_fields: ClassVar[Mapping[str, str]] = {"Restitution": "model.restitution"}

    @property
    def group_key(self) -> tuple[Any, ...]:
        """Axes of one task whose configurations have the same key are stepped by one observer."""
        edge = self.model.band_reading if isinstance(self.model, Dhvpo) else "above"
        return (self.type, self.model.type, edge, self.impact_covariance, self.contact_from)

    @property
    def needs_contact(self) -> bool:
        """The axis must have a contact tag."""
        return self.contact_from != "position"

    @property
    def estimates(self) -> tuple[str, ...]:
        """Leaves beside Position and Velocity."""
        return ("Innovation", "S", "K0", "K1", "P00", "P01", "P11", "NIS", "Impacts", "Contact")

    @property
    def tuning(self) -> tuple[str, ...]:
        """Leaves of the tuning; a stop that the axis does not have has none."""
        stops: tuple[str, ...] = ()
        if isinstance(self.model, EndStops):
            lower, upper = self.model.lower is not None, self.model.upper is not None
            stops = ("LowerStop",) * lower + ("UpperStop",) * upper
        return ("q_x", "q_x_dot", "r_x", "Band", "Restitution", *stops)

    @property
    def limits(self) -> Mapping[str, tuple[float, float]]:
        """Limits of written values that are narrower than usual: omega divides by the restitution."""
        return {"Restitution": (0.001, 10.0)} if self.impact_covariance == "omega" else {}

    @staticmethod
    def build(places: Sequence[AxisPlace], configs: Sequence["DucekfConfig"]) -> AxisObserver:
        """One observer that steps all these axes; `configs` has one entry for each place.

        Raises ValueError when the configurations differ in their `group_key`, or the axes' blocks in their tags.
        """
        require_one_group(places, configs)
        return AxisObserver(places, np.float64, DucekfKernel(configs))


class DucekfKernel(StateKernel):
    """The filter of n axes with the same kind of model and the same choices."""

    def __init__(self, configs: Sequence[DucekfConfig]) -> None:
        first, bands = configs[0], [config.band or 4.0 * math.sqrt(config.r_x) for config in configs]
        dhvpo = isinstance(first.model, Dhvpo)
        self._model = _model([config.model for config in configs])
        self._tuning = batch.DucekfBatchTuning(
            q_x=[config.q_x for config in configs],
            q_x_dot=[config.q_x_dot for config in configs],
            r_x=[config.r_x for config in configs],
            band=bands,
            hysteresis=[
                band if config.hysteresis is None else config.hysteresis
                for config, band in zip(configs, bands, strict=True)
            ],
            threshold=[config.contact_above for config in configs],
            hold_limit=[config.hold_limit_ms / 1000.0 for config in configs],
            p_x=[config.r_x for config in configs],  # a start is one measurement
            p_x_dot=[config.p_x_dot for config in configs],
            covariance=first.impact_covariance,
            contact_from=first.contact_from,
            impact_scan="replace" if dhvpo else "within",
            edge=first.model.band_reading if isinstance(first.model, Dhvpo) else "above",
        )
        tuning, model = self._tuning, self._model
        tuned: dict[str, Numbers] = {
            "q_x": tuning.q_x,
            "q_x_dot": tuning.q_x_dot,
            "r_x": tuning.r_x,
            "Band": tuning.band,
            "Restitution": model.kappa,
        }
        if isinstance(model, EndStopsBatch):
            stops = {"LowerStop": model.lower, "UpperStop": model.upper}
            tuned |= {leaf: stops[leaf] for leaf in first.tuning if leaf in stops}
        self._state = state = batch.DucekfBatchState(len(configs))
        estimates = {
            "Innovation": state.y_res,
            "S": state.S,
            "K0": state.K0,
            "K1": state.K1,
            "P00": state.P00,
            "P01": state.P01,
            "P11": state.P11,
            "Impacts": state.impacts,
            "Contact": state.touching,
        }
        super().__init__(state, estimates, tuned)

    def step(self, given: Given) -> NDArray[np.uint8]:
        """One scan."""
        return batch.step(
            self._state,
            self._tuning,
            self._model,
            EnableIn=given.enable,
            x=given.z,
            dt=given.dt,
            rows=given.rows,
            contact=given.contact,
        )

    def coast(self, dt: NDArray[np.float64], rows: Flags) -> bool:
        """The smooth branch with its covariance, (3) and (4), up to the stop."""
        ducekf_coast(self._state, self._tuning, self._model, dt, rows)
        return True

    def predict(self, dt: NDArray[np.float64]) -> tuple[Numbers, Numbers]:
        """The smooth branch, (3), up to the stop: what happens there is for the next sample to say."""
        x1, x2 = self._model.f(self._state.y, self._state.y_dot, dt)
        limit, side = self._model.surface(x1)
        return np.where(side * (x1 - limit) < 0.0, limit, x1), x2


def _model(models: Sequence[EndStops | Dhvpo]) -> EndStopsBatch | DhvpoBatch:
    stops = [model for model in models if isinstance(model, EndStops)]
    kappa = [model.restitution for model in models]
    if stops:
        return EndStopsBatch(
            kappa=kappa,
            lower=[-math.inf if model.lower is None else model.lower for model in stops],
            upper=[math.inf if model.upper is None else model.upper for model in stops],
        )
    oscillators = [model for model in models if isinstance(model, Dhvpo)]
    return DhvpoBatch(
        alpha=[model.alpha for model in oscillators],
        mu=[model.mu for model in oscillators],
        rho=[model.rho for model in oscillators],
        kappa=kappa,
    )
