"""Print a graph of masters and slaves for Graphviz: `who_asks_whom.py FILE | dot -Tsvg > W.svg`."""

from __future__ import annotations

import json
import sys

import mbtool

WRITES = {5, 6, 15, 16, 22, 23}


def main(path: str) -> None:
    asked: dict[tuple[str, str], set[int]] = {}
    for one in mbtool.open(path, incomplete=True):
        master = (one.source or "").rpartition(":")[0] or "master"
        slave = f"{one.destination or one.link} unit {one.unit}"
        asked.setdefault((master, slave), set()).add(one.function)
    print("digraph { rankdir=LR; node [shape=box];")
    for (master, slave), functions in asked.items():
        label = " ".join(f"{code:02X}" for code in sorted(functions))
        color = "red" if functions & WRITES else "black"
        print(f'  {json.dumps(master)} -> {json.dumps(slave)} [label="{label}", color={color}];')
    print("}")


if __name__ == "__main__":
    main(*sys.argv[1:])
