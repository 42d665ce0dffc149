"""softplc: filtered position and velocity beside a PLC, over OPC-UA and Modbus."""

__version__ = "0.1.0"
