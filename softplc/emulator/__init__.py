"""The emulated PLC: a pure plant step, seeded noise and faults, and servers that serve it.

It imports no driver and no codec of softplc: a mistake in one of them cannot cancel itself out here.
`Scenario` describes it, `serve` runs it in this process, `run_emulator` in a process of its own.
"""
