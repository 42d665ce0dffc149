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
references of the parent, and takes 0.1 ms and 4 kB for each node; attributes that never change are shared here.
"""

from functools import cache
from typing import Any, Final

from asyncua import ua
from asyncua.server.address_space import AddressSpace, AttributeValue, NodeData

from softplc.kernel.diagnosis import DIAGNOSIS_TEXT, Diagnosis
from softplc.publishers.opcua.values import VARIANT_TYPES, TagValues
from softplc.sample import AXIS_STATE_TEXT, REASON_TEXT, AxisState, Quality, Reason
from softplc.tags import Block, DataType, Tag, TagTable
from softplc.units import UNECE_NAMESPACE, unit

APPLICATION_URI: Final = "urn:softplc:server"
NAMESPACE_URI: Final = "urn:softplc:tags"
NAMESPACE: Final = 2  # index of NAMESPACE_URI: the first that is registered
OWN_UNITS_URI: Final = "urn:softplc:units"  # of units that UNECE has no code for

_FOLDERS: Final = {"task": "Tasks", "source": "Sources", "axis": "Axes"}
_ROOT: Final = "/softplc"

# EURange where the configuration gives none: what an HMI's bar or trend starts with, no limit of anything.
DEFAULT_RANGES: Final[dict[str, tuple[float, float]]] = {
    "%": (0.0, 100.0),
    "deg": (-360.0, 360.0),
    "rad": (-6.283185307179586, 6.283185307179586),
    "s": (0.0, 1.0),
    "ms": (0.0, 1000.0),
}
DEFAULT_RANGE: Final = (-1000.0, 1000.0)

# Enumerations among the tags of a block kind: what each number means.
_STATES: Final[dict[tuple[str, str], tuple[str, ...]]] = {
    ("axis", "Reason"): tuple(REASON_TEXT[reason] or "none" for reason in Reason),
    ("axis", "Consistency"): tuple(DIAGNOSIS_TEXT[diagnosis] for diagnosis in Diagnosis),
    ("axis", "State"): tuple(AXIS_STATE_TEXT[state] for state in AxisState),
    ("axis", "Quality"): tuple(quality.name.capitalize() for quality in Quality),
}

_ORGANIZES: Final = ua.NodeId(ua.ObjectIds.Organizes)
_HAS_COMPONENT: Final = ua.NodeId(ua.ObjectIds.HasComponent)
_HAS_PROPERTY: Final = ua.NodeId(ua.ObjectIds.HasProperty)
_HAS_TYPE: Final = ua.NodeId(ua.ObjectIds.HasTypeDefinition)
_READ: Final = 1 << ua.AccessLevel.CurrentRead
_READ_WRITE: Final = _READ | 1 << ua.AccessLevel.CurrentWrite


def node_id(name: str) -> Any:
    """The node id of a tag, a block or a folder: its name as a string in softplc's namespace."""
    return ua.NodeId(name, NAMESPACE)


def eu_range(tag: Tag) -> tuple[float, float]:
    """The tag's range, or the default of its unit."""
    return tag.range or DEFAULT_RANGES.get(tag.unit, DEFAULT_RANGE)


def engineering_units(symbol: str) -> Any:
    """EUInformation of a unit (OPC 10000-8, 5.6.4); unit id −1 in softplc's own namespace where UNECE has no code."""
    found = unit(symbol)
    uri = OWN_UNITS_URI if found.code is None else UNECE_NAMESPACE
    return ua.EUInformation(uri, found.unit_id, ua.LocalizedText(found.symbol), ua.LocalizedText(found.name))


class Nodes:
    """Adds softplc's nodes to asyncua's address space; variables read their values from `values`."""

    def __init__(self, space: AddressSpace, values: TagValues, interval_ms: float) -> None:
        self._space, self._values = space, values
        self._interval_ms = interval_ms
        self._index: dict[Any, int] = {}
        self._constants: dict[tuple[Any, ...], AttributeValue] = {}
        self._alike: dict[tuple[Any, ...], dict[Any, AttributeValue]] = {}
        self._type_references: dict[Any, Any] = {}
        self._back_references: dict[Any, Any] = {}

    def build(self, table: TagTable) -> list[Any]:
        """Add everything below Objects/softplc; returns the node id of each tag, in the table's order."""
        objects = self._space[ua.NodeId(ua.ObjectIds.ObjectsFolder)]
        root = self._object(objects, _ORGANIZES, _ROOT, "softplc", ua.ObjectIds.FolderType)
        folders = {
            kind: self._object(root, _ORGANIZES, f"{_ROOT}/{name}", name, ua.ObjectIds.FolderType)
            for kind, name in _FOLDERS.items()
        }
        for block in table.blocks:
            self._block(folders[block.kind], block)
        return list(self._index)

    def _block(self, folder: NodeData, block: Block) -> None:
        path = block.tags[0].name.rpartition(".")[0] if block.tags else block.name
        parent = self._object(folder, _ORGANIZES, path, block.name, ua.ObjectIds.BaseObjectType)
        for offset, tag in enumerate(block.tags):
            self._tag(parent, block, tag, block.start + offset)

    def _tag(self, parent: NodeData, block: Block, tag: Tag, index: int) -> None:
        leaf = tag.name.rpartition(".")[2]
        states = _STATES.get((block.kind, leaf))
        analog = tag.data_type is DataType.DOUBLE and (bool(tag.unit) or tag.range is not None)
        type_id = ua.ObjectIds.BaseDataVariableType
        if analog:
            type_id = ua.ObjectIds.AnalogUnitRangeType
        elif states:
            type_id = ua.ObjectIds.MultiStateDiscreteType
        value = AttributeValue(None)
        value.value_callback = self._read
        access = _READ_WRITE if tag.writable else _READ
        data_type = ua.NodeId(VARIANT_TYPES[tag.data_type].value)
        node = self._variable(
            parent,
            _HAS_COMPONENT,
            tag.name,
            _name(leaf, NAMESPACE),
            type_id,
            data_type,
            value,
            access,
            tag.description,
        )
        self._index[node.nodeid] = index
        if analog:
            low, high = eu_range(tag)
            self._property(node, "EURange", ua.ObjectIds.Range, ("range", low, high), lambda: ua.Range(low, high))
            self._property(
                node,
                "EngineeringUnits",
                ua.ObjectIds.EUInformation,
                ("unit", tag.unit),
                lambda: engineering_units(tag.unit),
            )
        elif states:
            self._property(
                node,
                "EnumStrings",
                ua.ObjectIds.LocalizedText,
                ("states", states),
                lambda: [ua.LocalizedText(state) for state in states],
            )

    def _property(self, parent: NodeData, name: str, data_type: int, key: tuple[Any, ...], make: Any) -> None:
        value = self._constants.get(key)
        if value is None:
            value = self._constants[key] = AttributeValue(ua.DataValue(ua.Variant(make())))
        self._variable(
            parent,
            _HAS_PROPERTY,
            f"{parent.nodeid.Identifier}.{name}",
            _name(name, 0),
            ua.ObjectIds.PropertyType,
            ua.NodeId(data_type),
            value,
            _READ,
        )

    def _object(self, parent: NodeData, reference: Any, path: str, name: str, type_id: int) -> NodeData:
        own, kind = _name(name, NAMESPACE), ua.NodeClass.Object
        attributes = self._common(own, kind) | {ua.AttributeIds.EventNotifier: self._constant(0, ua.VariantType.Byte)}
        return self._node(parent, reference, path, own, kind, type_id, attributes)

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
        node = self._node(parent, reference, path, name, ua.NodeClass.Variable, type_id, alike)
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
        self,
        parent: NodeData,
        reference: Any,
        path: str,
        name: Any,
        node_class: Any,
        type_id: int,
        alike: dict[Any, AttributeValue],
    ) -> NodeData:
        """A node with these attributes, but for its own id."""
        ids = ua.AttributeIds
        node = NodeData(node_id(path))
        node.attributes = alike.copy()
        variant = ua.Variant(node.nodeid, ua.VariantType.NodeId, None, False)
        node.attributes[ids.NodeId] = AttributeValue(ua.DataValue(variant))
        display = alike[ids.DisplayName].value.Value.Value
        type_definition = self._type_reference(type_id)
        forward = ua.ReferenceDescription(
            reference, True, node.nodeid, name, display, node_class, type_definition.NodeId
        )
        node.references = [self._back_reference(parent, reference), type_definition]
        parent.references.append(forward)
        self._space[node.nodeid] = node
        return node

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
        return self._values.data_value(self._index[tag_node_id])


@cache
def _name(name: str, namespace: int) -> Any:
    return ua.QualifiedName(name, namespace)
