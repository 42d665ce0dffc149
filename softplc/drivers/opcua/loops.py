"""Write-backs that would close a loop, as only the server can tell: two addresses that lead to one node."""

from collections.abc import Sequence

from asyncua import ua

from softplc.drivers.opcua.binding import Binding


def find_loops(readings: Sequence[Binding], writings: Sequence[Binding]) -> dict[int, str]:
    """Writings, by position, whose node is read under another spelling of its address, and what to say of each.

    Under the same spelling it is the read-back: everything else of that kind is refused with the configuration.
    """
    read: dict[ua.NodeId, list[Binding]] = {}
    for binding in readings:
        if binding.node is not None:
            read.setdefault(binding.node, []).append(binding)
    found: dict[int, str] = {}
    for position, binding in enumerate(writings):
        ours = binding.uses[0][1]
        for other in read.get(binding.node, ()):
            theirs = [index for _, index in other.uses]
            if other.address != binding.address and (ours is None or ours in theirs or None in theirs):
                found[position] = (
                    f"{binding.address}: is the node that is read as {other.address}, which closes a loop; it is "
                    "never written; expected a node that softplc does not read"
                )
    return found
