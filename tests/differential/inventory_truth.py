"""Compares the inventory of captures made by others with what tshark says is in them.

`python -m tests.differential.inventory_truth` prints a table of all of them.
"""

# The truth of a capture FILE is FILE.adu.csv, one row for each ADU (truth.py). From it follow the
# hosts, with their ports; the units of each; the functions of each unit; and the addresses that the
# requests of each function name. The calculation here shares no code with the inventory: addresses
# are sets of numbers.
#
# EXPLAINED lists the captures in which both differ for a reason.

from __future__ import annotations

import csv
import sys
from collections import defaultdict
from typing import TYPE_CHECKING

from mbtool.core import CutError, WireEvent
from mbtool.ledger.account import Account
from mbtool.ledger.inventory import inventory
from mbtool.workflows.shared.reading import Reading, ReadingOptions
from tests.captures import FOLDER, public_folder
from tests.differential.truth import PORTS

if TYPE_CHECKING:
    from pathlib import Path

    from mbtool.ledger.inventory_rows import InventoryDocument

Slave = tuple[str, int, int]
"""Host, port and unit."""
Facts = dict[Slave, dict[int, set[int]]]
"""The functions of each slave, and the addresses that requests of each function name."""

_WITH_ADDRESSES = {1, 2, 3, 4, 5, 6, 15, 16, 22}
EXPLAINED = {
    "snap62_quickdraw2.pcap": (
        2,
        "tshark shows no Modbus layer for ADUs that the capture cut; mbtool reads their function",
    ),
    "fuzz-72.pcap": (
        5,
        "a fuzzer changed sequence numbers; mbtool reads units and functions from bytes that "
        "tshark takes for retransmitted",
    ),
}
"""The number of differences in a capture, and why."""


def captures_with_adus(folder: Path) -> list[Path]:
    """Every packet capture with a truth of addresses, without the recordings of serial lines."""
    return sorted(
        path
        for path in folder.rglob("*.pcap*")
        if path.suffix != ".csv" and path.with_name(path.name + ".adu.csv").exists()
    )


def differences(path: Path, document: InventoryDocument) -> list[str]:
    """What the inventory of a capture and its truth do not have in common, one line each."""
    found, truth = inventory_facts(document), truth_facts(path)
    lines = []
    for slave in sorted(found.keys() | truth.keys()):
        if slave not in truth or slave not in found:
            lines.append(f"{slave}: only in {'the truth' if slave in truth else 'the inventory'}")
            continue
        functions = found[slave].keys() | truth[slave].keys()
        for function in sorted(functions):
            if function not in found[slave] or function not in truth[slave]:
                where = "the truth" if function in truth[slave] else "the inventory"
                lines.append(f"{slave} function {function}: only in {where}")
            elif found[slave][function] != truth[slave][function]:
                missing = sorted(truth[slave][function] - found[slave][function])
                extra = sorted(found[slave][function] - truth[slave][function])
                lines.append(
                    f"{slave} function {function}: {len(missing)} addresses only in the truth "
                    f"{missing[:3]}, {len(extra)} only in the inventory {extra[:3]}"
                )
    return lines


def taken(path: Path) -> Account:
    """The account of a capture, as far as it can be read."""
    account = Account(observes=True)
    reading = Reading([str(path)], ReadingOptions(ports=PORTS.get(path.name, (502,))))
    try:
        for record in reading.records():
            if not isinstance(record, WireEvent):
                account.add(record)
    except CutError:
        pass
    return account


def inventory_facts(document: InventoryDocument) -> Facts:
    """Hosts, units, functions and addresses as the inventory has them."""
    facts: Facts = {}
    for row in document.slaves:
        functions: dict[int, set[int]] = defaultdict(set)
        for use in row.uses:
            functions[use.function].update(
                address
                for first, last in (*use.ranges, *use.refused)
                for address in range(first, last + 1)
                if use.function in _WITH_ADDRESSES
            )
        facts[row.host, row.port or 0, row.unit] = functions
    return facts


def truth_facts(path: Path) -> Facts:
    """The same as tshark has it."""
    facts: Facts = defaultdict(lambda: defaultdict(set))
    with path.with_name(path.name + ".adu.csv").open(newline="") as file:
        for row in csv.DictReader(file):
            if not row["unit"] or not row["fc"]:
                continue
            # Where tshark says "?", because both ports are known to it, a response still names
            # the packet of its request.
            is_request = row["kind"] == "req" or (row["kind"] == "?" and not row["request_frame"])
            host, port = (row["dst"], row["dport"]) if is_request else (row["src"], row["sport"])
            function = int(row["fc"])
            addresses = facts[host, int(port), int(row["unit"])][function]
            # The response to a write repeats the addresses; that of a read has none.
            if row["ref"] and not row["exc"] and function in _WITH_ADDRESSES:
                count = int(row["word_cnt"] or row["bit_cnt"] or 1)
                first = int(row["ref"])
                addresses.update(range(first, min(first + max(count, 1), 0x10000)))
    return facts


def main(folder: Path) -> int:
    """Print the table; the answer is 1 where a difference is not explained, 3 without captures."""
    paths = captures_with_adus(folder)
    if not paths:
        print(f"{folder}: no capture with its truth; {FOLDER} names their folder", file=sys.stderr)
        return 3
    unexplained = 0
    for path in paths:
        lines = differences(path, inventory(taken(path)))
        count, reason = EXPLAINED.get(path.name, (0, ""))
        note = "" if not lines else reason if len(lines) == count else "DIFFERS"
        unexplained += note == "DIFFERS"
        print(f"{path.relative_to(folder)!s:<85} {len(lines):>4} {note}")
        if note == "DIFFERS":
            print(*(f"    {line}" for line in lines[:8]), sep="\n")
    return int(unexplained > 0)


if __name__ == "__main__":
    sys.exit(main(public_folder()))
