"use strict";
// A PLC on node-opcua for the tests of the OPC-UA source: every number type, arrays, Bad and Uncertain tags, a ramp.
//
//   node opcua_server.js PORT FOLDER [OPTIONS as JSON]
//
// FOLDER receives the server's certificates. Prints "ready PORT" when it listens; ends when its stdin closes.
// OPTIONS: shift     register another namespace first, so that the index of ours becomes 3
//          without   names of variables that are left out
//          maxRead   the MaxNodesPerRead that the server tells and keeps
//          maxItems  the most monitored items that a subscription may have
//          as        {name: type} variables of another type than usual
// Lines on stdin: "set NAME VALUE", "bad NAME", "good NAME", "remove NAME", "add NAME", "retype NAME TYPE", "drop" all
// subscriptions, "count" sessions and subscriptions; each is answered "ok" and what it gives.

const {
    AccessLevelFlag, DataType, DataValue, OPCUACertificateManager, OPCUAServer, StatusCodes, TimestampsToReturn, Variant,
    VariantArrayType, coerceInt64, coerceUInt64,
} = require("node-opcua");
const path = require("node:path");
const readline = require("node:readline");

const [port, folder] = [Number(process.argv[2]), process.argv[3]];
const options = JSON.parse(process.argv[4] || "{}");
const URI = "urn:softplc:test:plc";

const SCALARS = {
    Bool: [DataType.Boolean, true],
    SByte: [DataType.SByte, -128],
    Byte: [DataType.Byte, 255],
    Int16: [DataType.Int16, -32768],
    UInt16: [DataType.UInt16, 65535],
    Int32: [DataType.Int32, -2147483648],
    UInt32: [DataType.UInt32, 4294967295],
    Int64: [DataType.Int64, coerceInt64("-1234567890123")],
    UInt64: [DataType.UInt64, coerceUInt64("1234567890123")],
    Float: [DataType.Float, 0.5],
    Double: [DataType.Double, 1e300],
    Text: [DataType.String, "seven"],
};
const STAMP = new Date("2024-05-17T08:30:00.123Z");

async function main() {
    const pki = new OPCUACertificateManager({ rootFolder: path.join(folder, "pki"), automaticallyAcceptUnknownCertificate: true });
    await pki.initialize();
    const server = new OPCUAServer({
        port,
        host: "127.0.0.1",
        hostname: "127.0.0.1",
        buildInfo: { productName: "test plc" },
        serverInfo: { applicationUri: "urn:softplc:test:server" },
        serverCertificateManager: pki,
        userCertificateManager: pki,
        userManager: { isValidUser: (name, password) => name === "operator" && password === "secret" },
        serverCapabilities: {
            ...(options.maxRead && { operationLimits: { maxNodesPerRead: options.maxRead } }),
            ...(options.maxItems && { maxMonitoredItemsPerSubscription: options.maxItems }),
        },
    });
    await server.initialize();
    const space = server.engine.addressSpace;
    if (options.shift) space.registerNamespace("urn:softplc:test:another");
    const namespace = space.registerNamespace(URI);
    const plc = namespace.addObject({ organizedBy: space.rootFolder.objects, browseName: "PLC", nodeId: "s=PLC" });
    const axis = namespace.addObject({ componentOf: plc, browseName: "Axis", nodeId: "s=PLC.Axis" });
    const variables = {};

    function add(name, dataType, more) {
        if (options.as && options.as[name]) dataType = DataType[options.as[name]];
        const variable = namespace.addVariable({
            componentOf: axis, browseName: name, nodeId: `s=PLC.Axis.${name}`, dataType,
            minimumSamplingInterval: 5, ...more,
        });
        variables[name] = variable;
        return variable;
    }

    const constant = (name, dataType, value) => () => {
        const variable = add(name, dataType, {});
        if (options.as && options.as[name]) dataType = DataType[options.as[name]];
        if (dataType === DataType.String) value = String(value);
        else if (options.as && options.as[name]) value = Math.trunc(Number(value));
        variable.setValueFromSource(
            new Variant({ dataType, arrayType: VariantArrayType.Scalar, value }), StatusCodes.Good, STAMP);
    };
    const array = (name, dataType, value, dimensions) => () =>
        add(name, dataType, { valueRank: dimensions ? dimensions.length : 1, arrayDimensions: dimensions }).setValueFromSource(
            new Variant({ dataType, arrayType: dimensions ? VariantArrayType.Matrix : VariantArrayType.Array, value, dimensions }),
            StatusCodes.Good, STAMP);
    const live = (name, get) => () => add(name, DataType.Double, { value: { timestamped_get: get } });

    const begin = Date.now();
    const makers = {
        Ramp: live("Ramp", () => new DataValue({
            value: { dataType: DataType.Double, value: (Date.now() - begin) / 1000 }, sourceTimestamp: new Date(),
        })),
        Clock: live("Clock", () => { // 10 a second; the value tells when it was made
            const now = Date.now();
            const value = (now % 1e7) / 100;
            return new DataValue({ value: { dataType: DataType.Double, value }, sourceTimestamp: new Date(now) });
        }),
        Late: live("Late", () => new DataValue({
            value: { dataType: DataType.Double, value: 5 }, sourceTimestamp: new Date(Date.now() - 3600000),
        })),
        Doubles: array("Doubles", DataType.Double, new Float64Array([10.5, 11.5, 12.5])),
        Words: array("Words", DataType.UInt16, new Uint16Array([7, 8, 9])),
        Scratch: array("Scratch", DataType.Float, new Float32Array([0, 0, 0])),
        Matrix: array("Matrix", DataType.Float, new Float32Array([1, 2, 3, 4, 5, 6]), [2, 3]),
        Bad: () => add("Bad", DataType.Double, {}).setValueFromSource(
            { dataType: DataType.Double, value: 13 }, StatusCodes.BadSensorFailure, STAMP),
        Uncertain: () => add("Uncertain", DataType.Double, {}).setValueFromSource(
            { dataType: DataType.Double, value: 14 }, StatusCodes.UncertainSensorNotAccurate, STAMP),
        NaN: constant("NaN", DataType.Double, NaN),
        Inf: constant("Inf", DataType.Double, Infinity),
        Secret: () => add("Secret", DataType.Double, { accessLevel: 0, userAccessLevel: 0 }),
        ReadOnly: () => add("ReadOnly", DataType.Double, { accessLevel: AccessLevelFlag.CurrentRead, userAccessLevel: AccessLevelFlag.CurrentRead })
            .setValueFromSource({ dataType: DataType.Double, value: 1 }),
        Target: () => add("Target", DataType.Float, {}).setValueFromSource({ dataType: DataType.Float, value: 0 }),
        Count: () => add("Count", DataType.Int16, {}).setValueFromSource({ dataType: DataType.Int16, value: 0 }),
        Flag: () => add("Flag", DataType.Boolean, {}).setValueFromSource({ dataType: DataType.Boolean, value: false }),
        Changing: constant("Changing", DataType.Double, 1),
        Mode: () => add("Mode", namespace.addEnumerationType({
            browseName: "ModeType", enumeration: ["Stop", "Run", "Jog"],
        }), {}).setValueFromSource({ dataType: DataType.Int32, value: 2 }, StatusCodes.Good, STAMP),
        Span: () => add("Span", "Duration", {}).setValueFromSource(
            { dataType: DataType.Double, value: 0 }, StatusCodes.BadWaitingForInitialData),
        Label: () => add("Label", "LocaleId", {}).setValueFromSource(
            { dataType: DataType.String, value: "" }, StatusCodes.BadWaitingForInitialData),
        Lazy: () => add("Lazy", DataType.Double, { minimumSamplingInterval: 400, value: {
            timestamped_get: () => new DataValue({ value: { dataType: DataType.Double, value: 1 }, sourceTimestamp: new Date() }),
        } }),
        Held: () => add("Held", DataType.Double, {}).setValueFromSource({ dataType: DataType.Double, value: 3 }),
    };
    for (const [name, [dataType, value]] of Object.entries(SCALARS)) makers[name] = constant(name, dataType, value);
    for (const [name, make] of Object.entries(makers)) if (!(options.without || []).includes(name)) make();

    await server.start();
    console.log(`ready ${server.endpoints[0].port}`);

    const commands = {
        set: (name, value) => {
            const dataType = variables[name].dataTypeObj.basicDataType;
            const number = Number(value);
            variables[name].setValueFromSource({ dataType, value: dataType === DataType.Boolean ? number !== 0 : number });
        },
        bad: (name) => {
            const value = { dataType: variables[name].dataTypeObj.basicDataType, value: 0 };
            variables[name].setValueFromSource(value, StatusCodes.BadSensorFailure);
        },
        add: (name) => void makers[name](),
        remove: (name) => void space.deleteNode(variables[name]),
        count: () => `${server.currentSessionCount} ${server.currentSubscriptionCount}`,
        drop: () => {
            for (const session of Object.values(server.engine._sessions))
                for (const subscription of session.publishEngine.subscriptions) subscription.terminate();
        },
        retype: (name, type) => {
            space.deleteNode(variables[name]);
            options.as = { ...options.as, [name]: type };
            makers[name]();
        },
    };
    const lines = readline.createInterface({ input: process.stdin });
    lines.on("line", (line) => {
        const [command, ...words] = line.split(" ");
        console.log(`ok ${commands[command](...words) ?? ""}`.trim());
    });
    lines.on("close", () => process.exit(0));
}

main().catch((error) => {
    console.error(error);
    process.exit(1);
});
