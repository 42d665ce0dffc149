"""A program that starts an emulated PLC on the port it is told, says "ready", and waits to be killed."""

import sys
import time

from tests.emulator.scenarios import scenario, spawn

if __name__ == "__main__":
    _, connection = spawn(scenario(modbus={"port": int(sys.argv[1])}))
    print(connection.recv()[0], flush=True)
    time.sleep(600)
