"""Which observers an axis may have: the family's union. A new observer is one file and one name here."""

from typing import Annotated

from pydantic import Field

from softplc.observers.aoi import AoiConfig
from softplc.observers.fb_kalman import FbKalmanConfig

ObserverConfig = Annotated[AoiConfig | FbKalmanConfig, Field(discriminator="type")]
