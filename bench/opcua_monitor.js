"use strict";
// A node-opcua client that monitors COUNT nodes of a server and counts what it hears, for bench/throughput.py.
//
//   node opcua_monitor.js URL FOLDER COUNT PATTERN INTERVAL
//
// PATTERN is a node id with K for the number, as in "ns=2;s=AK.Position". FOLDER receives the client's certificates.
// Prints "ready" when all items are there; for each line on stdin the notifications heard so far; ends with stdin.

const opcua = require("node-opcua");
const readline = require("node:readline");

const [url, folder, , pattern] = process.argv.slice(2);
const [count, interval] = [Number(process.argv[4]), Number(process.argv[6])];

async function main() {
    const client = opcua.OPCUAClient.create({
        endpointMustExist: false,
        clientCertificateManager: new opcua.OPCUACertificateManager({ rootFolder: folder }),
    });
    await client.connect(url);
    const session = await client.createSession();
    const subscription = await session.createSubscription2({
        requestedPublishingInterval: interval, requestedLifetimeCount: 600, requestedMaxKeepAliveCount: 20,
        maxNotificationsPerPublish: 0, publishingEnabled: true, priority: 1,
    });
    let heard = 0;
    const parameters = { samplingInterval: interval, discardOldest: true, queueSize: 2 };
    for (let first = 0; first < count; first += 500) {
        const items = [];
        for (let k = first; k < Math.min(first + 500, count); k++) {
            items.push({ nodeId: pattern.replace("K", String(k)), attributeId: opcua.AttributeIds.Value });
        }
        const group = await subscription.monitorItems(items, parameters, opcua.TimestampsToReturn.Both);
        group.on("changed", () => { heard += 1; });
    }
    console.log("ready");
    readline.createInterface({ input: process.stdin }).on("line", () => console.log(heard)).on("close", () => process.exit(0));
}

main().catch((error) => { console.error(error.message); process.exit(1); });
