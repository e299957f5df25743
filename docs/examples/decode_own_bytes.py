"""Decode bytes that a program has, here of a serial line: no file, no port."""

from __future__ import annotations

import mbtool

LINE = bytes.fromhex(
    "01 03 0000 0002 c40b"  # unit 1, read two holding registers from address 0
    "01 03 04 0064 00c8 ba7a"  # their values
    "ff"  # a stray byte
)


def main() -> None:
    decoder = mbtool.Decoder("rtu@19200-8E1", devices={1: "idec-ft1a-touch"})
    for record in (*decoder.feed(LINE), *decoder.close()):
        if isinstance(record, mbtool.WireEvent):
            print(f"{record.kind}: {record.raw.hex()}")
        else:
            print(f"{record.function_name} {record.reference} -> {record.response_values}")


if __name__ == "__main__":
    main()
