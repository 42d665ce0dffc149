"""Nodes that are made when somebody asks for them."""

from collections.abc import Callable
from typing import Any

from asyncua.server.address_space import NodeData


class OnDemand(dict[Any, NodeData]):
    """asyncua's nodes by their ids; those that are not there are asked of `make`, which returns None for no node."""

    def __init__(self, nodes: dict[Any, NodeData], make: Callable[[Any], NodeData | None]) -> None:
        super().__init__(nodes)
        self._make = make

    def __missing__(self, asked: Any) -> NodeData:
        node = self._make(asked)
        if node is None:
            raise KeyError(asked)
        self[node.nodeid] = node
        return node

    def __contains__(self, asked: object) -> bool:
        return self.get(asked) is not None

    def get(self, asked: Any, default: Any = None) -> Any:
        """The node, made now if it has to be, or else the default."""
        try:
            return self[asked]
        except KeyError:
            return default
