// A Modbus TCP server by modbus-serial, as a PLC for the tests. Prints {"port": n} when it listens; ends when stdin
// closes. Each line on stdin is a command as JSON, answered by one line of JSON:
//   {"op": "put", "table", "offset", "type", "order", "value"}   store a value, encoded by Node's Buffer
//   {"op": "get", "table", "offset", "type", "order"}            {"value": "..."} as Node's Buffer decodes it
//   {"op": "refuse", "table", "offset", "code"}                  answer exception `code` wherever the offset is touched
//   {"op": "refuseSingle", "code"}                               answer exception `code` to function 6
//   {"op": "clock", "offset"}                                    a float64 there: 10 a second, and tells when it was made
//   {"op": "requests"}                                           [[function, address, count or value], ...] since last asked
"use strict";

const readline = require("readline");
const { ServerTCP } = require("modbus-serial");

const SIZE = 65536;
const registers = { holding: Buffer.alloc(2 * SIZE), input: Buffer.alloc(2 * SIZE) };
const bits = { coil: new Uint8Array(SIZE), discrete: new Uint8Array(SIZE) };
const refused = { holding: new Map(), input: new Map(), coil: new Map(), discrete: new Map() };
let refuseSingle = 0;
let clock = null;
let requests = [];

const CODEC = {
    bool: [2, (b) => b.readUInt16BE() !== 0, (b, v) => b.writeUInt16BE(v === "true" ? 1 : 0)],
    int16: [2, (b) => b.readInt16BE(), (b, v) => b.writeInt16BE(Number(v))],
    uint16: [2, (b) => b.readUInt16BE(), (b, v) => b.writeUInt16BE(Number(v))],
    int32: [4, (b) => b.readInt32BE(), (b, v) => b.writeInt32BE(Number(v))],
    uint32: [4, (b) => b.readUInt32BE(), (b, v) => b.writeUInt32BE(Number(v))],
    int64: [8, (b) => b.readBigInt64BE(), (b, v) => b.writeBigInt64BE(BigInt(v))],
    uint64: [8, (b) => b.readBigUInt64BE(), (b, v) => b.writeBigUInt64BE(BigInt(v))],
    float32: [4, (b) => b.readFloatBE(), (b, v) => b.writeFloatBE(Number(v))],
    float64: [8, (b) => b.readDoubleBE(), (b, v) => b.writeDoubleBE(Number(v))],
};

// Each order turns big-endian bytes into wire bytes; done twice it is undone.
function reorder(bytes, order) {
    const copy = Buffer.from(bytes);
    if (copy.length === 2 || order === "ABCD") return copy;
    if (order === "DCBA") return copy.reverse();
    if (order === "BADC") return copy.swap16();
    return copy.swap16().reverse(); // CDAB: the words in reverse, each as it was
}

function touch(table, offset) {
    if (refused[table].has(offset)) throw { modbusErrorCode: refused[table].get(offset) };
}

const vector = {
    getCoil: (offset) => { touch("coil", offset); return bits.coil[offset] === 1; },
    getDiscreteInput: (offset) => { touch("discrete", offset); return bits.discrete[offset] === 1; },
    getHoldingRegister: (offset) => {
        touch("holding", offset);
        if (offset === clock) registers.holding.writeDoubleBE((Date.now() % 1e7) / 100, 2 * offset);
        return registers.holding.readUInt16BE(2 * offset);
    },
    getInputRegister: (offset) => { touch("input", offset); return registers.input.readUInt16BE(2 * offset); },
    setCoil: (offset, on) => { touch("coil", offset); bits.coil[offset] = on ? 1 : 0; },
    setRegister: (offset, value) => {
        if (refuseSingle) throw { modbusErrorCode: refuseSingle };
        touch("holding", offset);
        registers.holding.writeUInt16BE(value, 2 * offset);
    },
    setRegisterArray: (offset, values) => {
        values.forEach((_, i) => touch("holding", offset + i));
        values.forEach((value, i) => registers.holding.writeUInt16BE(value, 2 * (offset + i)));
    },
};

const OPS = {
    put({ table, offset, type, order, value }) {
        if (bits[table]) {
            bits[table][offset] = value === "true" ? 1 : 0;
            return {};
        }
        const [size, , write] = CODEC[type];
        const plain = Buffer.alloc(size);
        write(plain, value);
        reorder(plain, order).copy(registers[table], 2 * offset);
        return {};
    },
    get({ table, offset, type, order }) {
        if (bits[table]) return { value: String(bits[table][offset] === 1) };
        const [size, read] = CODEC[type];
        const plain = reorder(registers[table].subarray(2 * offset, 2 * offset + size), order);
        return { value: String(read(plain)) };
    },
    refuse({ table, offset, code }) {
        if (code) refused[table].set(offset, code);
        else refused[table].delete(offset);
        return {};
    },
    refuseSingle({ code }) {
        refuseSingle = code;
        return {};
    },
    clock({ offset }) {
        clock = offset;
        return {};
    },
    requests() {
        const since = requests;
        requests = [];
        return { requests: since };
    },
};

const server = new ServerTCP(vector, { host: "127.0.0.1", port: "0", unitID: 255 });
server.on("initialized", () => console.log(JSON.stringify({ port: server._server.address().port })));
server.on("socketError", () => {}); // clients may go as they like
server._server.on("connection", (socket) => {
    socket.on("data", (data) => requests.push([data[7], data.readUInt16BE(8), data.readUInt16BE(10)]));
});

readline.createInterface({ input: process.stdin }).on("line", (line) => {
    const command = JSON.parse(line);
    console.log(JSON.stringify(OPS[command.op](command)));
}).on("close", () => process.exit(0));
