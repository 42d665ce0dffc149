// Reads and writes a Modbus TCP server with a third-party library and prints what came as one line of JSON.
//
//   node modbus_client.js <modbus-serial|jsmodbus> <port> <unit>   with the work to do as JSON on standard input:
//   [["read", 3|4, first, count], ["write", "<method>", ...arguments]]
//
// Each result is {"hex": "…"} with the registers' bytes, {"floats": […]} added when asked with ["floats", …],
// or {"exception": code, "message": "…"}. It runs in the folder whose node_modules has the libraries.
"use strict";
const { createRequire } = require("module");
const path = require("path");
const net = require("net");
const load = createRequire(path.join(process.cwd(), "package.json"));

async function modbusSerial(port, unit) {
  const ModbusRTU = load("modbus-serial");
  const client = new ModbusRTU();
  await client.connectTCP("127.0.0.1", { port });
  client.setID(unit);
  client.setTimeout(20000);
  return {
    read: async (table, first, count) => {
      const read = table === 4 ? client.readInputRegisters : client.readHoldingRegisters;
      return (await read.call(client, first, count)).buffer;
    },
    write: (method, args) => client[method](...args),
    code: (error) => error.modbusCode,
    close: () => new Promise((resolve) => client.close(resolve)),
  };
}

async function jsModbus(port, unit) {
  const modbus = load("jsmodbus");
  const socket = new net.Socket();
  const client = new modbus.client.TCP(socket, unit, 20000);
  await new Promise((resolve, reject) => {
    socket.once("connect", resolve);
    socket.once("error", reject);
    socket.connect({ host: "127.0.0.1", port });
  });
  return {
    read: async (table, first, count) => {
      const read = table === 4 ? client.readInputRegisters : client.readHoldingRegisters;
      return (await read.call(client, first, count)).response.body.valuesAsBuffer;
    },
    write: (method, args) => client[method](...args),
    code: (error) => error.response && error.response.body && error.response.body.code,
    close: () => new Promise((resolve) => socket.end(resolve)),
  };
}

// How node's own Buffer reads a float that was sent in each order.
const FLOAT = {
  ABCD: (bytes) => bytes.readFloatBE(0),
  CDAB: (bytes) => Buffer.concat([bytes.subarray(2), bytes.subarray(0, 2)]).readFloatBE(0),
  BADC: (bytes) => Buffer.from(bytes).swap16().readFloatBE(0),
  DCBA: (bytes) => bytes.readFloatLE(0),
};

async function main() {
  const [library, port, unit] = process.argv.slice(2);
  const work = JSON.parse(require("fs").readFileSync(0, "utf8"));
  const client = await (library === "jsmodbus" ? jsModbus : modbusSerial)(Number(port), Number(unit));
  const one = async ([what, ...rest]) => {
    try {
      if (what === "write") {
        const values = rest.slice(1);
        await client.write(rest[0], values);
        return { written: true };
      }
      const bytes = await client.read(...rest);
      if (what !== "floats") return { hex: bytes.toString("hex") };
      const values = [];
      for (let at = 0; at < bytes.length; at += 4) values.push(FLOAT[rest[3]](bytes.subarray(at, at + 4)));
      return { floats: values };
    } catch (error) {
      return { exception: client.code(error) || 0, message: String(error.message || error) };
    }
  };
  // All at once: modbus-serial then has them in flight together, jsmodbus sends one after the other.
  const results = await Promise.all(work.map(one));
  await client.close();
  process.stdout.write(JSON.stringify(results) + "\n");
}

main().then(
  () => process.exit(0),
  (error) => {
    process.stderr.write(String((error && error.stack) || error) + "\n");
    process.exit(1);
  },
);
