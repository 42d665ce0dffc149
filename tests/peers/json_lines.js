// Commands on stdin, one JSON object a line, answered in their order on stdout: {"answer": name, ...} or with "error".
"use strict";
const readline = require("node:readline");

const say = (object) => process.stdout.write(JSON.stringify(object) + "\n");

// `commands` are async functions by the name of the field that asks for them; the process ends when stdin does.
function serve(commands) {
    let queue = Promise.resolve();
    const lines = readline.createInterface({ input: process.stdin });
    lines.on("line", (line) => {
        queue = queue.then(async () => {
            const request = JSON.parse(line);
            const name = Object.keys(commands).find((command) => command in request);
            try {
                say({ answer: name, ...(await commands[name](request)) });
            } catch (error) {
                say({ answer: name, error: String(error.message || error) });
            }
        });
    });
    lines.on("close", () => queue.then(() => process.exit(0)));
}

module.exports = { say, serve };
