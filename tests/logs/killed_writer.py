"""Run as a program: logs one transaction after another until it is killed, and says what it did."""

from __future__ import annotations

import sys
import threading
import time

from mbtool.logs.writer import LogWriter
from tests.logs.samples import chunk, transaction


def main(path: str, pause_s: float) -> None:
    log = LogWriter(path, capture={"host": "bench"})
    never = threading.Event()
    number = 0
    while True:
        log.write(chunk(number))
        log.write(transaction(number))
        sys.stdout.write(f"{number} {time.monotonic_ns()}\n")
        sys.stdout.flush()
        log.tick(time.monotonic_ns())
        never.wait(pause_s)
        log.tick(time.monotonic_ns())
        number += 1


if __name__ == "__main__":
    main(sys.argv[1], float(sys.argv[2]))
