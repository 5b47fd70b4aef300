"""Our types as a NodeSet2 file, for clients and engineering tools that want them without a server."""

from __future__ import annotations

import asyncio
import logging
import xml.etree.ElementTree as Et
from datetime import UTC, datetime

from asyncua import Server, ua
from asyncua.common.xmlexporter import XmlExporter

from gateway.views.opcua.types.build import Namespaces
from gateway.views.opcua.types.companion import DI, MACHINERY, METADATA, Metadata
from gateway.views.opcua.types.rig_type import PUBLISHED, TYPES, VERSION, add_types

_UA = Metadata(  # the oldest that Machinery asks for
    uri="http://opcfoundation.org/UA/",
    version="1.05.02",
    published=datetime(2022, 10, 1, tzinfo=UTC),
    is_subset=False,
)
_XML_ENCODINGS = {
    f"i={ua.ObjectIds.Argument}": f"i={ua.ObjectIds.Argument_Encoding_DefaultXml}",
    f"i={ua.ObjectIds.EUInformation}": f"i={ua.ObjectIds.EUInformation_Encoding_DefaultXml}",
}


async def register(server: Server) -> Namespaces:
    """Register the namespaces of the types behind those of the server, and add the types.

    The site's namespace must have been registered: clients count on its number.
    """
    site = len(await server.get_namespace_array()) - 1
    types, di, machinery = [await server.register_namespace(uri) for uri in (TYPES, DI, MACHINERY)]
    spaces = Namespaces(site=site, types=types, di=di, machinery=machinery)
    add_types(server.iserver, spaces)
    return spaces


def nodeset() -> str:
    """The types as XML; the same text for the same version."""
    return asyncio.run(_nodeset())


async def _nodeset() -> str:
    logging.getLogger("asyncua").setLevel(logging.ERROR)  # it warns of values of data types that we do not use
    server = Server()
    await server.init()
    spaces = await register(server)
    nodes = [node for node in server.iserver.aspace.keys() if node.NamespaceIndex == spaces.types]
    exporter = XmlExporter(server, export_values=True)
    await exporter.build_etree([server.get_node(node) for node in nodes])
    return _written(exporter)


def _written(exporter: XmlExporter) -> str:
    root = exporter.etree.getroot()
    models = Et.Element("Models")
    model = _model(models, "Model", Metadata(uri=TYPES, version=VERSION, published=PUBLISHED, is_subset=False))
    for required in (_UA, *METADATA.values()):
        _model(model, "RequiredModel", required)
    root.insert(1, models)  # the schema wants namespaces, models, aliases, nodes
    for identifier in root.iter("uax:Identifier"):  # of structures: that of their XML encoding, not of the data type
        identifier.text = _XML_ENCODINGS.get(identifier.text or "", identifier.text)
    for variable in root.iter("UAVariable"):  # asyncua writes an empty list as one of structures, whatever it is of
        value = variable.find("Value")
        if value is not None and len(value) == 1 and len(value[0]) == 0 and value[0].tag.startswith("uax:ListOf"):
            variable.remove(value)
    Et.indent(root)
    return Et.tostring(root, encoding="unicode", xml_declaration=False) + "\n"


def _model(parent: Et.Element, tag: str, metadata: Metadata) -> Et.Element:
    published = f"{metadata.published:%Y-%m-%dT%H:%M:%SZ}"
    return Et.SubElement(parent, tag, ModelUri=metadata.uri, Version=metadata.version, PublicationDate=published)
