"use strict";
// A node-opcua client for bench/opcua_fast_server.py: node opcua_reader.js FOLDER, one JSON request per line on stdin.
//
//   {"connect": url, "nodes": [nodeId, ...], "batch": n}   answers {}
//   {"read": times}            Reads of all nodes, at most `batch` in each request; answers {bad}: how many were not Good
//   {"monitor": ms}            items on all nodes, publishing and sampling at this interval; answers {bad}
//   {"heard": true}            notifications so far
//   {"disconnect": true}

const opcua = require("node-opcua");
const path = require("node:path");
const { serve } = require("../tests/peers/json_lines.js");

let client, session, nodes, batch, heard = 0;

const split = (items) => Array.from({ length: Math.ceil(items.length / batch) }, (_, i) => items.slice(i * batch, (i + 1) * batch));

const commands = {
    async connect(request) {
        client = opcua.OPCUAClient.create({
            endpointMustExist: false,
            clientCertificateManager: new opcua.OPCUACertificateManager({ rootFolder: path.join(process.argv[2], "pki-client") }),
        });
        await client.connect(request.connect);
        session = await client.createSession();
        batch = request.batch;
        nodes = request.nodes.map((nodeId) => ({ nodeId: opcua.resolveNodeId(nodeId), attributeId: opcua.AttributeIds.Value }));
        return {};
    },
    async read(request) {
        let bad = 0;
        for (let time = 0; time < request.read; time++)
            for (const some of split(nodes))
                for (const value of await session.read(some)) if (value.statusCode.value) bad++;
        return { bad };
    },
    async monitor(request) {
        const subscription = await session.createSubscription2({
            requestedPublishingInterval: request.monitor, requestedLifetimeCount: 1000, requestedMaxKeepAliveCount: 10,
            publishingEnabled: true,
        });
        subscription.on("raw_notification", (message) => {
            for (const data of message.notificationData || []) heard += (data.monitoredItems || []).length;
        });
        let bad = 0;
        for (const some of split(nodes)) {
            const parameters = { samplingInterval: request.monitor, queueSize: 1, discardOldest: true };
            const group = await subscription.monitorItems(some, parameters, opcua.TimestampsToReturn.Both);
            for (const item of group.monitoredItems) if (item.result.statusCode.value) bad++;
        }
        return { bad };
    },
    async heard() {
        return { heard };
    },
    async disconnect() {
        await session.close();
        await client.disconnect();
        return {};
    },
};

serve(commands);
