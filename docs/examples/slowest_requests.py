"""Print the five slowest requests of a capture, and what went wrong: `slowest_requests.py FILE`."""

from __future__ import annotations

import sys

import mbtool


def main(path: str) -> None:
    capture = mbtool.open(path, incomplete=True)
    answered = [one for one in capture if one.latency_ns is not None]
    answered.sort(key=lambda one: one.latency_ns or 0, reverse=True)
    for one in answered[:5]:
        print(f"{(one.latency_ns or 0) / 1e6:8.1f} ms  unit {one.unit}  {one.reference}")
    for event in capture.events():
        print(f"{event.kind}: {event.message}")
    for remark in capture.remarks:
        print(remark, file=sys.stderr)


if __name__ == "__main__":
    main(*sys.argv[1:])
