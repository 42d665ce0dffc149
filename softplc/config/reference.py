"""The reference of every key, as Markdown made from the schema; `python -m softplc.config.reference` writes it.

That command, run in the project's folder, renews the tables of docs/configuration.md and docs/emulator.md, and
config/softplc.schema.json.
"""

import json
import sys
from pathlib import Path
from typing import Any, Final

from pydantic import BaseModel

from softplc.config import schema as schemas
from softplc.config import words
from softplc.config.models import Config
from softplc.config.schema import CHOICES, UNIT, Fragment, resolved
from softplc.config.schema_templates import FOR_DESCRIPTION, LISTS
from softplc.emulator.scenario import Scenario

PAGES: Final[dict[Path, type[BaseModel]]] = {
    Path("docs/configuration.md"): Config,
    Path("docs/emulator.md"): Scenario,
}
SCHEMA_FILE: Final = Path("config/softplc.schema.json")
_BEGIN: Final = "<!-- made by python -m softplc.config.reference: begin -->\n"
_END: Final = "<!-- made by python -m softplc.config.reference: end -->\n"
_KEY_OF_TAG: Final = {"OpcUaTag": "node", "ModbusTag": "address", "ReplayTag": "column"}


def reference(model: type[BaseModel] = Config) -> str:
    """A section for each block of the file: heading, description, table of its keys."""
    top = schemas.schema(model)
    headings = _headings(top)
    sections = [_section(top, headings, "The file", top), _templates(top)]
    sections += [_section(top, headings, heading, top["$defs"][name]) for name, heading in headings.items()]
    return "\n".join(sections)


def renewed(page: str, model: type[BaseModel] = Config) -> str:
    """The page with its tables made anew."""
    before, _, rest = page.partition(_BEGIN)
    _, _, after = rest.partition(_END)
    return f"{before}{_BEGIN}\n{reference(model)}\n{_END}{after}"


def _templates(top: Fragment) -> str:
    """The section about `for`, which no block has as a key of its own."""
    lists = ["[].".join(path) for path in LISTS if path[0] in top["properties"]]
    named = ", ".join(f"`{name}[]`" for name in lists)
    return "\n".join(
        [
            "### `for`",
            "",
            f"A key of any entry of {named}.",
            "",
            "| key | what | default | meaning |",
            "|---|---|---|---|",
            "| `for` | a range as in `1..100` or `0..98 step 2`, a list, names with either, a table as in `tags.csv` "
            f"| none | {FOR_DESCRIPTION} |",
            "",
        ]
    )


def _headings(top: Fragment) -> dict[str, str]:
    """Where each block first stands in the file, in the order of the file."""
    found: dict[str, str] = {}

    def visit(fragment: Fragment, path: str) -> None:
        for name, inner, suffix in _blocks(top, fragment):
            if name not in found:
                found[name] = f"`{path}{'[]' if 'items' in resolved_list(fragment) else ''}`{suffix}"
                for key, field in inner.get("properties", {}).items():
                    visit(field, f"{path}{'[]' if 'items' in resolved_list(fragment) else ''}.{key}")

    def resolved_list(fragment: Fragment) -> Fragment:
        return resolved(top, fragment)

    for key, field in top["properties"].items():
        visit(field, key)
    return found


def _blocks(top: Fragment, fragment: Fragment) -> list[tuple[str, Fragment, str]]:
    """Name, schema and a word about its kind of each block that a field may hold, or its list."""
    parts = [part for part in fragment.get("anyOf", [fragment]) if part.get("type") != "null"]
    if len(parts) == 1 and "items" in parts[0]:
        parts = [parts[0]["items"]]
    if len(parts) == 1 and CHOICES in parts[0]:
        parts = list(parts[0][CHOICES].values())
    blocks = []
    for part in parts:
        if "$ref" in part:
            name = part["$ref"].rpartition("/")[2]
            inner = top["$defs"][name]
            blocks.append((name, inner, _suffix(name, inner)))
    return blocks


def _suffix(name: str, block: Fragment) -> str:
    if name in _KEY_OF_TAG:
        return f" with `{_KEY_OF_TAG[name]}`"
    kind = block["properties"].get("type", {}).get("const")
    return f" with `type: {kind}`" if kind else ""


def _section(top: Fragment, headings: dict[str, str], heading: str, block: Fragment) -> str:
    lines = [f"### {heading}", "", *block["description"].split("\n"), ""]
    lines += ["| key | what | default | meaning |", "|---|---|---|---|"]
    required = block.get("required", ())
    for key, field in block["properties"].items():
        default = "**required**" if key in required else _default(field.get("default"))
        meaning = field.get("description") or resolved(top, field).get("description", "")
        meaning = " ".join(meaning.split()).replace("|", "\\|")
        lines.append(f"| `{key}` | {_what(top, headings, field)} | {default} | {meaning} |")
    return "\n".join([*lines, ""])


def _what(top: Fragment, headings: dict[str, str], field: Fragment) -> str:
    """What a key may hold; a block by a link to its section."""
    blocks = _blocks(top, field)
    if not blocks:
        fragment = resolved(top, field)
        return words.expected(top, fragment, str(field.get(UNIT, ""))).replace("|", "\\|")
    links = [f"[{headings[name].replace('`', '')}](#{_anchor(headings[name])})" for name, _, _ in blocks]
    simple = ["true or false"] if any(part.get("type") == "boolean" for part in field.get("oneOf", ())) else []
    listed = "list of " if "items" in resolved(top, field) else ""
    return listed + " or ".join([*simple, *links])


def _anchor(heading: str) -> str:
    """The anchor that GitHub and most others give a heading."""
    kept = (letter for letter in heading.lower() if letter.isalnum() or letter in " -_")
    return "".join(kept).replace(" ", "-")


def _default(value: Any) -> str:
    if value is None or value == []:
        return "none"
    if isinstance(value, list | dict):
        return "as below"
    if isinstance(value, float):
        return f"`{words.figure(value)}`"
    return f"`{value}`" if isinstance(value, str) and value else f"`{json.dumps(value)}`"


if __name__ == "__main__":
    for page, model in PAGES.items():
        page.write_text(renewed(page.read_text(encoding="utf-8"), model), encoding="utf-8")
    SCHEMA_FILE.write_text(schemas.text(), encoding="utf-8")
    sys.stderr.write(f"{', '.join(map(str, PAGES))} and {SCHEMA_FILE} are written\n")
