"""Makes captures/plant.pcap anew: python -m tests.golden.plant_capture captures/plant.pcap.

A control room polls a drive, and two units behind a gateway. Unit 2 is slow and once silent, and a
panel writes the drive's setpoints. docs/table.md answers its questions with this capture. The
packets are made from bytes, with times that are reckoned, so each run makes the same file.
"""

from __future__ import annotations

import sys
from pathlib import Path
from random import Random

from tests.golden.findings_captures import Net

ROOM, PANEL, DRIVE, GATEWAY = "10.0.0.1", "10.0.0.2", "10.0.0.11", "10.0.0.12"
CYCLES = 20


def plant() -> bytes:
    net, chance = Net(), Random("plant")
    drive = net.open(50001, master=ROOM, slave=DRIVE)
    gateway = net.open(50002, master=ROOM, slave=GATEWAY)
    panel = net.open(50003, master=PANEL, slave=DRIVE)
    for cycle in range(CYCLES):
        begin_ns = net.now_ns
        speed = (1480 + chance.randrange(40)).to_bytes(2).hex()
        net.ask(drive, "03 0064 0004").wait(2 + chance.random())
        net.answer(drive, f"03 08 {speed} 05dc 0000 0001")
        net.ask(gateway, "04 0000 0002", unit=1).wait(18 + 4 * chance.random())
        net.answer(gateway, f"04 04 {230 + cycle % 3:04x} 0032", unit=1)
        net.ask(gateway, "04 0000 0002", unit=2).wait(95 + 60 * chance.random())
        if cycle == 7:
            net.wait(845)
        else:
            net.answer(gateway, "04 04 00e6 0031", unit=2)
        if cycle == 12:
            net.ask(gateway, "03 1388 0002", unit=1).wait(15).answer(gateway, "83 02", unit=1)
        if cycle == 5:
            net.ask(panel, "06 0069 05dc").wait(2).answer(panel, "06 0069 05dc")
        if cycle == 15:
            net.ask(panel, "10 0068 0003 06 0001 0640 0000").wait(3).answer(panel, "10 0068 0003")
        net.now_ns = max(net.now_ns, begin_ns + 1_000_000_000)
    return net.file()


if __name__ == "__main__":
    Path(sys.argv[1]).write_bytes(plant())
