"""The OPC-UA source: addresses, values, and the driver against real servers."""
