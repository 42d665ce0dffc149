"use strict";
// A node-opcua server with AXES × LEAVES writable Doubles ns=1;s=A0.Position …, for bench/node_red.py.
//
//   node opcua_tags.js PORT FOLDER AXES LEAF [LEAF ...]
//
// FOLDER receives the server's certificates. Prints "ready" when it listens; ends when its stdin closes.

const { OPCUACertificateManager, OPCUAServer } = require("node-opcua");
const path = require("node:path");

const [port, folder, axes, ...leaves] = process.argv.slice(2);

async function main() {
    const pki = new OPCUACertificateManager({ rootFolder: path.join(folder, "pki"), automaticallyAcceptUnknownCertificate: true });
    await pki.initialize();
    const operationLimits = { maxNodesPerRead: 100000, maxNodesPerWrite: 100000 };
    const server = new OPCUAServer({
        port: Number(port), host: "127.0.0.1", hostname: "127.0.0.1", serverCertificateManager: pki,
        userCertificateManager: pki, serverCapabilities: { operationLimits },
    });
    await server.initialize();
    const namespace = server.engine.addressSpace.getOwnNamespace();
    for (let k = 0; k < Number(axes); k++) {
        const axis = namespace.addObject({ organizedBy: server.engine.addressSpace.rootFolder.objects, browseName: `A${k}` });
        for (const leaf of leaves) {
            const nodeId = `s=A${k}.${leaf}`;
            const accessLevel = "CurrentRead | CurrentWrite";
            const value = { dataType: "Double", value: 0 };
            namespace.addVariable({ componentOf: axis, browseName: leaf, nodeId, dataType: "Double", accessLevel, value });
        }
    }
    await server.start();
    process.stdin.on("data", () => {}).on("end", () => process.exit(0));
    console.log("ready");
}

main();
