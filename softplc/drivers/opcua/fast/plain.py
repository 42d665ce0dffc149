"""What stands before and after the results of a response, as nearly every server sends it; and what was not so.

After the type: timestamp 8, request handle 4, service result 4, no diagnostics 1, no strings 4, no additional header
3 bytes (OPC 10000-4, 7.33); then the number of results. After the results: no diagnostics, or none at all.
"""

from dataclasses import dataclass
from typing import Final

from softplc.drivers.opcua.fast.records import OddBodyError

HEAD: Final = 28
"""Bytes of the plain head, with the type."""
NONE: Final = (b"\xff\xff\xff\xff", b"\0\0\0\0")
"""An array that is null, or empty."""


@dataclass
class SlowState:
    """What asyncua's decoder had to do: `messages` with an odd head or tail, and single odd `values`."""

    messages: int = 0
    values: int = 0


def has_plain_head(body: bytes) -> bool:
    """True when a response begins with the plain head and its service result is Good."""
    return body[16:21] == b"\0\0\0\0\0" and body[21:25] in NONE and body[25:HEAD] == b"\0\0\0"


def check_count(body: bytes, at: int, wanted: int) -> int:
    """Where the results begin whose number stands at this byte. Raises OddBodyError unless it is the wanted one."""
    if len(body) < at + 4:
        raise OddBodyError("the answer is cut short")
    found = max(int.from_bytes(body[at : at + 4], "little", signed=True), 0)  # below 0 is no array, as asyncua has it
    if found != wanted:
        raise OddBodyError(f"was answered with {found} results; expected {wanted}")
    return at + 4


def has_plain_tail(body: bytes, end: int) -> bool:
    """True when nothing but the absence of diagnostics follows the results."""
    return body[end:] in NONE
