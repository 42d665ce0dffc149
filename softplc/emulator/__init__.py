"""The emulated PLC: a pure plant step, seeded noise, and servers that serve it."""
