"""What a read-only Modbus TCP server must answer, frame by frame, written down from the specifications alone.

Modbus Messaging on TCP/IP Implementation Guide V1.0b (3.1.3: the header) and Modbus Application Protocol
Specification V1.1b3 (6.3, 6.4: the reads; 7: exceptions).
"""

from struct import pack, unpack_from


def expected(stream: bytes, image: bytes, units: frozenset[int] = frozenset({0, 1, 255})) -> tuple[bytes, int, bool]:
    """The responses, how many bytes are used up, and whether the connection is to be closed."""
    out = []
    at, end = 0, len(stream)
    while end - at >= 6:
        transaction, protocol, length = unpack_from(">HHH", stream, at)
        if protocol or length < 2 or length > 254:
            return b"".join(out), at, True
        if at + 6 + length > end:
            break
        unit, function = stream[at + 6], stream[at + 7]
        code = 0
        if unit not in units:
            code = 11  # gateway target device failed to respond
        elif function not in (3, 4):
            code = 1  # illegal function
        elif length != 6:
            code = 3  # illegal data value
        else:
            first, quantity = unpack_from(">HH", stream, at + 8)
            if not 1 <= quantity <= 125:
                code = 3
            elif 2 * (first + quantity) > len(image):
                code = 2  # illegal data address
            else:
                data = image[2 * first : 2 * (first + quantity)]
                out.append(pack(">HHHBBB", transaction, 0, 3 + len(data), unit, function, len(data)) + data)
        if code:
            out.append(pack(">HHHBBB", transaction, 0, 3, unit, function | 0x80, code))
        at += 6 + length
    return b"".join(out), at, False
