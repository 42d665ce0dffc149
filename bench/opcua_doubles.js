"use strict";
// A node-opcua server with COUNT Doubles ns=1;s=D0 … for bench/opcua_client.py and bench/opcua_fast_server.py.
//
//   node opcua_doubles.js PORT FOLDER COUNT [CHANGING]
//
// FOLDER receives the server's certificates; of CHANGING variables each has a new value every 50 ms, once a line came
// on stdin. Prints "ready" when it listens; ends when its stdin closes.

const { DataType, OPCUACertificateManager, OPCUAServer, StatusCodes } = require("node-opcua");
const path = require("node:path");

const [port, folder, count] = [Number(process.argv[2]), process.argv[3], Number(process.argv[4])];
const changing = Number(process.argv[5] || 0);

async function main() {
    const pki = new OPCUACertificateManager({ rootFolder: path.join(folder, "pki"), automaticallyAcceptUnknownCertificate: true });
    await pki.initialize();
    const server = new OPCUAServer({
        port, host: "127.0.0.1", hostname: "127.0.0.1", serverCertificateManager: pki, userCertificateManager: pki,
        serverCapabilities: { operationLimits: { maxNodesPerRead: count } },
    });
    await server.initialize();
    const namespace = server.engine.addressSpace.getOwnNamespace();
    const variables = [];
    for (let first = 0; first < count; first += 100) {
        const axis = namespace.addObject({ organizedBy: server.engine.addressSpace.rootFolder.objects, browseName: `A${first}` });
        for (let number = first; number < Math.min(first + 100, count); number++) {
            const variable = namespace.addVariable({
                componentOf: axis, browseName: `D${number}`, nodeId: `s=D${number}`, dataType: DataType.Double,
                minimumSamplingInterval: changing ? 10 : undefined,
            });
            variable.setValueFromSource({ dataType: DataType.Double, value: number + 0.5 }, StatusCodes.Good, new Date());
            variables.push(variable);
        }
    }
    await server.start();
    let scans = 0;
    const scan = () => {
        const now = new Date();
        scans++;
        for (const variable of variables.slice(0, changing))
            variable.setValueFromSource({ dataType: DataType.Double, value: scans }, StatusCodes.Good, now);
    };
    process.stdin.once("data", () => changing && setInterval(scan, 50));
    process.stdin.on("data", () => {}).on("end", () => process.exit(0));
    console.log("ready");
}

main();
