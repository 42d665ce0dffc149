"""Addresses of OPC-UA variables: node ids and browse paths, parsed and printed. Pure; knows no library.

| form | example |
|---|---|
| node id, by name or number | `ns=2;s=AxisX.Position`, `ns=3;i=1001` |
| node id, GUID or bytes | `ns=2;g=09087e75-8e5e-499b-954f-f2a9603db28a`, `ns=1;b=M/RbKBsRVkePCePcx24oRA==` |
| node id by namespace URI | `nsu=urn:plc:line4;s=AxisX.Position` |
| browse path | `/Objects/2:AxisX/2:Position`, `Objects/2:AxisX/2:Position`, `/Objects/nsu=urn:plc:line4;AxisX/…` |

Node ids are written as in OPC 10000-6, 5.3.1.10; in a URI `;` is written `%3B` and `%` is `%25`. A browse path is a
relative path as in OPC 10000-4, annex A.2, from the root folder and of `/` steps only: a dot is part of the
name, `&` escapes the character that follows. A namespace is an index or a URI; an index may change when a
server restarts, a URI does not.
"""

import base64
import binascii
import re
import uuid
from dataclasses import dataclass
from typing import Final

Identifier = int | str | uuid.UUID | bytes
Namespace = int | str
"""Index into the server's NamespaceArray, or the URI that stands there."""

_NODE_ID: Final = re.compile(
    r"(?:(?P<key>ns|nsu|svr)=(?P<namespace>[^;]*);)?(?P<kind>[A-Za-z]+)=(?P<identifier>.*)", re.S
)
_INDEXED_NAME: Final = re.compile(r"([0-9]+):(.*)", re.S)
_ROOTS: Final = ("Objects", "Types", "Views")
_STEP: Final = re.compile(r"(?:[^/&]|&.)*", re.S)
_RIGHT: Final = "expected a node id as in ns=2;s=AxisX.Position or a browse path as in /Objects/2:AxisX/2:Position"


@dataclass(frozen=True, slots=True)
class NodeIdAddress:
    """A node id; the identifier's Python type says which kind it is: i int, s str, g UUID, b bytes."""

    namespace: Namespace
    identifier: Identifier

    def __str__(self) -> str:
        return _namespace_prefix(self.namespace) + _identifier_text(self.identifier)


@dataclass(frozen=True, slots=True)
class BrowsePathAddress:
    """Steps from the root folder; the first is one of its own folders, as a rule Objects."""

    steps: tuple[tuple[Namespace, str], ...]

    def __str__(self) -> str:
        return "".join("/" + step_text(namespace, name) for namespace, name in self.steps)


Address = NodeIdAddress | BrowsePathAddress


def parse_address(text: str) -> Address:
    """A node id or a browse path. Raises ValueError that says what was found and what would be right."""
    if not text or text != text.strip():
        raise ValueError(f"{text!r} is empty or has blanks around it; {_RIGHT}")
    match = _NODE_ID.fullmatch(text)
    if match is not None and not text.startswith("/"):
        return _parse_node_id(text, match)
    if text.startswith("/") or text.split("/", 1)[0] in (
        "Root",
        "0:Root",
        *_ROOTS,
        *(f"0:{root}" for root in _ROOTS),
    ):
        return _parse_browse_path(text)
    raise ValueError(f"{text!r} is neither a node id nor a browse path; {_RIGHT}")


def step_text(namespace: Namespace, name: str) -> str:
    """One step of a browse path as it is written: `2:Position`, `nsu=urn:plc;Position`, the bare name for index 0."""
    escaped = name.replace("&", "&&").replace("/", "&/")
    if isinstance(namespace, str):
        return f"nsu={_quote(namespace)};{escaped}"
    if namespace == 0 and not _INDEXED_NAME.fullmatch(name) and not name.startswith("nsu="):
        return escaped
    return f"{namespace}:{escaped}"


def _parse_node_id(text: str, match: re.Match[str]) -> NodeIdAddress:
    key, namespace, kind, identifier = match.group("key", "namespace", "kind", "identifier")
    if key == "svr":
        raise ValueError(
            f"{text!r} points into another server; leave svr= out and make that server a source of its own"
        )
    if kind not in ("i", "s", "g", "b"):
        raise ValueError(
            f"{text!r}: {kind}= is no kind of identifier; expected i= (number), s= (string), g= (GUID) or b= (base64)"
        )
    return NodeIdAddress(_parse_namespace(text, key, namespace), _parse_identifier(text, kind, identifier))


def _parse_namespace(text: str, key: str | None, namespace: str | None) -> Namespace:
    if key is None or namespace is None:
        return 0
    if key == "nsu":
        if not namespace:
            raise ValueError(f"{text!r}: nsu= is empty; expected the namespace's URI as in nsu=urn:plc:line4")
        return _unquote(namespace)
    if not _number(namespace, 0xFFFF):
        raise ValueError(f"{text!r}: ns={namespace} is not a namespace index; expected 0 … 65535")
    return int(namespace)


def _parse_identifier(text: str, kind: str, identifier: str) -> Identifier:
    if not identifier:
        raise ValueError(f"{text!r}: nothing follows {kind}=")
    if kind == "s":
        return identifier
    if kind == "i":
        if not _number(identifier, 0xFFFFFFFF):
            raise ValueError(
                f"{text!r}: i={identifier} is not a number of 0 … 4294967295; a name is written s={identifier}"
            )
        return int(identifier)
    try:
        return uuid.UUID(identifier) if kind == "g" else base64.b64decode(identifier, validate=True)
    except (ValueError, binascii.Error) as error:
        right = "09087e75-8e5e-499b-954f-f2a9603db28a" if kind == "g" else "M/RbKBsRVkePCePcx24oRA=="
        raise ValueError(f"{text!r}: {kind}={identifier} is not valid; expected as in {kind}={right}") from error


def _number(text: str, largest: int) -> bool:
    return re.fullmatch("[0-9]{1,10}", text) is not None and int(text) <= largest


def _parse_browse_path(text: str) -> BrowsePathAddress:
    steps = [_parse_step(text, step) for step in _split(text)]
    if steps[0] == (0, "Root"):
        steps = steps[1:]
    if not steps or steps[0] not in [(0, root) for root in _ROOTS]:
        raise ValueError(
            f"{text!r} does not begin at a folder of the root; expected /Objects/… as in /Objects/2:AxisX/2:Position"
        )
    if len(steps) == 1:
        raise ValueError(f"{text!r} names a folder; expected a variable as in {text}/2:AxisX/2:Position")
    return BrowsePathAddress(tuple(steps))


def _split(text: str) -> list[str]:
    """Cut at unescaped slashes; those inside a namespace URI belong to the URI. Escapes stay in."""
    steps: list[str] = []
    rest = text.removeprefix("/")
    while True:
        name_at = 0
        if rest.startswith("nsu="):
            name_at = rest.find(";") + 1
            if not name_at:
                raise ValueError(f"{text!r}: nsu= without ; before the name; expected nsu=urn:plc:line4;AxisX")
        match = _STEP.match(rest, name_at)
        end = match.end() if match else name_at
        steps.append(rest[:end])
        if end == len(rest):
            return steps
        if rest[end] == "&":
            raise ValueError(
                f"{text!r} ends with &; expected the character that it escapes, or && for the character itself"
            )
        rest = rest[end + 1 :]


def _parse_step(text: str, step: str) -> tuple[Namespace, str]:
    namespace: Namespace = 0
    name = step
    if step.startswith("nsu="):
        uri, _, name = step.removeprefix("nsu=").partition(";")
        namespace = _parse_namespace(text, "nsu", uri)
    elif indexed := _INDEXED_NAME.fullmatch(step):
        namespace, name = _parse_namespace(text, "ns", indexed.group(1)), indexed.group(2)
    if not name:
        raise ValueError(
            f"{text!r} has an empty step; expected names between the slashes as in /Objects/2:AxisX/2:Position"
        )
    return namespace, re.sub(r"&(.)", r"\1", name, flags=re.S)


def _namespace_prefix(namespace: Namespace) -> str:
    if isinstance(namespace, str):
        return f"nsu={_quote(namespace)};"
    return f"ns={namespace};" if namespace else ""


def _identifier_text(identifier: Identifier) -> str:
    if isinstance(identifier, int):
        return f"i={identifier}"
    if isinstance(identifier, str):
        return f"s={identifier}"
    if isinstance(identifier, uuid.UUID):
        return f"g={identifier}"
    return f"b={base64.b64encode(identifier).decode('ascii')}"


def _quote(uri: str) -> str:
    return uri.replace("%", "%25").replace(";", "%3B")


def _unquote(uri: str) -> str:
    return re.sub("%3B", ";", uri, flags=re.I).replace("%25", "%")
