"""Modbus as a source: config models, pure address and register codec, request planning, and the driver."""
