"""A file of the other kind: an emulated PLC where a configuration belongs, or the other way round."""

from pydantic import BaseModel

from softplc.config.problem import Problem
from softplc.config.tree import Mapping, Node, Sequence


def mistaken(root: Node, model: type[BaseModel]) -> Problem | None:
    """The one thing to say about a file that is of the other kind; its many unknown keys would say less."""
    if not isinstance(root, Mapping):
        return None
    observes, wanted = "sources" in root.entries, "sources" in model.model_fields
    if wanted and not observes and _moves(root):
        text = "this is an emulated PLC, for softplc emulate; expected a configuration: sources, axes, publishers"
    elif observes and not wanted and "axes" in model.model_fields and not _moves(root):
        text = "this is a configuration, for softplc run; expected an emulated PLC: axes with motion, opcua, modbus"
    else:
        return None
    return Problem(1, 1, (), text)


def _moves(root: Mapping) -> bool:
    """Some axis has a motion, which only an emulated one has."""
    axes = root.entries["axes"].value if "axes" in root.entries else None
    items = axes.items if isinstance(axes, Sequence) else ()
    return any(isinstance(axis, Mapping) and "motion" in axis.entries for axis in items)
