"""Tags of every data type, and snapshots of them."""

from collections.abc import Sequence

import numpy as np

from softplc.publishers.opcua.values import TagValues
from softplc.snapshot import Snapshot
from softplc.tags import DataType, Tag, TagTable

TYPES = tuple(DataType)
Sampled = tuple[DataType, float, int, int]
"""Data type, value, status, source timestamp in ns UTC."""


def served(samples: Sequence[Sampled], server: int) -> TagValues:
    """What is served of a snapshot with these samples, taken at `server` ns UTC."""
    table = TagTable()
    table.add_block("x", "axis", [Tag(f"X.t{n}é", data_type=sample[0]) for n, sample in enumerate(samples)])
    table.close_section("main")
    values = TagValues(table, server)
    columns = [np.array([sample[field] for sample in samples]) for field in (1, 2, 3)]
    values.take(
        Snapshot(
            1, columns[0].astype(float), columns[1].astype(np.uint32), columns[2].astype(np.int64), (None,), (True,)
        ),
        server,
    )
    return values
