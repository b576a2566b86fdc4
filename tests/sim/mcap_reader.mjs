// Reads an MCAP file with @mcap/core and decodes it by the schemas inside, and prints what it found as JSON:
//   node mcap_reader.mjs NODE_MODULES FILE.mcap
// For each topic its schema, log times in ns as text, and messages. Timestamps and durations are written as the published JSON
// schemas have them, {sec, nsec}.

import { readFileSync } from "node:fs";
import { createRequire } from "node:module";
import { join, resolve } from "node:path";

const [modules, file] = process.argv.slice(2);
const require = createRequire(join(resolve(modules), "package.json"));
const { McapIndexedReader } = require("@mcap/core");
const { decompress } = require("fzstd");
const protobuf = require("protobufjs");
const { FileDescriptorSet } = require("protobufjs/ext/descriptor");
const schemas = require("@foxglove/schemas/jsonschema");

const content = readFileSync(file);
const readable = {
  size: async () => BigInt(content.length),
  read: async (offset, length) => content.subarray(Number(offset), Number(offset + length)),
};
const reader = await McapIndexedReader.Initialize({ readable, decompressHandlers: { zstd: (buffer) => decompress(buffer) } });

const types = new Map();
function typeOf(schema) {
  if (!types.has(schema.id)) {
    const root = protobuf.Root.fromDescriptor(FileDescriptorSet.decode(schema.data));
    root.resolveAll();
    types.set(schema.id, root.lookupType(schema.name));
  }
  return types.get(schema.id);
}

function plain(type, message) {
  const fields = {};
  for (const field of type.fieldsArray) {
    const value = message[field.name];
    if (value == null) continue; // a message that was not set is not there
    const one = (item) => (field.resolvedType instanceof protobuf.Type ? nested(field.resolvedType, item) : item);
    fields[field.name] = field.repeated ? value.map(one) : one(value);
  }
  return fields;
}

function nested(type, message) {
  if (/^\.google\.protobuf\.(Timestamp|Duration)$/.test(type.fullName)) {
    return { sec: Number(message.seconds), nsec: message.nanos };
  }
  return plain(type, message);
}

const topics = {};
for await (const message of reader.readMessages()) {
  const channel = reader.channelsById.get(message.channelId);
  const schema = reader.schemasById.get(channel.schemaId);
  const type = typeOf(schema);
  const decoded = plain(type, type.decode(message.data));
  const found = (topics[channel.topic] ??= { schema: schema.name, times: [], messages: [] });
  found.times.push(String(message.logTime));
  found.messages.push(decoded);
}

// The published JSON schemas of the messages that were found, to check them against.
const published = {};
for (const { schema } of Object.values(topics)) {
  const [space, name] = schema.split(".");
  if (space === "foxglove") published[schema] = Object.values(schemas).find((one) => one.title === schema || one.title === name);
}
process.stdout.write(JSON.stringify({ topics, published }));
