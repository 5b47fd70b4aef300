// Reads a log with @mcap/core (index, CRCs, chunks) and protobufjs (with the descriptors from the file alone),
// and prints what it found as one line of JSON.   node check.mjs LOG
import { open } from "node:fs/promises";
import { McapIndexedReader, McapStreamReader } from "@mcap/core";
import lz4 from "lz4js";
import protobuf from "protobufjs";
import "protobufjs/ext/descriptor/index.js";
import descriptor from "protobufjs/ext/descriptor/index.js";

const file = await open(process.argv[2]);
const readable = {
  size: async () => BigInt((await file.stat()).size),
  read: async (offset, length) => {
    const buffer = new Uint8Array(Number(length));
    await file.read(buffer, 0, Number(length), Number(offset));
    return buffer;
  },
};
const decompressHandlers = { lz4: (data) => lz4.decompress(data) };

const reader = await McapIndexedReader.Initialize({ readable, decompressHandlers });
const types = new Map();
for (const schema of reader.schemasById.values()) {
  const root = protobuf.Root.fromDescriptor(descriptor.FileDescriptorSet.decode(schema.data));
  types.set(schema.id, root.lookupType(schema.name));
}
const topics = {};
for await (const message of reader.readMessages({ validateCrcs: true })) {
  const channel = reader.channelsById.get(message.channelId);
  const type = types.get(channel.schemaId);
  const fields = type.toObject(type.decode(message.data), { longs: Number });
  const topic = (topics[channel.topic] ??= { schema: type.fullName, count: 0, first: fields, log_time: [] });
  topic.count += 1;
  topic.last = fields;
  topic.log_time.push(String(message.logTime));
}
const metadata = {};
for await (const record of reader.readMetadata()) metadata[record.name] = Object.fromEntries(record.metadata);

const stream = new McapStreamReader({ validateCrcs: true, decompressHandlers });
stream.append(await readable.read(0n, await readable.size()));
let streamed = 0;
for (let record; (record = stream.nextRecord()); ) streamed += record.type === "Message" ? 1 : 0;

await file.close();
console.log(JSON.stringify({ topics, metadata, streamed, done: stream.done() }));
