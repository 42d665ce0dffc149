"""softplc's own OPC-UA server: config model here, address space, access rules and server in their own modules."""
