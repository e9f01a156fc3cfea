"""The bits of a frame on the bus, one by one: from the tables and figures of CAN 2.0."""

from reference import Frame


def bits_of(number: int, count: int) -> list[int]:
    """Return a number as bits, the highest first."""
    return [number >> bit & 1 for bit in reversed(range(count))]


def length_on_the_bus(frame: Frame) -> int:
    """Return the bits of a data or remote frame, with the pause behind it."""
    head = bits_of(frame.id, 29 if frame.ext else 11)
    if frame.ext:
        head = [*head[:11], 1, 1, *head[11:], int(frame.rtr), 0, 0]
    else:
        head = [*head, int(frame.rtr), 0, 0]
    bits = [0, *head, *bits_of(frame.dlc, 4)]
    for byte in b"" if frame.rtr else frame.data[: frame.dlc]:
        bits += bits_of(byte, 8)
    crc = 0
    for bit in bits:
        crc = crc << 1 ^ (0x4599 if crc >> 14 & 1 ^ bit else 0)
        crc &= 0x7FFF
    bits += bits_of(crc, 15)
    stuffed: list[int] = []
    for bit in bits:
        stuffed.append(bit)
        if len(stuffed) >= 5 and len(set(stuffed[-5:])) == 1:
            stuffed.append(1 - bit)
    return len(stuffed) + 1 + 2 + 7 + 3
