"""Types of the OPC UA server: the committed NodeSet2 file, and how it reads in a server that has none of our code."""

from __future__ import annotations

import asyncio
from pathlib import Path

import pytest
from asyncua import Server, ua

from gateway.views.opcua.address_space.model import leaves, methods
from gateway.views.opcua.address_space.parameters import INSTRUMENTS, RANGED, instrument_ranges, nameplate, ranges
from gateway.views.opcua.types.build import Namespaces
from gateway.views.opcua.types.companion import DI, MACHINERY, add_companions
from gateway.views.opcua.types.nodeset import nodeset
from gateway.views.opcua.types.rig_type import TYPES, VERSION
from protocol.bus import board51_pb2 as pb

FILE = Path(__file__).parents[3] / "protocol/opcua/board51.NodeSet2.xml"


def test_the_committed_nodeset_is_what_the_program_exports() -> None:
    assert FILE.read_text(encoding="utf-8") == nodeset(), (
        "raise VERSION and PUBLISHED in gateway/views/opcua/types/rig_type.py, then: "
        f"board51 opcua --export-nodeset {FILE.relative_to(FILE.parents[2])}"
    )


def test_the_nodeset_is_read_by_a_server_without_our_types() -> None:
    async def read() -> None:
        server = Server()
        await server.init()
        for uri in ("urn:other", MACHINERY, DI):  # with other numbers than in ours
            await server.register_namespace(uri)
        spaces = Namespaces(
            site=1,
            types=9,
            di=await server.get_namespace_index(DI),
            machinery=await server.get_namespace_index(MACHINERY),
        )
        add_companions(server.iserver, spaces)
        nodes = await server.import_xml(xmlstring=FILE.read_text(encoding="utf-8"))
        index = await server.get_namespace_index(TYPES)
        rig = server.get_node(ua.NodeId("RigType", index))
        copy = await server.nodes.objects.add_object(1, "copy", rig.nodeid, instantiate_optional=False)
        twin, x = f"{index}:twin", [f"{index}:state", f"{index}:x_m"]

        assert len(nodes) > len(leaves())
        assert (await (await copy.get_child([*x, "0:EngineeringUnits"])).read_value()).DisplayName.Text == "m"
        assert (await (await copy.get_child([*x])).read_data_type()).Identifier == ua.ObjectIds.Double
        assert twin not in [(await child.read_browse_name()).to_string() for child in await copy.get_children()]
        plate = await copy.get_child(f"{spaces.di}:Identification")
        assert (await plate.read_type_definition()) == ua.NodeId(1012, spaces.machinery)
        gains = await rig.get_child([f"{index}:SetGains", "0:InputArguments"])
        assert [argument.Name for argument in await gains.read_value()] == ["law", "gains", "i_0_a", "x_0_m", "u_0_v"]
        link = await (await copy.get_child([f"{index}:link", f"{index}:code"])).read_data_type()
        definition = await server.get_node(link).read_data_type_definition()
        assert [(field.Name, field.Value) for field in definition.Fields][:2] == [("live", 0), ("silent", 1)]

    asyncio.run(read())
    assert f'Version="{VERSION}"' in FILE.read_text(encoding="utf-8")


def test_every_command_and_argument_is_described() -> None:
    for method in methods():
        assert method.description
        assert [argument.name for argument in method.arguments if not argument.description] == [], method.name


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


def test_every_range_is_of_a_variable() -> None:
    paths = {leaf.path for leaf in leaves()} | {"setpoint/x_ref_m"}

    assert RANGED <= paths
    assert INSTRUMENTS <= paths


def test_a_nameplate_is_empty_where_the_board_states_nothing() -> None:
    full = nameplate(pb.Parameters(board_id=7, firmware="1.0 test"))
    empty = nameplate(pb.Parameters(firmware="1.0"))

    assert (full["SerialNumber"].Value, full["ProductInstanceUri"].Value) == ("7", "urn:board51:board:7")
    assert full["SoftwareRevision"].Value == "1.0 test"
    assert full["Manufacturer"].Value.Text == full["HardwareRevision"].Value == ""
    assert empty["SerialNumber"].Value == empty["ProductInstanceUri"].Value == ""
