"""The JSON Schema of a model: for editors (`softplc schema`), for error texts and for the reference page.

It is valid as draft 2020-12 and means the same as draft-07, which yaml-language-server reads.
"""

import json
from functools import cache
from typing import Any, Final

from pydantic import BaseModel
from pydantic.json_schema import GenerateJsonSchema, JsonSchemaValue
from pydantic_core import core_schema

from softplc.config.models import Config
from softplc.config.schema_templates import with_templates

Fragment = dict[str, Any]
"""A part of a schema: the keywords of one value."""

# Keywords of our own. Models set x-unit (as in `ms`, `unit²`), x-expected (a pattern in words) and x-secret.
UNIT: Final = "x-unit"
EXPECTED: Final = "x-expected"
SECRET: Final = "x-secret"
CHOICES: Final = "x-choices"
_INTERNAL: Final = (EXPECTED, CHOICES, SECRET)
_SUFFIX_UNITS: Final = {"_ms": "ms", "_s": "s"}


class _Generator(GenerateJsonSchema):
    """pydantic's schema with the members of every tagged union by tag, and pairs of equals as plain lists."""

    def tagged_union_schema(self, schema: core_schema.TaggedUnionSchema) -> JsonSchemaValue:
        made = super().tagged_union_schema(schema)
        made[CHOICES] = {str(tag): self.generate_inner(member) for tag, member in schema["choices"].items()}
        if "custom_error_message" in schema:
            made[EXPECTED] = schema["custom_error_message"]
        return made

    def tuple_schema(self, schema: core_schema.TupleSchema) -> JsonSchemaValue:
        made = super().tuple_schema(schema)
        first, *others = made.get("prefixItems", [None])
        if first is not None and all(other == first for other in others):
            del made["prefixItems"]
            made["items"] = first
        return made

    def get_title_from_name(self, name: str) -> str:
        return name


@cache
def schema(model: type[BaseModel]) -> Fragment:
    """The schema with our own keywords. Do not change it: it is shared."""
    made = model.model_json_schema(schema_generator=_Generator)
    for definition in [made, *made.get("$defs", {}).values()]:
        for key, field in definition.get("properties", {}).items():
            unit = unit_of(key, field)
            if unit:
                field["title"] = f"{key}, {unit}"
                field[UNIT] = unit
    return made


def unit_of(key: str, field: Fragment) -> str:
    """Unit of a key: as its model says, or as the end of its name says; empty for none."""
    named = next((unit for suffix, unit in _SUFFIX_UNITS.items() if key.endswith(suffix)), "")
    return str(field.get(UNIT, named))


def resolved(root: Fragment, fragment: Fragment) -> Fragment:
    """The fragment without `$ref` and without the choice of null; keywords beside a reference win."""
    while True:
        if "$ref" in fragment:
            target = root["$defs"][fragment["$ref"].rpartition("/")[2]]
            fragment = {**target, **{key: value for key, value in fragment.items() if key != "$ref"}}
            continue
        choices = [choice for choice in fragment.get("anyOf", ()) if choice.get("type") != "null"]
        if len(choices) != 1:
            return fragment
        fragment = {**choices[0], **{key: value for key, value in fragment.items() if key != "anyOf"}}


def json_schema(model: type[BaseModel] = Config) -> Fragment:
    """The schema as it is shipped: without what only the error texts need."""

    def strip(part: Any) -> Any:
        if isinstance(part, dict):
            return {key: strip(value) for key, value in part.items() if key not in _INTERNAL}
        return [strip(item) for item in part] if isinstance(part, list) else part

    made = strip(schema(model))
    return {"$schema": "https://json-schema.org/draft/2020-12/schema", **with_templates(made)}


def text(model: type[BaseModel] = Config) -> str:
    """The shipped file's content, `config/softplc.schema.json`."""
    return json.dumps(json_schema(model), indent=2, ensure_ascii=False) + "\n"
