"""A tree against a model: every error of pydantic at its place in the file and in our own words.

pydantic finds the errors; their words come from the model's schema. A mistyped key or type whose meaning is plain
is reported, then taken as it was meant, so that what it holds is looked at as well.
"""

import json
from collections.abc import Iterator
from typing import Any, Final, TypeVar

from pydantic import BaseModel, ValidationError

from softplc.config import words
from softplc.config.expand import Expansion
from softplc.config.mend import Mend, misspelt_key, misspelt_word
from softplc.config.place import Place, follow
from softplc.config.problem import LONG, Problem, shown
from softplc.config.schema import CHOICES, EXPECTED, SECRET, Fragment, resolved, schema
from softplc.config.tree import Mapping, Node, Scalar, Sequence, plain

_ROUNDS: Final = 8  # each mends at least one key; deeper nests of mistyped keys than this are not looked into
M = TypeVar("M", bound=BaseModel)
Judged = tuple[Problem, Mend | None]


def validate(root: Node, model: type[M], expansion: Expansion | None = None) -> tuple[M | None, list[Problem]]:
    """The model, or None and everything that is wrong. May mend mistyped keys in the tree; they stay reported.

    Of errors that all instances of a template have, the first one alone is reported, and all are mended.
    """
    kept: list[Problem] = []
    mended: set[Any] = set()
    context = {} if expansion is None else {"folder": expansion.folder}
    for _ in range(_ROUNDS):
        made, errors = _parse(root, model, context)
        judged: list[Judged] = []
        alike: list[Judged] = []
        seen = set(mended)
        for error in errors:
            place = follow(root, schema(model), error["loc"])
            key = None if expansion is None else _same(place, error["type"], expansion)
            if key is None or key not in seen:
                found = list(_judge(root, schema(model), error, place))
                judged += found
                seen.add(key)
                if any(mend is not None for _, mend in found):
                    mended.add(key)
            elif key in mended:
                alike += _judge(root, schema(model), error, place)
        mends = [(problem, mend) for problem, mend in judged if mend is not None]
        if not mends:
            return (None if kept else made), kept + [problem for problem, _ in judged]
        for problem, mend in mends:
            kept.append(problem)
            mend()
        for _, also in alike:
            if also is not None:
                also()
    return None, kept


def _parse(root: Node, model: type[M], context: dict[str, Any]) -> tuple[M | None, list[Any]]:
    try:
        return model.model_validate_json(json.dumps(plain(root)), context=context), []
    except ValidationError as error:
        return None, list(error.errors(include_url=False, include_input=False))


def _same(place: Place, kind: str, expansion: Expansion) -> Any:
    """What the same error in other instances of a template has in common; None for a value of this instance alone."""
    path, template, _ = expansion.origin(place.path)
    node = place.node or place.parent
    if template is None or expansion.cell(place.path, place.node) is not None:
        return None
    return id(template), path, kind, node.line, node.column


def _judge(root: Node, top: Fragment, error: Any, place: Place) -> Iterator[Judged]:
    """The problems behind one of pydantic's errors, each with a way to mend it where its meaning is plain."""
    kind = error["type"]
    node, fragment = place.node, place.fragment
    if kind == "extra_forbidden":
        yield _unknown_key(top, place)
    elif place.hole:
        return
    elif kind == "missing" and isinstance(place.parent, Mapping):
        if not place.parent.partial:
            yield _problem(place, f"missing, expected {_expected(top, place)}"), None
    elif kind == "missing":
        yield _wrong_value(top, follow(root, top, error["loc"][:-1])), None
    elif kind == "too_short" and isinstance(node, Sequence) and _long_enough(node, fragment):
        return  # pydantic counts the valid entries alone
    elif CHOICES in fragment and isinstance(node, Mapping):
        yield from _unknown_member(top, place, node)
    elif kind in ("value_error", "assertion_error"):
        text = shown(str(error["ctx"]["error"]), LONG)
        quotes_a_login = place.secret and "@" in text
        yield _wrong_value(top, place) if quotes_a_login else _problem(place, text), None
    elif isinstance(node, Scalar) and ("enum" in fragment or "const" in fragment):
        yield misspelt_word(node, place.path, words.values(fragment), fragment.get(EXPECTED))
    elif not (isinstance(node, Mapping | Sequence) and node.partial):
        yield _wrong_value(top, place), None


def _problem(place: Place, text: str) -> Problem:
    """At the value, or at the block that should hold it."""
    node = place.node or place.parent
    return Problem(node.line, node.column, place.path, text)


def _long_enough(node: Sequence, fragment: Fragment) -> bool:
    return node.partial or len(node.items) >= fragment.get("minItems", 0)


def _unknown_key(top: Fragment, place: Place) -> Judged:
    key = str(place.path[-1])
    if isinstance(place.parent, Mapping) and key in place.parent.entries:
        known = place.around.get("properties", {})
        homes = [name for name, part in known.items() if key in _keys_within(top, part)]
        return misspelt_key(place.parent, key, place.path, list(known), homes[0] if len(homes) == 1 else None)
    return _problem(place, "unknown key"), None


def _keys_within(top: Fragment, fragment: Fragment) -> list[str]:
    """The keys of the block that this key of a block may have; of several kinds of blocks none."""
    blocks = [resolved(top, part) for part in resolved(top, fragment).get("anyOf", [fragment])]
    blocks = [block for block in blocks if block.get("type") == "object"]
    return list(blocks[0].get("properties", ())) if len(blocks) == 1 else []


def _unknown_member(top: Fragment, place: Place, node: Mapping) -> Iterator[Judged]:
    """A block of which nothing tells what it is: the key that tells it is wrong, mistyped or missing."""
    choices = place.fragment[CHOICES]
    telling = place.fragment.get("discriminator", {}).get("propertyName")
    if telling in node.entries:
        path, value = (*place.path, telling), node.entries[telling].value
        if isinstance(value, Scalar):
            yield misspelt_word(value, path, list(choices))
        else:
            yield (
                Problem(
                    value.line, value.column, path, f"found {words.found(value)}, expected {words.choice(choices)}"
                ),
                None,
            )
        return
    known = words.keys_of(top, choices.values())
    strange = [key for key in node.entries if key not in known]
    mends = [misspelt_key(node, key, (*place.path, key), known) for key in strange]
    if any(mend is not None for _, mend in mends):
        yield from mends
    elif not node.partial:
        yield from mends
        if telling is not None:
            yield (
                Problem(node.line, node.column, (*place.path, telling), f"missing, expected {words.choice(choices)}"),
                None,
            )
        else:
            listed = ", ".join(shown(key) for key in list(node.entries)[:8])
            found = f"the keys {listed}" if listed else words.found(node)
            yield _problem(place, f"found {found}, expected {_expected(top, place)}"), None


def _expected(top: Fragment, place: Place) -> str:
    return words.expected(top, place.fragment, words.axis_unit(place.unit, place.axis_unit))


def _wrong_value(top: Fragment, place: Place) -> Problem:
    expected = _expected(top, place)
    empty = isinstance(place.node, Scalar) and place.node.value is None
    if place.secret and not empty:
        if place.fragment.get(SECRET):
            expected += "; a secret never stands in this file"
        return _problem(place, f"found a value that is not shown here, expected {expected}")
    key = next((step for step in reversed(place.path) if isinstance(step, str)), "")
    kind = None if "pattern" in place.fragment else place.fragment.get("type")
    if any(choice.get("type") == "boolean" for choice in place.fragment.get(CHOICES, {}).values()):
        kind = "boolean"
    hint = words.hint(place.node, kind, key) or words.unquoted_placeholder(place.node)
    if empty and "default" in place.fragment:
        hint = "; leave the key out for its default"
    return _problem(place, f"found {words.found(place.node)}, expected {expected}{hint}")
