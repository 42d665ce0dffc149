"""The shipped schema with templates: an entry with `for` may have a placeholder wherever a value stands."""

from typing import Any, Final

FOR: Final = "for"
LISTS: Final = (("tasks",), ("sources",), ("axes",), ("publishers", "placements"))
"""The lists whose entries may be templates."""

Fragment = dict[str, Any]

FOR_DESCRIPTION: Final = (
    "Makes this entry a template: one entry for each number of a range, each value of a list, each combination of "
    "several, or each row of a table. {i}, the names given here, the table's columns, and {n}, which counts from 0, "
    "stand for the instance's values."
)
_RANGE: Final = {"type": "string", "pattern": r"^\s*-?[0-9]+\s*\.\.\s*-?[0-9]+(\s+step\s+[0-9]+)?\s*$"}
_LIST: Final = {"type": "array", "items": {"type": ["string", "number", "boolean"]}, "minItems": 1}
_NAMES: Final = {
    "type": "object",
    "propertyNames": {"pattern": "^[A-Za-z_][A-Za-z0-9_]*$"},
    "additionalProperties": {"anyOf": [_RANGE, _LIST]},
    "minProperties": 1,
}
_TABLE: Final = {"type": "string", "pattern": r"\.[cC][sS][vV]$"}
FOR_SCHEMA: Final = {"title": FOR, "description": FOR_DESCRIPTION, "anyOf": [_RANGE, _TABLE, _LIST, _NAMES]}
_PLACEHOLDER: Final = {"type": "string", "pattern": r"\{.+\}"}
_ABOUT: Final = ("title", "description", "default", "x-unit")


def with_templates(schema: Fragment) -> Fragment:
    """The schema of a model in which every list that takes templates does so."""
    made = {**schema, "properties": dict(schema["properties"]), "$defs": dict(schema["$defs"])}
    for top, *rest in LISTS:
        if top not in made["properties"]:
            continue
        if not rest:
            made["properties"][top] = _list(made, made["properties"][top])
            continue
        for name, definition in list(made["$defs"].items()):
            if rest[0] in definition.get("properties", {}):
                field = _list(made, definition["properties"][rest[0]])
                made["$defs"][name] = {**definition, "properties": {**definition["properties"], rest[0]: field}}
    return made


def _list(top: Fragment, field: Fragment) -> Fragment:
    """A list whose entries may be templates."""
    items = field["items"]
    members = items.get("oneOf", [items])
    names = [member["$ref"].rpartition("/")[2] for member in members]
    templates = [{"$ref": f"#/$defs/{_template(top, name)}"} for name in names]
    then = templates[0] if len(templates) == 1 else {"anyOf": templates}
    return {**field, "items": {"if": {"type": "object", "required": [FOR]}, "then": then, "else": items}}


def _template(top: Fragment, name: str) -> str:
    filled = top["$defs"][_filled(top, name)]
    made = {**filled, "properties": {FOR: FOR_SCHEMA, **filled["properties"]}}
    made["required"] = [FOR, *filled.get("required", ())]
    made["title"] = f"{name}Template"
    top["$defs"][made["title"]] = made
    return str(made["title"])


def _filled(top: Fragment, name: str) -> str:
    """The definition of a block in which placeholders may stand; its name."""
    own = f"{name}Filled"
    if own not in top["$defs"]:
        top["$defs"][own] = {}  # so that a block within itself ends
        top["$defs"][own] = {**_loose(top, top["$defs"][name]), "title": own}
    return own


def _loose(top: Fragment, fragment: Fragment) -> Fragment:
    """A fragment with placeholders for its values; a word that tells what a block is stays as it is."""
    if "$ref" in fragment:
        return {**fragment, "$ref": f"#/$defs/{_filled(top, fragment['$ref'].rpartition('/')[2])}"}
    made = {key: value for key, value in fragment.items() if key != "discriminator"}
    if "properties" in made:
        made["properties"] = {key: _loose(top, value) for key, value in made["properties"].items()}
        return made
    choices = made.pop("anyOf", None) or made.pop("oneOf", None)
    if choices is not None:
        return {**made, "anyOf": [_loose(top, choice) for choice in choices]}
    if "items" in made and isinstance(made["items"], dict):
        return {**made, "items": _loose(top, made["items"])}
    if "const" in made or made.get("type") in ("object", "array", "null"):
        return made
    about: Fragment = {key: made.pop(key) for key in _ABOUT if key in made}
    return {**about, "anyOf": [made, _PLACEHOLDER]}
