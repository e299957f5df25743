"""Let a recording answer, and ask it: `poll_a_recording.py FILE` (`pip install pymodbus`)."""

from __future__ import annotations

import sys

from pymodbus.client import ModbusTcpClient

import mbtool


def main(path: str) -> None:
    with mbtool.Replay(path, match="image", latency="none") as slave:
        with ModbusTcpClient(slave.host, port=slave.port) as client:
            answer = client.read_holding_registers(0, count=4, device_id=slave.units[0])
        print(answer.registers)
        for line in slave.lines():
            print(line)


if __name__ == "__main__":
    main(*sys.argv[1:])
