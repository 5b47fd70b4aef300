// Loads our NodeSet2 file behind the official ones, makes a rig of its type, and prints what became of both.
// Usage: node types.mjs FILE
import { AddressSpace } from "node-opcua-address-space";
import { generateAddressSpace } from "node-opcua-address-space/nodeJS.js";
import { nodesets } from "node-opcua-nodesets";

const MACHINERY = "http://opcfoundation.org/UA/Machinery/", DI = "http://opcfoundation.org/UA/DI/";
const space = AddressSpace.create();
await generateAddressSpace(space, [nodesets.standard, nodesets.di, nodesets.ia, nodesets.machinery, process.argv[2]]);
const index = (uri) => space.getNamespaceIndex(uri);
const type = space.findObjectType("RigType", index("urn:board51:opcua:types"));
const count = (node) => node.getAggregates().reduce((sum, child) => sum + 1 + count(child), 0);
space.registerNamespace("urn:own");
const rig = type.instantiate({ browseName: "rig", organizedBy: "ObjectsFolder", optionals: [] });
const child = (node, ...names) => names.reduce((found, name) => found?.getChildByName(name), node);
const short = (node) => node.nodeId.toString().replace(/^ns=\d+;/, "");
const typed = (name, uri) => short(space.findObjectType(name, index(uri)));
console.log(JSON.stringify({
  declared: count(type),
  made: {
    dataType: child(rig, "state", "x_m").dataType.toString(),
    identification: child(rig, "Identification").typeDefinitionObj.browseName.name,
    twin: child(rig, "twin") != null,
  },
  ids: {
    "di FunctionalGroupType": typed("FunctionalGroupType", DI),
    "machinery i=1001": space.findNode(`ns=${index(MACHINERY)};i=1001`)?.browseName.name,
    "machinery MachineryItemIdentificationType": typed("MachineryItemIdentificationType", MACHINERY),
    "machinery MachineIdentificationType": typed("MachineIdentificationType", MACHINERY),
  },
}));
process.exit(0);
