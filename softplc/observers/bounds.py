"""What a written tuning value may be: whatever the configuration would accept for the same field."""

import math
import sys
from collections.abc import Iterator, Mapping
from typing import Any, Final, get_args

from pydantic import BaseModel
from pydantic.fields import FieldInfo

Bounds = tuple[float, float]
_MOST: Final = sys.float_info.max
_LEAST: Final = sys.float_info.min
_MILLI: Final = 0.001


def bounds_of(observer: object, leaf: str) -> Bounds | None:
    """The least and the greatest value that the field behind this leaf takes, both allowed; None where it has none.

    A leaf is named as its field, or the model's `tuning_fields` says where it is, as in `bleed.factor`. A field in
    milliseconds, `…_ms`, has its leaf in seconds.
    """
    if not isinstance(observer, BaseModel):
        return None
    path: Mapping[str, str] = getattr(observer, "tuning_fields", {})
    *above, name = path.get(leaf, leaf).split(".")
    model = type(observer)
    for part in above:
        model = _model_of(observer, model, part)
        observer = getattr(observer, part, None)
    field = model.model_fields.get(name)
    if field is None:
        return None
    low, high = -_MOST, _MOST
    for bound in _constraints(field):
        for kind, value in _stated(bound):
            if kind in ("ge", "gt"):
                low = max(low, value if kind == "ge" else _just_above(value))
            else:
                high = min(high, value if kind == "le" else math.nextafter(value, -math.inf))
    if name.endswith("_ms"):
        low, high = max(low * _MILLI, _LEAST) if low > 0.0 else low * _MILLI, high * _MILLI
    return low, high


def _model_of(observer: object, model: type[BaseModel], name: str) -> type[BaseModel]:
    """The model that a field holds, or would hold if it were not left out."""
    held = getattr(observer, name, None)
    if isinstance(held, BaseModel):
        return type(held)
    models = [one for one in get_args(model.model_fields[name].annotation) if isinstance(one, type)]
    return next(one for one in models if issubclass(one, BaseModel))


def _constraints(field: FieldInfo) -> Iterator[Any]:
    """The constraints of a field, of an optional one as well: `Annotated[float, …] | None`."""
    yield from field.metadata
    for part in (field.annotation, *get_args(field.annotation)):
        for note in getattr(part, "__metadata__", ()):
            yield from note.metadata if isinstance(note, FieldInfo) else (note,)


def _stated(bound: Any) -> Iterator[tuple[str, float]]:
    for kind in ("ge", "gt", "le", "lt"):
        value = getattr(bound, kind, None)
        if value is not None:
            yield kind, float(value)


def _just_above(value: float) -> float:
    """The least normal number above a bound that is itself not allowed."""
    return _LEAST if value == 0.0 else math.nextafter(value, math.inf)
