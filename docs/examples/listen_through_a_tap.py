"""Listen between a master and a slave, and keep a log: all three run in this script."""

from __future__ import annotations

import socket
import sys

import mbtool

READ = bytes.fromhex("0001 0000 0006 01 03 0000 0002")  # two holding registers, Modbus/TCP


def main(log: str) -> None:
    with mbtool.Slave("idec-ft1a-touch", image={"HR400001": [100, 200]}) as slave:
        tap = f"tap:127.0.0.1:0={slave.host}:{slave.port}"
        with mbtool.sniff(tap, devices={1: "idec-ft1a-touch"}, log=log) as capture:
            port = int(capture.places[0].partition("=")[0].rpartition(":")[2])
            with socket.create_connection(("127.0.0.1", port)) as master:
                master.sendall(READ)
                for one in capture.transactions(seconds=10, count=1):
                    print(f"{one.reference} -> {one.response_values}")


if __name__ == "__main__":
    main(*sys.argv[1:])
