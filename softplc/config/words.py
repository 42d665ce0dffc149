"""What a value may be, in words made from its schema, and how a value that was found is shown."""

from collections.abc import Iterable
from difflib import SequenceMatcher
from typing import Final

from softplc.config.problem import shown
from softplc.config.scalars import resolve
from softplc.config.schema import CHOICES, EXPECTED, SECRET, Fragment, resolved
from softplc.config.tree import Mapping, Node, Scalar, Sequence

NEAR: Final = 0.65  # similarity from which a name is worth a guess
MOST_LISTED: Final = 20
SURE: Final = 0.75  # similarity from which the guess is taken to go on with
_SYNONYMS: Final = {
    "slave": "unit_id",
    "slave_id": "unit_id",
    "device_id": "unit_id",
    "word_order": "byte_order",
    "ip": "host",
    "hostname": "host",
    "endpoint": "url",
    "node_id": "node",
    "nodeid": "node",
    "register": "address",
    "username": "name",
    "period": "period_ms",
    "cycle_ms": "period_ms",
    "baud": "baudrate",
    "filter": "observer",
    "kalman": "aoi",
    "imm": "adaptive",
    "kappa": "restitution",
    "user": "users",
}
_YES_NO: Final = {"yes": "true", "on": "true", "no": "false", "off": "false"}


def expected(root: Fragment, fragment: Fragment, unit: str = "") -> str:
    """What a value of this fragment may be, as in `a number from 1 to 60000 ms`. `unit` as people write it."""
    fragment = resolved(root, fragment)
    if fragment.get(SECRET):
        return "{env: NAME} or {file: PATH}, where the secret is to be found"
    if EXPECTED in fragment:
        return str(fragment[EXPECTED])
    if "enum" in fragment or "const" in fragment:
        return choice(values(fragment))
    if CHOICES in fragment:
        return f"a block of keys; type is {choice(fragment[CHOICES])}"
    return _by_type(root, fragment, unit)


def _by_type(root: Fragment, fragment: Fragment, unit: str) -> str:
    match fragment.get("type"):
        case "number" | "integer":
            return _number(fragment, unit)
        case "array":
            return _list(root, fragment, unit)
        case "object":
            keys = fragment.get("required") or list(fragment.get("properties", ()))
            return f"a block with the keys {', '.join(keys)}" if keys else "a block of keys"
        case "string":
            most = f" of at most {fragment['maxLength']} characters" if "maxLength" in fragment else ""
            return f"a text{most}{' that is not empty' if fragment.get('minLength') else ''}"
        case "boolean":
            return "true or false"
        case _:
            parts = [expected(root, part, unit) for part in fragment.get("anyOf", ())]
            return " or ".join(dict.fromkeys(parts)) or "another value"


def values(fragment: Fragment) -> list[str]:
    """The words that an enumeration allows, as they are written."""
    allowed = fragment.get("enum") or [fragment["const"]]
    return [str(value).lower() if isinstance(value, bool) else str(value) for value in allowed]


def keys_of(root: Fragment, members: Iterable[Fragment]) -> list[str]:
    """Every key that one of these kinds of blocks may have."""
    return list(dict.fromkeys(key for part in members for key in resolved(root, part).get("properties", ())))


def choice(names: Iterable[str]) -> str:
    """`opcua`, or `one of opcua, modbus, replay`."""
    listed = [shown(name) for name in dict.fromkeys(names)]
    if len(listed) == 1:
        return listed[0]
    more = f" and {len(listed) - MOST_LISTED} more" if len(listed) > MOST_LISTED else ""
    return f"one of {', '.join(listed[:MOST_LISTED])}{more}"


def _number(fragment: Fragment, unit: str) -> str:
    what = "a whole number" if fragment["type"] == "integer" else "a number"
    if fragment.get("multipleOf") == 2:
        what = "an even number"
    low, high = fragment.get("minimum"), fragment.get("maximum")
    above, below = fragment.get("exclusiveMinimum"), fragment.get("exclusiveMaximum")
    if low is not None and high is not None:
        return f"{what} from {figure(low)} to {figure(high)}{_after(unit)}"
    bounds = [
        f"{words} {figure(bound)}{_after(unit)}"
        for words, bound in (
            ("of at least", low),
            ("greater than", above),
            ("of at most", high),
            ("less than", below),
        )
        if bound is not None
    ]
    return f"{what} {' and '.join(bounds)}" if bounds else f"{what}{f' ({unit})' if unit else ''}"


def _list(root: Fragment, fragment: Fragment, unit: str) -> str:
    least, most = fragment.get("minItems", 0), fragment.get("maxItems")
    if least and least == most:
        return f"a list of {least} entries, each {expected(root, fragment.get('items', {}), unit)}"
    return "a list with at least one entry" if least else "a list; each entry starts with `- `"


def figure(number: float) -> str:
    """A number of the schema without needless zeros."""
    return str(int(number)) if number == int(number) else repr(number)


def _after(unit: str) -> str:
    return f" {unit}" if unit else ""


def axis_unit(pattern: str, unit: str | None) -> str:
    """A unit of the schema with the axis' own: `(unit/s)²` of an axis in mm is (mm/s)². None: not known."""
    if "unit" not in pattern:
        return pattern
    if unit is None:
        return pattern.replace("unit", "axis unit")
    if not unit:
        return pattern.replace("unit", "1") if "/" in pattern else ""
    return pattern.replace("unit", f"({unit})" if "/" in unit else unit)


def found(node: Node | None) -> str:
    """A value of the file as a report shows it."""
    if isinstance(node, Mapping):
        return "a block of keys" if node.entries else "an empty block {}"
    if isinstance(node, Sequence):
        entries = "entry" if len(node.items) == 1 else "entries"
        return f"a list of {len(node.items)} {entries}" if node.items else "an empty list"
    if not isinstance(node, Scalar) or node.value is None:
        return "nothing"
    if isinstance(node.value, str):
        return f'the text "{shown(node.text)}"'
    return shown(node.text)


def hint(node: Node | None, wanted: str | None, key: str) -> str:
    """What to do about a frequent slip, as in `; remove the quotes`; empty when nothing comes to mind."""
    if not isinstance(node, Scalar) or wanted not in ("number", "integer", "boolean", "string"):
        return ""
    if wanted == "string":
        written = not isinstance(node.value, str) and node.value is not None
        return "; put it in quotes when it is meant as text" if written else ""
    if not isinstance(node.value, str):
        return ""
    if wanted == "boolean":
        answer = _YES_NO.get(node.text.lower())
        return (
            f"; write {answer}" if answer else ("; remove the quotes" if isinstance(resolve(node.text), bool) else "")
        )
    return _number_hint(node, key)


def unquoted_placeholder(node: Node | None) -> str:
    """For what YAML reads as a block with one key and no value, as `{Axis}` without quotes."""
    if not isinstance(node, Mapping) or len(node.entries) != 1:
        return ""
    ((key, entry),) = node.entries.items()
    if not isinstance(entry.value, Scalar) or entry.value.value is not None:
        return ""
    return f'; a placeholder is written in quotes, "{{{shown(key)}}}"'


def _number_hint(node: Scalar, key: str) -> str:
    def is_number(text: str) -> bool:
        value = resolve(text)
        return isinstance(value, int | float) and not isinstance(value, bool)

    text = node.text.strip()
    bare = text.rstrip("abcdefghijklmnopqrstuvwxyzµ%°/²ABCDEFGHIJKLMNOPQRSTUVWXYZ ")
    if is_number(text):
        return "; remove the quotes" if node.quoted else ""
    if is_number(text.replace(",", ".", 1)):
        return f"; write {shown(text.replace(',', '.', 1))} with a decimal point"
    if is_number(text.lstrip("0")):
        return f"; write {shown(text.lstrip('0'))}"
    if is_number(text.replace("_", "")):
        return f"; write {shown(text.replace('_', ''))}"
    if is_number(bare):
        return (
            f"; write the number alone, {key} says its unit"
            if key.endswith(("_ms", "_s"))
            else "; write the number alone"
        )
    return ""


def near(word: str, names: Iterable[str]) -> tuple[str, float] | None:
    """The most similar name and how similar it is; None when none is worth a guess."""
    known = list(names)
    synonym = _SYNONYMS.get(_plain(word))
    if synonym in known:
        return str(synonym), 1.0
    matcher = SequenceMatcher(autojunk=False)
    matcher.set_seq2(_plain(word[:100]))
    best, most = None, NEAR
    for name in known:
        matcher.set_seq1(_plain(name))
        if matcher.real_quick_ratio() < most or matcher.quick_ratio() < most:
            continue
        if matcher.ratio() > most or (best is None and matcher.ratio() >= most):
            best, most = name, matcher.ratio()
    return (best, most) if best is not None else None


def did_you_mean(word: str, names: Iterable[str]) -> str:
    """`; did you mean plc1?`, or nothing."""
    guess = near(word, names)
    return f"; did you mean {shown(guess[0])}?" if guess else ""


def _plain(word: str) -> str:
    return word.lower().replace("-", "_").replace(" ", "_")
