// node judge.mjs '{"url": ..., "board": ..., "seconds": 5, ...}': prints one JSON object with what was found, and the
// transcript on stderr.  Options: see the destructuring below.
import { readFileSync } from "node:fs";

import { OPCUACertificateManager } from "node-opcua-certificate-manager";
import * as opcua from "node-opcua-client";

const {
  AttributeIds, DataChangeFilter, DataChangeTrigger, DataType, DeadbandType, MessageSecurityMode, NodeClass,
  OPCUAClient, SecurityPolicy, TimestampsToReturn, UserTokenType,
} = opcua;

const { url, board, namespaceUri, seconds, variables, policy, certificate, key, user, password, pki, ca, within, outside,
  alarm } = JSON.parse(process.argv[2]);
const found = { browsed: 0, series: {}, writes: {}, calls: {} };
const say = (text) => process.stderr.write(`${text}\n`);
const sleep = (ms) => new Promise((resolve) => setTimeout(resolve, ms));

const options = { endpointMustExist: false, connectionStrategy: { maxRetry: 2, initialDelay: 200, maxDelay: 1000 } };
if (policy) {
  const clientCertificateManager = new OPCUACertificateManager({
    rootFolder: pki, automaticallyAcceptUnknownCertificate: true,
  });
  await clientCertificateManager.initialize();
  const pem = readFileSync(ca, "utf8").replace(/-----[A-Z ]+-----|\s/g, "");
  await clientCertificateManager.addIssuer(Buffer.from(pem, "base64"), false, true);
  Object.assign(options, {
    securityMode: MessageSecurityMode.SignAndEncrypt, securityPolicy: SecurityPolicy[policy],
    certificateFile: certificate, privateKeyFile: key, clientCertificateManager,
  });
}
const client = OPCUAClient.create(options);
await client.connect(url);
const endpoints = await client.getEndpoints();
found.endpoints = endpoints.map((e) => `${e.securityPolicyUri.split("#")[1]} ${MessageSecurityMode[e.securityMode]}`);
say(`connected to ${url} with ${policy ?? "no security"}; endpoints: ${found.endpoints.join(", ")}`);
let session;
try {
  session = await client.createSession(
    user ? { type: UserTokenType.UserName, userName: user, password } : { type: UserTokenType.Anonymous },
  );
} catch (error) {
  found.refused = error.message;
  say(`session refused: ${error.message}`);
  await client.disconnect();
  console.log(JSON.stringify(found));
  process.exit(0);
}
const namespaces = await session.readNamespaceArray();
const index = namespaces.indexOf(namespaceUri);
const id = (path) => `ns=${index};s=${path}`;
say(`session of ${user ?? "anonymous"}; ${namespaceUri} is namespace ${index}`);

const waiting = [id(board)];
while (waiting.length > 0) {
  const result = await session.browse({
    nodeId: waiting.pop(), referenceTypeId: "HierarchicalReferences", includeSubtypes: true,
    browseDirection: 0, nodeClassMask: 0, resultMask: 63,
  });
  for (const reference of result.references) {
    found.browsed += 1;
    if (reference.nodeClass !== NodeClass.Method) waiting.push(reference.nodeId.toString());
  }
}
say(`browsed ${found.browsed} nodes below ${board}`);

for (const path of [`${board}/state/x_m/EngineeringUnits`, `${board}/state/x_m/EURange`]) {
  const value = await session.read({ nodeId: id(path), attributeId: AttributeIds.Value });
  found[path.split("/").at(-1)] = value.value.value;
}

found.timestamps = {};
for (const asked of ["Source", "Server", "Both", "Neither"]) {
  const node = { nodeId: id(`${board}/state/x_m`), attributeId: AttributeIds.Value };
  const request = { nodesToRead: [node], timestampsToReturn: TimestampsToReturn[asked] };
  const value = (await session.performMessageTransaction(new opcua.ReadRequest(request))).results[0];
  found.timestamps[asked] = ["source", "server"].filter((which) => value[`${which}Timestamp`]);
}
found.profiles = (await session.read({ nodeId: "i=2269", attributeId: AttributeIds.Value })).value.value;
say(`timestamps: ${JSON.stringify(found.timestamps)}; ${found.profiles.length} profiles`);

const subscription = await session.createSubscription2({
  requestedPublishingInterval: 100, requestedLifetimeCount: 600, requestedMaxKeepAliveCount: 50,
  maxNotificationsPerPublish: 0, publishingEnabled: true, priority: 1,
});
const filter = new DataChangeFilter({
  trigger: DataChangeTrigger.StatusValueTimestamp, deadbandType: DeadbandType.None, deadbandValue: 0,
});
const items = [], board_s = [];
for (const path of variables) {
  const series = (found.series[path] = { count: 0, gaps: [], statuses: {}, last_ms: null });
  const item = await subscription.monitor(
    { nodeId: id(`${board}/${path}`), attributeId: AttributeIds.Value },
    { samplingInterval: 20, discardOldest: true, queueSize: 1000, filter }, TimestampsToReturn.Both,
  );
  item.on("changed", (value) => {
    const name = value.statusCode.name;
    series.statuses[name] = (series.statuses[name] ?? 0) + 1;
    // Picoseconds fill what the millisecond of a JavaScript Date leaves out.
    const at_ms = value.sourceTimestamp ? value.sourceTimestamp.getTime() + (value.sourcePicoseconds ?? 0) / 1e9 : null;
    if (series.last_ms !== null && at_ms !== null) series.gaps.push(at_ms - series.last_ms);
    series.last_ms = at_ms;
    if (path === "state/t_s") board_s.push(value.value.value);
    series.count += 1;
  });
  items.push(item);
}
await sleep(300);
for (const series of Object.values(found.series)) Object.assign(series, { count: 0, gaps: [] });
board_s.length = 0;
const start = performance.now();
await sleep(seconds * 1000);
found.seconds = (performance.now() - start) / 1000;
found.longest_board_s = Math.max(...board_s.slice(1).map((t, n) => t - board_s[n]));
await subscription.terminate();
for (const [path, series] of Object.entries(found.series)) {
  const gaps = series.gaps;
  Object.assign(series, { longest_ms: Math.max(...gaps), shortest_ms: Math.min(...gaps), gaps: gaps.length });
  say(`${path}: ${series.count} values in ${found.seconds.toFixed(1)} s, intervals ${series.shortest_ms.toFixed(1)}` +
    ` to ${series.longest_ms.toFixed(1)} ms, ${JSON.stringify(series.statuses)}`);
}

async function write(name, path, value) {
  const code = await session.write({
    nodeId: id(`${board}/${path}`), attributeId: AttributeIds.Value, value: { value },
  });
  found.writes[name] = code.name;
  say(`write ${path} = ${value.value}: ${code.name}`);
}
const metres = (value) => ({ dataType: DataType.Double, value });
await write("within", "setpoint/x_ref_m", metres(within));
await write("outside", "setpoint/x_ref_m", metres(outside));
await write("wrong type", "setpoint/x_ref_m", { dataType: DataType.String, value: "up" });
await write("float", "setpoint/x_ref_m", { dataType: DataType.Float, value: within });
await write("int", "setpoint/mode", { dataType: DataType.Int32, value: 2 });
await write("mode", "setpoint/mode", { dataType: DataType.UInt32, value: 2 });
await write("measured", "state/x_m", metres(within));

async function call(name, inputs) {
  const result = await session.call({ objectId: id(board), methodId: id(`${board}/${name}`), inputArguments: inputs });
  found.calls[name] = { code: result.statusCode.name, outputs: (result.outputArguments ?? []).map((o) => o.value) };
  say(`call ${name}: ${result.statusCode.name} ${JSON.stringify(found.calls[name].outputs)}`);
}
await call("SetReference", [metres(outside)]);
await call("SetGains", [
  { dataType: DataType.UInt32, value: 0 }, { dataType: DataType.Double, arrayType: 1, value: [0.49, 1700, 17.7, -17600] },
  metres(0.6), metres(2.85e-3), metres(2.1),
]);
await call("Stop", []);

// By the clock of the values: on a busy machine an emulated board is seconds behind ours.
const end = new Date(found.series["state/x_m"]?.last_ms ?? Date.now() - 500);
const history = await session.readHistoryValue(id(`${board}/state/x_m`), new Date(end.getTime() - 2000), end);
found.history = history.historyData?.dataValues?.length ?? 0;
say(`history of 2 s: ${found.history} values`);

if (alarm) found.alarm = await acknowledge(alarm);

await session.close();
await client.disconnect();
console.log(JSON.stringify(found));
process.exit(0);

// Subscribe to the Server's events late, refresh, acknowledge the condition by its event; each step as it was answered.
async function acknowledge(name) {
  const subscription = await session.createSubscription2({
    requestedPublishingInterval: 50, requestedLifetimeCount: 600, requestedMaxKeepAliveCount: 50,
    maxNotificationsPerPublish: 0, publishingEnabled: true, priority: 1,
  });
  const names = ["EventId", "ConditionName", "ActiveState.Id", "AckedState.Id", "ClientUserId", "Comment", "Time"];
  const events = opcua.constructEventFilter(names);
  events.selectClauses.push(new opcua.SimpleAttributeOperand({  // the ConditionId of Part 9, 5.5.2
    typeDefinitionId: "i=2782", browsePath: [], attributeId: AttributeIds.NodeId,
  }));
  const item = await subscription.monitor(
    { nodeId: "i=2253", attributeId: AttributeIds.EventNotifier },
    { samplingInterval: 0, discardOldest: true, queueSize: 1000, filter: events }, TimestampsToReturn.Both,
  );
  const waiting = [];
  item.on("changed", (fields) => {
    const [eventId, condition, active, acked, by, comment, time, id] = fields.map((field) => field?.value);
    const event = { eventId, condition, active, acked, by, comment: comment?.text, time, id };
    for (const waits of waiting) if (condition === name) waits(event);
  });
  const next = (wanted) => new Promise((resolve) => waiting.push((event) => wanted(event) && resolve(event)));
  const call = async (objectId, methodId, inputArguments) =>
    (await session.call({ objectId, methodId, inputArguments })).statusCode.name;
  const listed = next(() => true);
  const refresh = await call("i=2782", "i=3875", [{ dataType: DataType.UInt32, value: subscription.subscriptionId }]);
  const came = await listed;
  const seen = next((event) => event.acked);
  const comment = { dataType: DataType.LocalizedText, value: { text: "known" } };
  const byEvent = (value) => call(came.id, "i=9111", [{ dataType: DataType.ByteString, value }, comment]);
  const codes = [await byEvent(Buffer.from("another")), await byEvent(came.eventId)];
  const done = codes[1] === "Good" ? await seen : null;
  say(`alarm ${name}: refresh ${refresh}, active ${came.active}, acknowledged ${came.acked}, since ` +
    `${came.time.toISOString()}; acknowledge: ${codes.join(", ")}; then by ${done?.by}: ${done?.comment}`);
  await subscription.terminate();
  return { refresh, active: came.active, acked: came.acked, codes, by: done?.by, comment: done?.comment };
}
