"""Which observers an axis may have: the family's union. A new observer is one file and one name here."""

from softplc.observers.aoi import AoiConfig

ObserverConfig = AoiConfig
