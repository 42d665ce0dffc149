// An OPC-UA client made of node-opcua: one JSON request per line on stdin, one JSON answer per line on stdout.
//
//   {"connect": url, "user": name, "password": text}   user and password are optional; so are "policy" and "mode", as in
//                                                      Basic256Sha256 and SignAndEncrypt, and "applicationUri"
//   {"read": [[nodeId, attributeId], ...]}             value, data type, status, timestamps in ms since 1970
//     each with a third, an index range, where a part is wanted
//   {"browse": nodeId}                                 forward hierarchical references
//   {"translate": [startNodeId, "/2:softplc/2:Axes"]}  node id that a browse path leads to
//   {"write": [nodeId, attributeId, dataType, value]}  status of the write
//   {"subscribe": [nodeId, ...], "interval": ms}       answers with interval and statuses; then lines {"notification": ...}
//     also "timestamps": name (Both), "range": index range
//   {"modify": nodeId, "timestamps": name}             for all that was subscribed in the request that began with it
//   {"pace": nodeId, "interval": ms}                   another publishing interval for that; answers with what it became
//   {"unsubscribe": nodeId}                            ends that
//   {"disconnect": true}
//
// Start with the folder for its certificates as the only argument; ends when stdin ends.
"use strict";
const opcua = require("node-opcua");
const { say, serve } = require("./json_lines.js");

const millis = (date) => (date ? date.getTime() : null);
const plain = (value) => {
    if (value === null || value === undefined) return null;
    if (Array.isArray(value)) return value.map(plain);
    if (typeof value === "number" && !Number.isFinite(value)) return String(value);
    if (value.constructor && value.constructor.name === "LocalizedText") return value.text;
    return typeof value === "object" && value.toJSON ? value.toJSON() : value;
};
const sample = (dataValue) => ({
    value: plain(dataValue.value ? dataValue.value.value : null),
    dataType: dataValue.value ? opcua.DataType[dataValue.value.dataType] : "Null",
    status: dataValue.statusCode.value,
    source: millis(dataValue.sourceTimestamp),
    server: millis(dataValue.serverTimestamp),
});

let client = null;
let session = null;
const groups = new Map();

const commands = {
    async connect(request) {
        client = opcua.OPCUAClient.create({
            endpointMustExist: false,
            keepSessionAlive: true,
            connectionStrategy: { initialDelay: 100, maxDelay: 500, maxRetry: request.retries || 0 },
            ...(request.policy && { securityPolicy: opcua.SecurityPolicy[request.policy] }),
            ...(request.mode && { securityMode: opcua.MessageSecurityMode[request.mode] }),
            ...(request.applicationUri && { applicationUri: request.applicationUri }),
            clientCertificateManager: new opcua.OPCUACertificateManager({
                rootFolder: process.argv[2],
                automaticallyAcceptUnknownCertificate: true,
            }),
        });
        await client.connect(request.connect);
        const identity = request.user
            ? { type: opcua.UserTokenType.UserName, userName: request.user, password: request.password }
            : undefined;
        try {
            session = await client.createSession(identity);
        } catch (error) {
            await client.disconnect();
            throw error;
        }
        return { namespaces: await session.readNamespaceArray() };
    },
    async read(request) {
        const nodes = request.read.map(([nodeId, attributeId, range]) => ({
            nodeId,
            attributeId,
            indexRange: range ? new opcua.NumericRange(range) : undefined,
        }));
        return { samples: (await session.read(nodes)).map(sample) };
    },
    async browse(request) {
        const result = await session.browse({
            nodeId: request.browse,
            browseDirection: opcua.BrowseDirection.Forward,
            referenceTypeId: "HierarchicalReferences",
            includeSubtypes: true,
            resultMask: 63,
        });
        const references = (result.references || []).map((reference) => ({
            nodeId: reference.nodeId.toString(),
            browseName: reference.browseName.toString(),
            type: reference.typeDefinition.toString(),
        }));
        return { status: result.statusCode.value, references };
    },
    async translate(request) {
        const path = opcua.makeBrowsePath(request.translate[0], request.translate[1]);
        const result = await session.translateBrowsePath(path);
        return { status: result.statusCode.value, targets: (result.targets || []).map((t) => t.targetId.toString()) };
    },
    async write(request) {
        const [nodeId, attributeId, dataType, value] = request.write;
        const status = await session.write({ nodeId, attributeId, value: { value: { dataType, value } } });
        return { status: status.value };
    },
    async subscribe(request) {
        const subscription = await session.createSubscription2({
            requestedPublishingInterval: request.interval,
            requestedLifetimeCount: 1000,
            requestedMaxKeepAliveCount: 10,
            publishingEnabled: true,
        });
        const indexRange = request.range ? new opcua.NumericRange(request.range) : undefined;
        const items = request.subscribe.map((nodeId) => ({ nodeId, attributeId: opcua.AttributeIds.Value, indexRange }));
        const parameters = { samplingInterval: request.interval, queueSize: 100, discardOldest: true };
        const timestamps = opcua.TimestampsToReturn[request.timestamps || "Both"];
        const group = await subscription.monitorItems(items, parameters, timestamps);
        groups.set(request.subscribe[0], [group, parameters, subscription]);
        group.on("changed", (item, dataValue, index) =>
            say({ notification: request.subscribe[index], ...sample(dataValue) })
        );
        const statuses = group.monitoredItems.map((item) => item.result.statusCode.value);
        return { interval: subscription.publishingInterval, statuses };
    },
    async modify(request) {
        const [group, parameters] = groups.get(request.modify);
        await group.modify(parameters, opcua.TimestampsToReturn[request.timestamps]);
        return {};
    },
    async pace(request) {
        const [, , subscription] = groups.get(request.pace);
        await subscription.modify({
            requestedPublishingInterval: request.interval,
            requestedLifetimeCount: 1000,
            requestedMaxKeepAliveCount: 10,
        });
        return { interval: subscription.publishingInterval };
    },
    async unsubscribe(request) {
        const [group, , subscription] = groups.get(request.unsubscribe);
        groups.delete(request.unsubscribe);
        await group.terminate();
        await subscription.terminate();
        return {};
    },
    async disconnect() {
        await session.close();
        await client.disconnect();
        return {};
    },
};

serve(commands);
