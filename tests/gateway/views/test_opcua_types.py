"""Types of the OPC UA server: the NodeSet2 file against the messages of the bus, in a server without our code."""

from __future__ import annotations

import asyncio
import re
from pathlib import Path
from typing import Any

import pytest
from asyncua import Server, ua

from gateway.views.opcua.address_space.extras import EXTRAS, LINK_STATES
from gateway.views.opcua.address_space.model import Leaf, leaves, methods
from gateway.views.opcua.address_space.parameters import FIELDS, instrument_ranges, nameplate, ranges
from gateway.views.opcua.operations import OUTPUTS, SETPOINTS
from gateway.views.opcua.types import DI, MACHINERY, TYPES, nodeset
from protocol.bus import board51_pb2 as pb

A, O = ua.AttributeIds, ua.ObjectIds  # noqa: E741  # short in each line
PROTO = (Path(__file__).parents[3] / "protocol/bus/board51.proto").read_text(encoding="utf-8")
UNITS = {  # by the end of a field's name, longest first: x_ref_slew_m_s is a speed, not a time; codes of UNECE
    "_m_s2": ("m/s\u00b2", "MSK"), "_kg": ("kg", "KGM"),
    "_per_s": ("1/s", "C97"), "_percent": ("%", "P1"), "_m_s": ("m/s", "MTS"), "_ms": ("ms", "C26"),
    "_ns": ("ns", "C47"), "_a": ("A", "AMP"), "_m": ("m", "MTR"), "_v": ("V", "VLT"), "_s": ("s", "SEC"),
}  # fmt: skip
IN_UNITS_OF_SIGNAL = (".error", ".rolling_rmse", ".rolling_mean")


class Declared:
    """The declarations of the file below RigType, read by a server with other numbers of the namespaces than ours."""

    def __init__(self) -> None:
        self.server = Server()
        asyncio.run(self._read())

    async def _read(self) -> None:
        await self.server.init()
        for uri in ("urn:other", MACHINERY, DI):
            await self.server.register_namespace(uri)
        await self.server.import_xml(xmlstring=nodeset("companions.NodeSet2.xml"))
        await self.server.import_xml(xmlstring=nodeset())
        spaces = [await self.server.get_namespace_index(uri) for uri in (TYPES, DI, MACHINERY)]
        self.types, self.di, self.machinery = spaces

    def get(self, path: str, attribute: ua.AttributeIds = A.Value) -> Any:
        """Return an attribute of a node below RigType; None if there is no such node."""
        node = self.server.iserver.aspace.get(ua.NodeId(f"RigType/{path}", self.types))
        return None if node is None else node.attributes[attribute].value.Value.Value

    def paths(self, kind: int) -> set[str]:
        """Return the paths of the nodes with this type definition."""
        space = self.server.iserver.aspace
        nodes = [n for n in space.keys() if n.NamespaceIndex == self.types and str(n.Identifier).startswith("RigType/")]
        return {
            node.Identifier.removeprefix("RigType/")
            for node in nodes
            for r in space[node].references
            if r.ReferenceTypeId == ua.NodeId(O.HasTypeDefinition) and r.NodeId == ua.NodeId(kind)
        }


@pytest.fixture(scope="module")
def declared() -> Declared:
    return Declared()


def comment_of(leaf: Leaf) -> str:
    """The comment behind a field in board51.proto."""
    descriptor: Any = leaf.message.DESCRIPTOR
    *above, name = leaf.field.split(".")
    for field in above:
        descriptor = descriptor.fields_by_name[field].message_type
    body = PROTO[PROTO.index(f"message {descriptor.name} {{") :]
    match = re.search(rf"\b{name} = \d+;[^\S\n]*//[^\S\n]*(.*)", body[: body.index("\n}")])
    return match[1].strip() if match else ""


def test_the_file_declares_the_variables_of_the_bus_and_no_others(declared: Declared) -> None:
    expected = {leaf.path: (leaf.variant, leaf.is_array) for leaf in leaves()}
    expected |= {extra.path: (extra.variant, extra.path == "alarms/list") for extra in EXTRAS}
    expected |= {f"setpoint/{field}": (variant, False) for field, variant in SETPOINTS.items()}
    kinds = (O.BaseDataVariableType, O.AnalogItemType, O.AnalogUnitType, O.MultiStateDiscreteType)

    assert set().union(*map(declared.paths, kinds)) == set(expected)
    for path, (variant, is_array) in expected.items():
        data_type = ua.NodeId(variant.value) if path != "link/code" else ua.NodeId("LinkState", declared.types)
        assert (declared.get(path, A.DataType), declared.get(path, A.ValueRank)) == (data_type, 1 if is_array else -1)


def test_units_words_and_descriptions_are_those_of_the_messages(declared: Declared) -> None:
    for leaf in leaves():
        field: Any = leaf.message.DESCRIPTOR.fields_by_name.get(leaf.field)
        name = leaf.field.rpartition(".")[0] if leaf.field.endswith(IN_UNITS_OF_SIGNAL) else leaf.field
        is_double = leaf.variant is ua.VariantType.Double
        unit = next((UNITS[end] for end in UNITS if is_double and name.endswith(end)), None)
        declared_unit = declared.get(f"{leaf.path}/EngineeringUnits")
        declared_text = declared_unit and (
            declared_unit.DisplayName.Text,
            declared_unit.UnitId.to_bytes(4, "big").lstrip(b"\0").decode(),
        )
        assert declared_text == unit, leaf.path
        words = [word.Text for word in declared.get(f"{leaf.path}/EnumStrings") or []]
        assert words == ([v.name for v in field.enum_type.values] if field and field.enum_type else []), leaf.path
        description = declared.get(leaf.path, A.Description).Text
        assert description, f"{leaf.path}: a bare name means nothing in a SCADA system"
        assert description.endswith(comment_of(leaf)), leaf.path


def test_the_file_declares_the_commands_of_the_bus(declared: Declared) -> None:
    outputs = [(name, ua.NodeId(variant.value)) for name, variant in OUTPUTS.items()]
    for method in methods():
        inputs = declared.get(f"{method.name}/InputArguments") or []
        assert [(a.Name, a.DataType, a.ValueRank == 1) for a in inputs] == [
            (a.name, ua.NodeId(a.variant.value), a.is_array) for a in method.arguments
        ]
        assert declared.get(method.name, A.Description).Text
        assert all(argument.Description.Text for argument in inputs), method.name
        assert [(a.Name, a.DataType) for a in declared.get(f"{method.name}/OutputArguments")] == outputs


def test_the_file_declares_the_ranges_and_the_nameplate_that_a_board_fills(declared: Declared) -> None:
    properties = declared.paths(O.PropertyType)

    for name, filled in (("EURange", ranges(pb.Parameters())), ("InstrumentRange", instrument_ranges(pb.Parameters()))):
        assert {path.removesuffix(f"/{name}") for path in properties if path.endswith(f"/{name}")} == set(filled)
    assert {p.partition("/")[2] for p in properties if p.startswith("Identification/")} == set(FIELDS)


def test_a_foreign_server_makes_rigs_of_the_type(declared: Declared) -> None:
    server, index = declared.server, declared.types

    async def make() -> None:
        copy = await server.nodes.objects.add_object(1, "copy", ua.NodeId("RigType", index), instantiate_optional=False)
        twin, x = f"{index}:twin", [f"{index}:state", f"{index}:x_m"]
        assert (await (await copy.get_child([*x, "0:EngineeringUnits"])).read_value()).DisplayName.Text == "m"
        assert twin not in [(await child.read_browse_name()).to_string() for child in await copy.get_children()]
        plate = await copy.get_child(f"{declared.di}:Identification")
        assert (await plate.read_type_definition()) == ua.NodeId(1012, declared.machinery)
        link = await (await copy.get_child([f"{index}:link", f"{index}:code"])).read_data_type()
        definition = await server.get_node(link).read_data_type_definition()
        assert [(field.Name, field.Value) for field in definition.Fields] == [
            (name, n) for n, name in enumerate(LINK_STATES)
        ]

    asyncio.run(make())


@pytest.mark.parametrize(
    ("gateway", "span"),
    [
        ((0.0, 0.0), (0.3e-3, 5.2e-3)),  # a log or a gateway of before: not stated
        ((1e-3, 4e-3), (1e-3, 4e-3)),
        ((0.0, 9e-3), (0.3e-3, 5.2e-3)),
    ],
)
def test_the_range_of_the_reference_is_what_gateway_and_board_both_let_through(
    gateway: tuple[float, float], span: tuple[float, float]
) -> None:
    parameters = pb.Parameters(x_ref_min_m=0.3e-3, x_ref_max_m=5.2e-3)
    parameters.gateway_x_ref_min_m, parameters.gateway_x_ref_max_m = gateway

    assert ranges(parameters)["setpoint/x_ref_m"] == ranges(parameters)["state/x_ref_m"] == span
    assert instrument_ranges(parameters)["setpoint/x_ref_m"] == (0.3e-3, 5.2e-3)


def test_a_nameplate_is_empty_where_the_board_states_nothing() -> None:
    full = nameplate(pb.Parameters(board_id=7, firmware="1.0 test"))
    empty = nameplate(pb.Parameters(firmware="1.0"))

    assert (full["SerialNumber"].Value, full["ProductInstanceUri"].Value) == ("7", "urn:board51:board:7")
    assert full["SoftwareRevision"].Value == "1.0 test"
    assert full["Manufacturer"].Value.Text == full["HardwareRevision"].Value == ""
    assert empty["SerialNumber"].Value == empty["ProductInstanceUri"].Value == ""
