"""libmodbus, the C library that most panels and gateways speak Modbus with, through ctypes (Debian: libmodbus5)."""

import ctypes
import ctypes.util

import pytest

EXCEPTION = 112345678  # MODBUS_ENOBASE: errno of an exception response is this and the exception's code


def library() -> ctypes.CDLL | None:
    """The library with the argument types that matter; None when it is not installed."""
    name = ctypes.util.find_library("modbus") or "libmodbus.so.5"
    try:
        found = ctypes.CDLL(name, use_errno=True)
    except OSError:
        return None
    found.modbus_new_tcp.restype = ctypes.c_void_p
    found.modbus_new_tcp.argtypes = [ctypes.c_char_p, ctypes.c_int]
    found.modbus_strerror.restype = ctypes.c_char_p
    found.modbus_mapping_new.restype = ctypes.c_void_p
    found.modbus_mapping_free.argtypes = found.modbus_free.argtypes = found.modbus_close.argtypes = [ctypes.c_void_p]
    found.modbus_connect.argtypes = [ctypes.c_void_p]
    found.modbus_set_slave.argtypes = [ctypes.c_void_p, ctypes.c_int]
    found.modbus_set_response_timeout.argtypes = [ctypes.c_void_p, ctypes.c_uint32, ctypes.c_uint32]
    for read in (found.modbus_read_registers, found.modbus_read_input_registers):
        read.argtypes = [ctypes.c_void_p, ctypes.c_int, ctypes.c_int, ctypes.c_void_p]
    for read in (found.modbus_read_bits, found.modbus_read_input_bits):
        read.argtypes = [ctypes.c_void_p, ctypes.c_int, ctypes.c_int, ctypes.c_void_p]
    for write in (found.modbus_write_bit, found.modbus_write_register):
        write.argtypes = [ctypes.c_void_p, ctypes.c_int, ctypes.c_int]
    for write in (found.modbus_write_bits, found.modbus_write_registers):
        write.argtypes = [ctypes.c_void_p, ctypes.c_int, ctypes.c_int, ctypes.c_void_p]
    found.modbus_mask_write_register.argtypes = [ctypes.c_void_p, ctypes.c_int, ctypes.c_uint16, ctypes.c_uint16]
    transfer = [ctypes.c_int, ctypes.c_int, ctypes.c_void_p]
    found.modbus_write_and_read_registers.argtypes = [ctypes.c_void_p, *transfer, *transfer]
    found.modbus_report_slave_id.argtypes = [ctypes.c_void_p, ctypes.c_int, ctypes.c_void_p]
    found.modbus_tcp_listen.argtypes = [ctypes.c_void_p, ctypes.c_int]
    found.modbus_tcp_accept.argtypes = [ctypes.c_void_p, ctypes.c_void_p]
    found.modbus_receive.argtypes = [ctypes.c_void_p, ctypes.c_void_p]
    found.modbus_reply.argtypes = [ctypes.c_void_p, ctypes.c_void_p, ctypes.c_int, ctypes.c_void_p]
    return found


def need_libmodbus() -> ctypes.CDLL:
    """The library; skips the test when it is not installed."""
    found = library()
    if found is None:
        pytest.skip("libmodbus is not installed: apt install libmodbus5")
    return found


class LibmodbusClient:
    """A connection of libmodbus. Its calls wait, so they belong in a thread."""

    def __init__(self, modbus: ctypes.CDLL, port: int, unit: int = 1) -> None:
        self._modbus = modbus
        self._context = modbus.modbus_new_tcp(b"127.0.0.1", port)
        modbus.modbus_set_slave(self._context, unit)
        modbus.modbus_set_response_timeout(self._context, 20, 0)
        if modbus.modbus_connect(self._context) != 0:
            raise ConnectionError(modbus.modbus_strerror(ctypes.get_errno()).decode())

    def __enter__(self) -> "LibmodbusClient":
        return self

    def __exit__(self, *_: object) -> None:
        self._modbus.modbus_close(self._context)
        self._modbus.modbus_free(self._context)

    def read(self, table: int, first: int, count: int) -> bytes:
        """Registers as bytes, high byte first. Raises OSError."""
        read = self._modbus.modbus_read_input_registers if table == 4 else self._modbus.modbus_read_registers
        words = (ctypes.c_uint16 * max(count, 1))()
        if read(self._context, first, count, words) != count:
            number = ctypes.get_errno()
            raise OSError(number, self._modbus.modbus_strerror(number).decode())
        return b"".join(int(word).to_bytes(2, "big") for word in words)

    def exception(self, call: str, *arguments: object) -> int:
        """The exception code that a call is answered with; 0 when it succeeds, an errno when there is no answer."""
        if getattr(self._modbus, f"modbus_{call}")(self._context, *arguments) != -1:
            return 0
        number = ctypes.get_errno()
        return number - EXCEPTION if number > EXCEPTION else number
