"""Tests of the emulated PLC: its plant as numbers, its servers over real sockets."""
