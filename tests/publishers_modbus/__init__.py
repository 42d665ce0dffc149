"""The Modbus server against its own rules and against independent clients."""
