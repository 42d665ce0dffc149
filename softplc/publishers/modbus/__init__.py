"""softplc's own Modbus TCP server: config model, register map, strict protocol and server in their own modules."""
