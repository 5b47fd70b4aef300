"""Everything from Root on, as a generic client walks it: what the standard asks of each node holds for ours."""

from __future__ import annotations

import asyncio
from dataclasses import dataclass, field
from typing import Any

import pytest
from asyncua import ua

from gateway.access.roles import Role
from gateway.views.opcua.server import OpcuaSettings
from gateway.views.opcua.types import DI, MACHINERY, TYPES
from protocol.bus import board51_pb2 as pb
from tests.harness.gateway.bus_peers import played_gateway, ticking
from tests.harness.gateway.opcua_peers import NAMESPACE, Peer, Served, peer, until

pytestmark = pytest.mark.xdist_group("opcua")
O, S, V = ua.ObjectIds, ua.StatusCodes, ua.VariantType  # noqa: E741  # short in each line
A = ua.AttributeIds
ATTRIBUTES = (A.NodeClass, A.BrowseName, A.DisplayName, A.Description, A.DataType, A.ValueRank, A.Value, A.AccessLevel)
BATCH = 400
TYPE_CLASSES = {ua.NodeClass.ObjectType, ua.NodeClass.VariableType, ua.NodeClass.DataType, ua.NodeClass.ReferenceType}
UNSAID = {S.BadWaitingForInitialData, S.BadNoCommunication, S.BadDataUnavailable, S.UncertainLastUsableValue}


@dataclass
class NodeEntry:
    """A node with its references."""

    attributes: dict[ua.AttributeIds, ua.DataValue] = field(default_factory=dict)
    references: list[ua.ReferenceDescription] = field(default_factory=list)

    def value(self, attribute: ua.AttributeIds) -> Any:
        variant = self.attributes[attribute].Value
        return None if variant is None else variant.Value

    def to(self, reference: int, *, forward: bool = True) -> list[ua.NodeId]:
        type_id = ua.NodeId(reference)
        return [r.NodeId for r in self.references if r.ReferenceTypeId == type_id and r.IsForward == forward]


async def walk(client: Peer) -> dict[ua.NodeId, NodeEntry]:
    """All nodes that can be reached from Root, whatever the reference, but for the insides of the standard's types."""
    nodes: dict[ua.NodeId, NodeEntry] = {}
    kinds: dict[ua.NodeId, ua.NodeClass] = {}
    waiting = [ua.NodeId(O.RootFolder)]
    while waiting:
        batch, waiting = waiting[:BATCH], waiting[BATCH:]
        parameters = ua.BrowseParameters(RequestedMaxReferencesPerNode=0)
        for node in batch:
            nodes[node] = NodeEntry()
            every = ua.BrowseDescription(NodeId=node, BrowseDirection=ua.BrowseDirection.Both, IncludeSubtypes=True)
            every.ReferenceTypeId, every.ResultMask = ua.NodeId(O.References), ua.BrowseResultMask.All
            parameters.NodesToBrowse.append(every)
        for node, result in zip(batch, await client.client.uaclient.browse(parameters), strict=True):
            assert result.StatusCode.is_good(), node
            nodes[node].references = result.References
            kinds |= {r.NodeId: r.NodeClass for r in result.References}
            followed = result.References
            if node.NamespaceIndex == 0 and kinds.get(node) in TYPE_CLASSES:  # of 6000 nodes 4000 are inside these
                followed = [
                    r for r in followed if r.NodeId.NamespaceIndex or r.ReferenceTypeId == ua.NodeId(O.HasSubtype)
                ]
            waiting += [r.NodeId for r in followed if r.NodeId not in nodes]
        waiting = list(dict.fromkeys(node for node in waiting if node not in nodes))
    project_nodes = [node for node in nodes if node.NamespaceIndex >= 2]
    for start in range(0, len(project_nodes), BATCH):
        batch = project_nodes[start : start + BATCH]
        read = ua.ReadParameters(TimestampsToReturn=ua.TimestampsToReturn.Both)
        read.NodesToRead = [
            ua.ReadValueId(NodeId=node, AttributeId=attribute) for node in batch for attribute in ATTRIBUTES
        ]
        values = iter(await client.client.uaclient.read(read))
        for node in batch:
            nodes[node].attributes = {attribute: next(values) for attribute in ATTRIBUTES}
    return nodes


@pytest.mark.slow
def test_every_node_is_as_the_standard_asks() -> None:
    async def session_work(server: Served) -> None:
        async with peer(server.port) as client:
            await client.await_status("rig/state/x_m", S.Good)
            await client.await_status("rig/setpoint/x_ref_m/EURange", S.Good)
            alarm = pb.Alarm(name="divergence-x", active=True, text="x is off", value=9.0)
            server.gateway.send("twin/alarm", alarm, "rig")

            async def whole() -> dict[ua.NodeId, NodeEntry] | None:
                """Nodes before and after a condition that appeared meanwhile do not belong together."""
                before = await conditions(client)
                snapshot = await walk(client) if before else None
                return snapshot if await conditions(client) == before else None

            nodes = await until(whole, "nodes with a condition")
            spaces = await client.client.get_namespace_array()
        assert spaces[2:] == [NAMESPACE, TYPES, DI, MACHINERY]
        project_nodes = {node: entry for node, entry in nodes.items() if node.NamespaceIndex >= 2}
        rig = [node for node in project_nodes if node.NamespaceIndex == 2 and "/alarm/" not in node.Identifier]
        assert len(rig) > 300
        assert len(project_nodes) > 2 * len(rig)
        faults = [fault for node, entry in project_nodes.items() for fault in faults_of(node, entry, nodes)]
        assert faults == []
        expect_machines(nodes)
        expect_rig_like_its_type(nodes)

    with played_gateway() as gateway:
        settings = OpcuaSettings(port=0, anonymous=Role.ENGINEER)
        with ticking(gateway, "rig"), Served(gateway, settings) as served:
            asyncio.run(session_work(served))


async def conditions(client: Peer) -> list[ua.NodeId]:
    kind = ua.BrowseDirection.Forward
    return [node.nodeid for node in await client.node("rig").get_referenced_nodes(O.HasCondition, kind)]


def faults_of(node: ua.NodeId, entry: NodeEntry, nodes: dict[ua.NodeId, NodeEntry]) -> list[str]:
    """Return the faults of one of the server's own nodes."""
    kind, name = ua.NodeClass(entry.value(A.NodeClass)), node.to_string()
    faults = [f"{name}: no {a.name}" for a in (A.BrowseName, A.DisplayName, A.Description) if not text(entry.value(a))]
    typed = entry.to(O.HasTypeDefinition)
    if kind in (ua.NodeClass.Object, ua.NodeClass.Variable) and (len(typed) != 1 or typed[0] not in nodes):
        faults.append(f"{name}: type definitions {typed}")
    parents = [r for r in entry.references if not r.IsForward and r.ReferenceTypeId.Identifier in HIERARCHICAL]
    if not parents:
        faults.append(f"{name}: no parent")
    for reference in entry.references:
        if reference.ReferenceTypeId.Identifier in HIERARCHICAL:
            back = nodes[reference.NodeId].to(reference.ReferenceTypeId.Identifier, forward=not reference.IsForward)
            if back.count(node) != 1:
                faults.append(f"{name}: no inverse of {reference.ReferenceTypeId} at {reference.NodeId}")
    is_property = bool(entry.to(O.HasProperty, forward=False))
    if is_property != (typed == [ua.NodeId(O.PropertyType)]):
        faults.append(f"{name}: property by its reference, not by its type, or the other way round")
    if kind is ua.NodeClass.Method:
        named = {reference.BrowseName.Name for reference in entry.references if reference.IsForward}
        if "OutputArguments" not in named or ("InputArguments" in named) == (name.endswith(("/Stop", "/Ping"))):
            faults.append(f"{name}: arguments {named}")
    if kind is ua.NodeClass.Variable:
        faults += [f"{name}: {fault}" for fault in faults_of_value(entry, nodes)]
    below_type = name.startswith("ns=3;s=RigType/")
    if below_type and len(entry.to(O.HasModellingRule)) != 1:
        faults.append(f"{name}: no modelling rule")
    return faults


HIERARCHICAL = {O.Organizes, O.HasComponent, O.HasProperty, O.HasSubtype, O.HasAddIn, O.HasNotifier, O.HasEventSource}


def faults_of_value(entry: NodeEntry, nodes: dict[ua.NodeId, NodeEntry]) -> list[str]:
    """Return the faults of type and value of a variable."""
    value, data_type, rank = entry.attributes[A.Value], entry.value(A.DataType), entry.value(A.ValueRank)
    if data_type not in nodes:
        return [f"data type {data_type} is not there"]
    if not entry.value(A.AccessLevel) & 1:
        return ["cannot be read"]
    if value.Value is None or value.Value.Value is None:
        return [] if value.StatusCode.value in UNSAID else [f"no value, and {value.StatusCode}"]
    if value.StatusCode.is_bad():
        return [f"a value, and {value.StatusCode}"]
    is_array = isinstance(value.Value.Value, list)
    faults = [] if is_array == (rank == 1) else [f"value rank {rank}, array {is_array}"]
    built_in = lineage(data_type, nodes)
    variant = value.Value.VariantType
    is_of = O.Structure if variant is V.ExtensionObject else variant.value
    if is_of not in built_in and not (is_of == O.Int32 and O.Enumeration in built_in):
        faults.append(f"a {variant} in a variable of {data_type}")
    return faults


def lineage(data_type: ua.NodeId, nodes: dict[ua.NodeId, NodeEntry]) -> set[int]:
    """Numbers of a data type and all above it."""
    numbers, above = {data_type.Identifier}, [data_type]
    while above:
        above = nodes[above.pop()].to(O.HasSubtype, forward=False)
        numbers |= {node.Identifier for node in above if node.NamespaceIndex == 0}
    return numbers


def text(value: Any) -> str:
    return str(getattr(value, "Text", None) or getattr(value, "Name", None) or "")


def expect_machines(nodes: dict[ua.NodeId, NodeEntry]) -> None:
    rig = nodes[ua.NodeId("rig", 2)]
    for name, empty in (("StaticNodeIdTypes", []), ("StaticNumericNodeIdRange", []), ("StaticStringNodeIdPattern", "")):
        assert (
            nodes[ua.NodeId(f"{TYPES}/{name}", 3)].value(A.Value) == empty
        )  # asyncua reads nothing of an empty element
    assert nodes[ua.NodeId(6030, 5)].value(A.Value) == ua.QualifiedName(
        "Identification", 4
    )  # DefaultInstanceBrowseName
    machines = ua.NodeId(1001, 5)
    assert machines in nodes[ua.NodeId(O.ObjectsFolder)].to(O.Organizes)
    assert nodes[machines].to(O.Organizes) == [ua.NodeId("rig", 2)]
    assert rig.to(O.HasTypeDefinition) == [ua.NodeId("RigType", 3)]
    assert rig.to(O.HasNotifier, forward=False) == [ua.NodeId(O.Server)]
    [plate] = rig.to(O.HasAddIn)
    assert nodes[plate].value(A.BrowseName) == ua.QualifiedName("Identification", 4)
    fields = [nodes[node] for node in nodes[plate].to(O.HasProperty)]
    values = {f"{entry.value(A.BrowseName).to_string()}": entry.value(A.Value) for entry in fields}
    assert (values["4:SerialNumber"], values["4:SoftwareRevision"]) == ("7", "1.0 test")
    assert values["4:Manufacturer"].Text in ("", None)


def expect_rig_like_its_type(nodes: dict[ua.NodeId, NodeEntry]) -> None:
    """Each declaration of the type is at the rig, under the same path of browse names and of the same kind.

    Conditions are no part of the type: which ones a rig has is not known before they are raised.
    """
    raised = nodes[ua.NodeId("rig", 2)].to(O.HasCondition)
    assert ua.NodeId("rig/alarm/divergence-x", 2) in raised
    assert {node for node in nodes[ua.NodeId("rig/alarms", 2)].to(O.HasComponent) if "/alarm/" in node.Identifier} == {
        *raised
    }
    declared = {node: entry for node, entry in nodes.items() if node not in raised}
    shapes = [shape(ua.NodeId(top, space), declared) for top, space in (("RigType", 3), ("rig", 2))]
    assert shapes[0] == shapes[1]
    assert len(shapes[0]) > 300


def shape(top: ua.NodeId, nodes: dict[ua.NodeId, NodeEntry], path: str = "") -> dict[str, tuple[Any, ...]]:
    members: dict[str, tuple[Any, ...]] = {}
    for reference in (O.HasComponent, O.HasProperty, O.HasAddIn):
        for node in nodes[top].to(reference):
            entry = nodes.get(node)
            if entry is None:
                continue
            node_path = f"{path}/{entry.value(A.BrowseName).to_string()}"
            members[node_path] = (entry.value(A.NodeClass), entry.to(O.HasTypeDefinition), entry.value(A.DataType))
            members |= shape(node, nodes, node_path)
    return members


def test_a_method_of_the_type_is_called_at_the_rig(server: Served) -> None:
    async def session_work() -> None:
        async with peer(server.port) as client:
            await client.await_status("rig/state/x_m", S.Good)
            codes = []
            for target in ("rig", "rig/state", "another"):
                request = ua.CallMethodRequest(ObjectId=ua.NodeId(target, 2), MethodId=ua.NodeId("RigType/SetMode", 3))
                request.InputArguments = [ua.Variant(0, V.UInt32)]
                codes.append((await client.client.uaclient.call([request]))[0].StatusCode.value)
            assert codes == [S.Good, S.BadMethodInvalid, S.BadMethodInvalid]

    with ticking(server.gateway, "rig"):
        asyncio.run(session_work())
    assert [command.WhichOneof("what") for _, command in server.gateway.commands] == ["set_mode"]
    assert server.gateway.commands[0][1].set_mode.mode == pb.MODE_IDLE
