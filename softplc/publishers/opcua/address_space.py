"""The server's nodes: one object for each block, one variable for each tag, node ids that stay.

```
Objects
└── softplc                 ns=2;s=/softplc
    ├── Tasks               ns=2;s=/softplc/Tasks
    │   └── main            ns=2;s=Tasks.main          Heartbeat → ns=2;s=Tasks.main.Heartbeat …
    ├── Sources             ns=2;s=/softplc/Sources
    │   └── plc1            ns=2;s=Sources.plc1        Connected → ns=2;s=Sources.plc1.Connected …
    └── Axes                ns=2;s=/softplc/Axes
        └── AxisX           ns=2;s=AxisX               Position  → ns=2;s=AxisX.Position …
```
Folders have a slash in their id, which no name of an axis, task or source can have. Properties are named after
their variable: `ns=2;s=AxisX.Position.EURange`.

The nodes are put straight into asyncua's address space: its own AddNodes compares every new reference with all
references of the parent, and takes 0.1 ms and 4 kB for each node; attributes that never change are shared here, and a
node is made when a client first asks for it.
"""

from collections.abc import Iterator, Mapping
from functools import cache
from typing import Any, Final

from asyncua import ua
from asyncua.server.address_space import AddressSpace, AttributeValue, NodeData

from softplc.publishers.opcua.on_demand import OnDemand
from softplc.publishers.opcua.properties import Constant, constants_of, leaf_of, type_of
from softplc.publishers.opcua.values import VARIANT_TYPES, TagValues
from softplc.tags import Block, TagTable

NAMESPACE_URI: Final = "urn:softplc:tags"
NAMESPACE: Final = 2  # index of NAMESPACE_URI: the first that is registered

_FOLDERS: Final = {"task": "Tasks", "source": "Sources", "axis": "Axes"}
_ROOT: Final = "/softplc"

_ORGANIZES: Final = ua.NodeId(ua.ObjectIds.Organizes)
_HAS_COMPONENT: Final = ua.NodeId(ua.ObjectIds.HasComponent)
_HAS_PROPERTY: Final = ua.NodeId(ua.ObjectIds.HasProperty)
_HAS_TYPE: Final = ua.NodeId(ua.ObjectIds.HasTypeDefinition)
_READ: Final = 1 << ua.AccessLevel.CurrentRead
_READ_WRITE: Final = _READ | 1 << ua.AccessLevel.CurrentWrite


def node_id(name: str) -> Any:
    """The node id of a tag, a block or a folder: its name as a string in softplc's namespace."""
    return ua.NodeId(name, NAMESPACE)


def block_path(block: Block) -> str:
    """The id of a block's node: what the names of its tags begin with."""
    return block.tags[0].name.rpartition(".")[0] if block.tags else block.name


class TagIndex(Mapping[Any, int]):
    """Index of each tag by the id of its variable, without an object for each."""

    def __init__(self, table: TagTable) -> None:
        self._table = table

    def __getitem__(self, asked: Any) -> int:
        name = asked.Identifier
        if asked.NamespaceIndex != NAMESPACE or not isinstance(name, str):
            raise KeyError(asked)
        return self._table.index(name)

    def __iter__(self) -> Iterator[Any]:
        return (node_id(tag.name) for tag in self._table)

    def __len__(self) -> int:
        return len(self._table)


class Nodes:
    """softplc's nodes in asyncua's address space; variables read their values from `values`.

    The folders are there from the start. A block, a variable or a property is made when somebody asks for it, and
    stays: of hundreds of thousands, clients look at few. Values are read and monitored without them.
    """

    def __init__(self, space: AddressSpace, values: TagValues, interval_ms: float) -> None:
        self._space, self._values, self._table = space, values, values.table
        self._interval_ms = interval_ms
        self._blocks: dict[str, tuple[NodeData, Block]] = {}  # by path, with the folder
        self._constants: dict[tuple[Any, ...], AttributeValue] = {}
        self._alike: dict[tuple[Any, ...], dict[Any, AttributeValue]] = {}
        self._type_references: dict[Any, Any] = {}
        self._back_references: dict[Any, Any] = {}

    def build(self) -> None:
        """Add everything below Objects/softplc."""
        objects = self._space[ua.NodeId(ua.ObjectIds.ObjectsFolder)]
        root = self._folder(objects, _ROOT, "softplc")
        folders = {kind: self._folder(root, f"{_ROOT}/{name}", name) for kind, name in _FOLDERS.items()}
        for block in self._table.blocks:
            folder, path = folders[block.kind], block_path(block)
            self._blocks[path] = folder, block
            name = _name(block.name, NAMESPACE)
            self._lead(folder, _ORGANIZES, path, name, ua.NodeClass.Object, ua.ObjectIds.BaseObjectType)
        self._space._nodes = OnDemand(self._space._nodes, self._make)

    def _make(self, asked: Any) -> NodeData | None:
        """The node with this id, as it is below one of the folders; None where there is none."""
        name = asked.Identifier
        if asked.NamespaceIndex != NAMESPACE or not isinstance(name, str):
            return None
        if name in self._blocks:
            return self._block(*self._blocks[name])
        owner, _, leaf = name.rpartition(".")
        if name in self._table:
            return self._tag(self._blocks[owner][1], self._table.index(name))
        if owner in self._table:
            index = self._table.index(owner)
            block = self._blocks[owner.rpartition(".")[0]][1]
            for constant in constants_of(block, self._table.tags[index]):
                if constant.name == leaf:
                    return self._property(owner, constant)
        return None

    def _folder(self, parent: NodeData, path: str, name: str) -> NodeData:
        own, kind = _name(name, NAMESPACE), ua.ObjectIds.FolderType
        self._lead(parent, _ORGANIZES, path, own, ua.NodeClass.Object, kind)
        node = self._object(parent, path, own, kind)
        self._space[node.nodeid] = node
        return node

    def _block(self, folder: NodeData, block: Block) -> NodeData:
        node = self._object(folder, block_path(block), _name(block.name, NAMESPACE), ua.ObjectIds.BaseObjectType)
        for tag in block.tags:
            name = _name(leaf_of(tag), NAMESPACE)
            self._lead(node, _HAS_COMPONENT, tag.name, name, ua.NodeClass.Variable, type_of(block, tag))
        return node

    def _tag(self, block: Block, index: int) -> NodeData:
        tag = self._table.tags[index]
        value = AttributeValue(None)
        value.value_callback = self._read
        access = _READ_WRITE if tag.writable else _READ
        data_type = ua.NodeId(VARIANT_TYPES[tag.data_type].value)
        name, type_id = _name(leaf_of(tag), NAMESPACE), type_of(block, tag)
        parent = self._space[node_id(block_path(block))]
        node = self._variable(
            parent, _HAS_COMPONENT, tag.name, name, type_id, data_type, value, access, tag.description
        )
        for constant in constants_of(block, tag):
            path, own = f"{tag.name}.{constant.name}", _name(constant.name, 0)
            self._lead(node, _HAS_PROPERTY, path, own, ua.NodeClass.Variable, ua.ObjectIds.PropertyType)
        return node

    def _property(self, owner: str, constant: Constant) -> NodeData:
        value = self._constants.get(constant.key)
        if value is None:
            value = self._constants[constant.key] = AttributeValue(ua.DataValue(ua.Variant(constant.make())))
        return self._variable(
            self._space[node_id(owner)],
            _HAS_PROPERTY,
            f"{owner}.{constant.name}",
            _name(constant.name, 0),
            ua.ObjectIds.PropertyType,
            ua.NodeId(constant.data_type),
            value,
            _READ,
        )

    def _object(self, parent: NodeData, path: str, name: Any, type_id: int) -> NodeData:
        kind = ua.NodeClass.Object
        attributes = self._common(name, kind) | {
            ua.AttributeIds.EventNotifier: self._constant(0, ua.VariantType.Byte)
        }
        return self._node(parent, _ORGANIZES, path, type_id, attributes)

    def _variable(
        self,
        parent: NodeData,
        reference: Any,
        path: str,
        name: Any,
        type_id: int,
        data_type: Any,
        value: AttributeValue,
        access: int,
        description: str = "",
    ) -> NodeData:
        is_array = value.value is not None and value.value.Value.is_array
        kind = (name.Name, name.NamespaceIndex, data_type.Identifier, access, description, is_array)
        alike = self._alike.get(kind)
        if alike is None:
            ids, types, constant = ua.AttributeIds, ua.VariantType, self._constant
            alike = self._alike[kind] = self._common(name, ua.NodeClass.Variable) | {
                ids.Value: value,
                ids.DataType: constant(data_type, types.NodeId),
                ids.ValueRank: constant(ua.ValueRank.OneDimension if is_array else ua.ValueRank.Scalar, types.Int32),
                ids.AccessLevel: constant(access, types.Byte),
                ids.UserAccessLevel: constant(_READ, types.Byte),
                ids.MinimumSamplingInterval: constant(self._interval_ms, types.Double),
                ids.Description: self._text(description),
                ids.Historizing: constant(False, types.Boolean),
            }
        node = self._node(parent, reference, path, type_id, alike)
        node.attributes[ua.AttributeIds.Value] = value
        return node

    def _common(self, name: Any, node_class: Any) -> dict[Any, AttributeValue]:
        """Attributes of every node of this name and class, in the order of their ids; the node's own comes later."""
        ids, types = ua.AttributeIds, ua.VariantType
        return {
            ids.NodeId: self._constant(node_class, types.Int32),
            ids.NodeClass: self._constant(node_class, types.Int32),
            ids.BrowseName: self._constant(name, types.QualifiedName, name.NamespaceIndex, name.Name),
            ids.DisplayName: self._text(name.Name),
            ids.WriteMask: self._constant(0, types.UInt32),
            ids.UserWriteMask: self._constant(0, types.UInt32),
        }

    def _node(
        self, parent: NodeData, reference: Any, path: str, type_id: int, alike: dict[Any, AttributeValue]
    ) -> NodeData:
        """A node with these attributes, but for its own id."""
        node = NodeData(node_id(path))
        node.attributes = alike.copy()
        variant = ua.Variant(node.nodeid, ua.VariantType.NodeId, None, False)
        node.attributes[ua.AttributeIds.NodeId] = AttributeValue(ua.DataValue(variant))
        node.references = [self._back_reference(parent, reference), self._type_reference(type_id)]
        return node

    def _lead(self, parent: NodeData, reference: Any, path: str, name: Any, node_class: Any, type_id: int) -> None:
        """A reference from the parent to the node of this path, whether it is made already or not."""
        display = self._text(name.Name).value.Value.Value
        kind = self._type_reference(type_id).NodeId
        parent.references.append(
            ua.ReferenceDescription(reference, True, node_id(path), name, display, node_class, kind)
        )

    def _back_reference(self, parent: NodeData, reference: Any) -> Any:
        key = (parent.nodeid, reference)
        found = self._back_references.get(key)
        if found is None:
            found = self._back_references[key] = self._describe(reference, parent, is_forward=False)
        return found

    def _type_reference(self, type_id: int) -> Any:
        found = self._type_references.get(type_id)
        if found is None:
            target = self._space[ua.NodeId(type_id)]
            found = self._type_references[type_id] = self._describe(_HAS_TYPE, target, is_forward=True)
        return found

    def _describe(self, reference: Any, target: NodeData, *, is_forward: bool) -> Any:
        def attribute(attribute_id: Any) -> Any:
            return target.attributes[attribute_id].value.Value.Value

        ids = ua.AttributeIds
        types = (
            found.NodeId for found in target.references if found.ReferenceTypeId == _HAS_TYPE and found.IsForward
        )
        return ua.ReferenceDescription(
            reference,
            is_forward,
            target.nodeid,
            attribute(ids.BrowseName),
            attribute(ids.DisplayName),
            attribute(ids.NodeClass),
            next(types, ua.NodeId()),
        )

    def _constant(self, value: Any, variant_type: Any, *key: Any) -> AttributeValue:
        """An attribute that never changes, shared by all nodes that have it."""
        place = (variant_type, type(value), *(key or (value,)))
        found = self._constants.get(place)
        if found is None:
            variant = ua.Variant(value, variant_type, None, False)
            found = self._constants[place] = AttributeValue(ua.DataValue(variant))
        return found

    def _text(self, text: str) -> AttributeValue:
        return self._constant(ua.LocalizedText(text), ua.VariantType.LocalizedText, text)

    def _read(self, tag_node_id: Any, _attribute: Any) -> Any:
        return self._values.data_value(self._table.index(tag_node_id.Identifier))


@cache
def _name(name: str, namespace: int) -> Any:
    return ua.QualifiedName(name, namespace)
