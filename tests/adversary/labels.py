"""Scores the findings about attacks (SEC-*) of captures whose packets are labelled.

    python -m tests.adversary.labels FOLDER

FOLDER has NAME.pcap and NAME_labeled.csv, with rows `number of the packet;0 or 1`, as in
https://github.com/antoine-lemay/Modbus_dataset. A transaction is an attack if a packet of it has
label 1, and is told if a finding lists its packets.
"""

from __future__ import annotations

import argparse
import json
import sys
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import dataclass
from io import StringIO
from pathlib import Path

from mbtool.cli.main import run


@dataclass(frozen=True, slots=True)
class Score:
    """How many transactions are attacks, told, both, and in all."""

    transactions: int
    attacks: int
    told: int
    both: int

    @property
    def precision(self) -> float:
        return self.both / self.told if self.told else 1.0

    @property
    def recall(self) -> float:
        return self.both / self.attacks if self.attacks else 1.0


def score(capture: Path, labels: Path, prefix: str = "SEC") -> Score:
    attacks = labelled(labels)
    told = told_packets(capture, prefix)
    rows = [packets for packets in transactions(capture) if packets]
    is_attack = [not attacks.isdisjoint(packets) for packets in rows]
    is_told = [not told.isdisjoint(packets) for packets in rows]
    both = sum(one and other for one, other in zip(is_attack, is_told, strict=True))
    return Score(len(rows), sum(is_attack), sum(is_told), both)


def labelled(path: Path) -> set[int]:
    """The numbers of the packets with label 1."""
    rows = (line.split(";") for line in path.read_text(encoding="utf-8-sig").split())
    return {int(number) for number, label in rows if label == "1"}


def told_packets(capture: Path, prefix: str) -> set[int]:
    """The numbers of the packets that findings list."""
    document = json.loads(_printed("check", str(capture), "--format", "json"))
    found = (one for one in document["findings"] if one["code"].startswith(prefix))
    return {
        number
        for one in found
        for case in one.get("cases") or [one.get("packets", ())]
        for number in case
    }


def transactions(capture: Path) -> list[set[int]]:
    """The numbers of the packets of each transaction."""
    lines = _printed("decode", str(capture), "--format", "jsonl").splitlines()
    rows = (json.loads(line) for line in lines)
    keys = ("request_packet", "response_packet")
    return [{row[key] for key in keys if row.get(key)} for row in rows if "outcome" in row]


def _printed(*arguments: str) -> str:
    said = StringIO()
    with redirect_stdout(said), redirect_stderr(StringIO()):
        run(list(arguments))
    return said.getvalue()


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n", maxsplit=1)[0])
    parser.add_argument("folder", type=Path)
    folder: Path = parser.parse_args().folder
    row = "{:45}{:>13}{:>9}{:>7}{:>7}{:>11}{:>8}\n"
    sys.stdout.write(
        row.format("capture", "transactions", "attacks", "told", "both", "precision", "recall")
    )
    for labels in sorted(folder.glob("*_labeled.csv")):
        capture = labels.with_name(labels.name.replace("_labeled.csv", ".pcap"))
        if capture.exists():
            one = score(capture, labels)
            sys.stdout.write(
                row.format(
                    capture.stem, one.transactions, one.attacks, one.told, one.both,
                    f"{one.precision:.1%}", f"{one.recall:.1%}",
                )
            )  # fmt: skip


if __name__ == "__main__":
    main()
