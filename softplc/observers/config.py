"""Which observers an axis may have: the family's union. A new observer is one file and one name here."""

from typing import Annotated

from pydantic import Field

from softplc.observers.adaptive import AdaptiveConfig
from softplc.observers.alpha_beta import AlphaBetaConfig
from softplc.observers.aoi import AoiConfig
from softplc.observers.cv_accel import CvAccelConfig
from softplc.observers.derivative import DerivativeConfig
from softplc.observers.ducekf import DucekfConfig
from softplc.observers.fb_kalman import FbKalmanConfig
from softplc.observers.finite_difference import FiniteDifferenceConfig
from softplc.observers.moving_average import MovingAverageConfig
from softplc.observers.one_euro import OneEuroConfig

ObserverConfig = Annotated[
    AdaptiveConfig
    | AlphaBetaConfig
    | AoiConfig
    | CvAccelConfig
    | DerivativeConfig
    | DucekfConfig
    | FbKalmanConfig
    | FiniteDifferenceConfig
    | MovingAverageConfig
    | OneEuroConfig,
    Field(discriminator="type"),
]
