"""From the location of one of pydantic's errors to the place in the file and in the schema."""

import re
from dataclasses import dataclass
from typing import Final

from softplc.config.problem import Key, Path
from softplc.config.schema import CHOICES, SECRET, Fragment, resolved, unit_of
from softplc.config.tree import Hole, Mapping, Node, Scalar, below

_LOGIN: Final = re.compile(r"/[^/\s]*:[^/\s]*@")  # as in opc.tcp://joe:secret@host
SECRET_KEY: Final = re.compile(r"passw|passphrase|pwd|secret|token", re.I)


@dataclass(slots=True)
class Place:
    """Where a location leads. `node` is None for a key that is not there; `parent` is the nearest that is.

    `fragment` is the schema of the value and `around` that of its block; `unit` as the schema states it and
    `axis_unit` what the axis says (None: not known). `secret`: do not show it. `hole`: in a part that was reported.
    """

    node: Node | None
    parent: Node
    path: Path
    fragment: Fragment
    around: Fragment
    unit: str = ""
    axis_unit: str | None = None
    secret: bool = False
    hole: bool = False


def follow(root: Node, top: Fragment, location: tuple[Key, ...]) -> Place:
    """Walk a location down the tree and the schema side by side.

    A location has more steps than the tree: after a tagged union the tag, after another union the name of a branch.
    """
    fragment = resolved(top, top)
    place = Place(root, root, (), fragment, fragment, hole=isinstance(root, Hole))
    for step in location:
        choices = place.fragment.get(CHOICES, {})
        if str(step) in choices:
            place.fragment = resolved(top, choices[str(step)])
        elif "anyOf" in place.fragment:
            break
        else:
            place = _down(place, top, step)
        place.secret = place.secret or bool(place.fragment.get(SECRET))
    return place


def _down(place: Place, top: Fragment, step: Key) -> Place:
    around = place.fragment
    unit, axis_unit, secret = place.unit, place.axis_unit, place.secret
    if isinstance(step, int):
        part: Fragment = around.get("items") or {}
    else:
        known = around.get("properties", {}).get(step)
        part = known or around.get("additionalProperties") or {}
        unit = unit_of(step, part)
        secret = secret or bool(SECRET_KEY.search(step))
        if "unit" in around.get("properties", {}):
            axis_unit = _unit_in(place.node)
    node = below(place.node, step)
    parent = place.node if place.node is not None else place.parent
    secret = secret or (isinstance(node, Scalar) and bool(_LOGIN.search(node.text)))
    hole = place.hole or isinstance(node, Hole)
    path = (*place.path, step)
    return Place(node, parent, path, resolved(top, part), around, unit, axis_unit, secret, hole)


def _unit_in(node: Node | None) -> str | None:
    """What a block says under `unit`; none means dimensionless."""
    if not isinstance(node, Mapping) or "unit" not in node.entries:
        return ""
    unit = node.entries["unit"].value
    return unit.value if isinstance(unit, Scalar) and isinstance(unit.value, str) and len(unit.value) <= 16 else None
