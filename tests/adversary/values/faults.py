"""Injects faults of values into recordings, and counts which `check` names.

`python -m tests.adversary.values.faults [--devices 20] [--seed TEXT]`: recordings that others made
(shared captures), and generated devices, drawn by the hash of the last commit. A fault is only
injected where the recording shows how the value moves: MOVES changes before it, and room behind it.
With `--shared`, only what is told of all shared captures as they are.
"""

from __future__ import annotations

import argparse
import json
import math
import struct
import subprocess
from collections import Counter
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import dataclass, field
from io import StringIO
from itertools import pairwise
from pathlib import Path
from random import Random
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

from mbtool.cli.main import run
from mbtool.core import InputError, WireEvent
from mbtool.ledger.account import Account
from mbtool.troubles.judge import Judge
from mbtool.workflows.shared.reading import Reading, ReadingOptions
from tests.adversary.illnesses.files import USER0, write_pcap
from tests.adversary.illnesses.wire import MS, framed
from tests.adversary.values.generator import _encoded, generated, on_the_wire
from tests.adversary.values.sure import captures, reading_of
from tests.captures import public_folder

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

PUBLIC = (
    "ITI__ICS-Security-Tools/Modbus__modbus_test.pcap",
    "nopnoplabs__nopnoplabs.github.io/hist_50fa3d41__pcap__modbus.pcap",
)
MOVES = 21
REST = 50
MOST_GAP_S = 60
"""A longer time without a request (s) counts as this: nobody polled."""
SLOT_NS = 40 * MS
STUCK, JUMPED, RESET, BACKWARDS, NO_VALUE, RANGE, NOT_VALID = CODES = (
    "VALUE-STUCK", "VALUE-JUMPED", "VALUE-RESET", "VALUE-BACKWARDS", "VALUE-NONE", "VALUE-RANGE",
    "VALUE-NOT-VALID",
)  # fmt: skip
_NO_VALUES = {
    "uint16": (0xFFFF, 0x8000), "int16": (-0x8000, 0x7FFF), "uint32": (0xFFFFFFFF, 0x80000000),
    "int32": (-0x80000000, 0x7FFFFFFF), "float32": (math.nan,), "float64": (math.nan,),
}  # fmt: skip
_LIMITS = {
    "uint16": (0, 0xFFFF), "int16": (-0x8000, 0x7FFF), "uint32": (0, 0xFFFFFFFF),
    "int32": (-0x80000000, 0x7FFFFFFF), "float32": (-1e30, 1e30), "float64": (-1e30, 1e30),
    "uint64": (0, 1 << 53), "int64": (-(1 << 53), 1 << 53), "bcd16": (0, 9999),
    "bcd32": (0, 99_999_999),
}  # fmt: skip


@dataclass(slots=True)
class Read:
    """An answered read."""

    at_ns: int
    unit: int
    function: int
    address: int
    words: list[int]


@dataclass(slots=True)
class Quantity:
    """A value of a recording, with its numbers over time."""

    unit: int
    function: int
    address: int
    type: str
    order: str
    words: int
    what: str
    reads: list[int] = field(default_factory=list)
    """The indices of the reads that have it."""
    numbers: list[float] = field(default_factory=list)

    def has(self, read: Read) -> bool:
        return (read.unit, read.function) == (self.unit, self.function) and (
            read.address <= self.address
            and self.address + self.words <= read.address + len(read.words)
        )

    def put(self, read: Read, number: float) -> None:
        begin = self.address - read.address
        read.words[begin : begin + self.words] = self.encoded(number)

    def encoded(self, number: float) -> tuple[int, ...]:
        if math.isnan(number):
            return on_the_wire(
                struct.pack(">f" if self.type == "float32" else ">d", number), self.order
            )
        return on_the_wire(_encoded(self.type, number), self.order)


@dataclass(slots=True)
class Recording:
    name: str
    reads: list[Read]
    values: list[Quantity]


def generated_recording(seed: str) -> Recording:
    device = generated(Random(seed))
    reads = [Read(at, 1, 3, address, list(words)) for at, address, words in device.reads]
    begin_ns = reads[0].at_ns
    for one in reads:
        one.at_ns -= begin_ns
    values = []
    for value in device.values:
        if value.what in ("measurement", "counter"):
            own = Quantity(1, 3, value.address, value.type, value.order, value.words, value.what)
            own.reads = [at for at, read in enumerate(reads) if own.has(read)]
            own.numbers = [float(number) for number in value.numbers]
            # The type must show, or the fault cannot be told from a type of another kind.
            if value.is_known and len(own.reads) == len(own.numbers):
                values.append(own)
    return Recording(f"generated {seed}", reads, values)


def public_recordings(path: Path) -> Iterator[Recording]:
    """The reads of registers, link by link; each register that moves is a value."""
    links: dict[str, list[Read]] = {}
    for one in Reading([str(path)], ReadingOptions()).records():
        if isinstance(one, WireEvent) or not one.response_values or one.address is None:
            continue
        if one.function in (3, 4):
            links.setdefault(one.link, []).append(
                Read(one.start_ns, one.unit, one.function, one.address, list(one.response_values))
            )
    for link, reads in links.items():
        reads.sort(key=lambda one: one.at_ns)
        begin_ns, least_ns = reads[0].at_ns, 0
        for read in reads:
            read.at_ns = least_ns = max(read.at_ns - begin_ns, least_ns)
            least_ns += SLOT_NS
        found: dict[tuple[int, int, int], Quantity] = {}
        for at, read in enumerate(reads):
            for address, word in enumerate(read.words, read.address):
                own = found.setdefault(
                    (read.unit, read.function, address),
                    Quantity(read.unit, read.function, address, "uint16", "ABCD", 1, "measurement"),
                )
                own.reads.append(at)
                own.numbers.append(word)
        yield Recording(f"{path.name} {link}", reads, [*found.values()])


@dataclass(slots=True)
class Fault:
    code: str
    value: Quantity
    reads: list[Read]
    profile: str = ""


def faults(recording: Recording, rng: Random) -> Iterator[Fault]:
    """A fault of each kind for each value in which it would show."""
    for value in recording.values:
        numbers = value.numbers
        steps = [abs(now - before) for before, now in pairwise(numbers)]
        moves = sum(step > 0 for step in steps)
        begin = len(numbers) * rng.randint(55, 70) // 100
        early = sum(step > 0 for step in steps[: begin - 1])
        if early < MOVES or moves < MOVES:
            continue
        rises = all(now >= before for before, now in pairwise(numbers))
        for code in CODES:
            reads = [Read(o.at_ns, o.unit, o.function, o.address, list(o.words))
                     for o in recording.reads]  # fmt: skip
            changed = _changed(code, value, begin, steps, rng, rises=rises)
            if changed is None:
                continue
            for at, number in changed.items():
                value.put(reads[value.reads[at]], number)
            profile = ""
            if code == RANGE:
                profile = _profile(value, numbers)
            elif code == NOT_VALID:
                profile = _flag_profile(value, reads, begin)
                if not profile:
                    continue
            yield Fault(code, value, reads, profile)


def _changed(
    code: str, value: Quantity, begin: int, steps: Sequence[float], rng: Random, *, rises: bool
) -> dict[int, float] | None:
    """The numbers that a fault puts into the reads of a value; None if it could not be seen."""
    numbers = value.numbers
    least, most = _LIMITS[value.type]
    low, high = min(numbers), max(numbers)
    width, largest = high - low, max(steps)
    behind = range(begin, len(numbers))
    mean = sum(steps) / sum(step > 0 for step in steps)
    if code == NOT_VALID:
        return {}
    if code in (RESET, BACKWARDS):
        if not rises or len(behind) < 10:
            return None
        fall = numbers[begin] if code == RESET else 25 * mean
        after = numbers[begin] - fall
        if numbers[begin] < 100 * mean or not least <= after:
            return None
        if value.type not in ("float32", "float64"):
            fall = round(fall)
        return {at: max(numbers[at] - fall, least) for at in behind}
    if len(set(numbers)) < 10:
        return None
    if code == STUCK:
        rests, rest = [0], 0
        for step in steps:
            rest = 0 if step else rest + 1
            rests.append(rest)
        is_seen = len(behind) >= max(
            REST, 6 * max(rests), 30 * len(numbers) / sum(map(bool, steps))
        )
        if rises or not is_seen or numbers[begin] % 100 == 0:
            return None
        return dict.fromkeys(behind, numbers[begin])
    if code == JUMPED:
        size = rng.choice((-1, 1)) * rng.uniform(30, 60) * largest
        for jump in (size, -size):
            number = numbers[begin] + jump
            if value.type not in ("float32", "float64"):
                number = round(number)
            if least <= number <= most:
                is_other = len(value.reads) < 2 or number not in _NO_VALUES.get(value.type, ())
                return {begin: number} if is_other else None
        return None
    if code == NO_VALUE:
        for number in _NO_VALUES.get(value.type, ()):
            away = max(low - number, number - high)
            if not away <= 3 * width:
                length = min(rng.choice((1, 2, 8)), len(behind))
                return dict.fromkeys(range(begin, begin + length), number)
        return None
    number = high + 2 * width
    if number > most:
        return None
    if value.type not in ("float32", "float64"):
        number = round(number)
    return dict.fromkeys(range(begin, min(begin + 3, len(numbers))), number)


_TABLES = {3: "holding_registers", 4: "input_registers"}


HEAD = (
    """name = "device"
title = "device"
vendor = "maker"
transports = ["rtu"]
source = "the test"
finding_prefix = "DEVICE"

"""
    + "".join(
        f'[[areas]]\nname = "{table}"\ntable = "{table}"\nfirst = 0\nlast = 65535\naccess = "r"\n\n'
        for table in _TABLES.values()
    )
    + "[functions.03]\nlimit = 125\n\n[functions.04]\nlimit = 125\n\n"
)


def _profile(value: Quantity, numbers: Sequence[float]) -> str:
    low, high = min(numbers), max(numbers)
    width = high - low
    words = "low-first" if value.order in ("CDAB", "DCBA") and value.words > 1 else "high-first"
    octets = "low-first" if value.order in ("BADC", "DCBA") and value.words > 1 else "high-first"
    return HEAD + (
        f'[[points]]\nname = "Value"\ntable = "{_TABLES[value.function]}"\n'
        f'address = {value.address}\ntype = "{value.type}"\nword_order = "{words}"\n'
        f'byte_order = "{octets}"\nminimum = {low - width!r}\nmaximum = {high + width!r}\n'
    )


def _flag_profile(value: Quantity, reads: list[Read], begin: int) -> str:
    """Make a register beside a value a word of flags, one of which is set from a read on."""
    first = reads[value.reads[0]]
    beside = [
        at
        for at in range(len(first.words))
        if not value.address <= first.address + at < value.address + value.words
        and len({reads[one].words[at] for one in value.reads if at < len(reads[one].words)}) == 1
        and not first.words[at] & 4
    ]
    if not beside:
        return ""
    address = first.address + beside[0]
    for one in value.reads[begin:]:
        read = reads[one]
        if read.address <= address < read.address + len(read.words):
            read.words[address - read.address] |= 4
    return HEAD + (
        f'[[points]]\nname = "Status"\ntable = "{_TABLES[value.function]}"\naddress = {address}\n'
        'type = "flags"\nbits = { 2 = "value not valid" }\n'
    )


def told(reads: Sequence[Read], folder: Path, unit: int, profile: str) -> list[dict[str, Any]]:
    """The troubles of values that `check` tells of reads."""
    path = folder / "line.pcap"
    packets: list[tuple[int, bytes]] = []
    for one in reads:
        request = struct.pack(">BHH", one.function, one.address, len(one.words))
        words = struct.pack(f">{len(one.words)}H", *one.words)
        packets.append((one.at_ns, framed(one.unit, request)))
        response = bytes([one.function, len(words)]) + words
        packets.append((one.at_ns + 10 * MS, framed(one.unit, response)))
    write_pcap(path, packets, USER0)
    arguments = ["check", str(path), "--link", "rtu@115200-8N1", "--format", "json"]
    if profile:
        file = folder / "device.toml"
        file.write_text(profile)
        arguments += ["--device", f"{unit}={file}"]
    said, wrong = StringIO(), StringIO()
    with redirect_stdout(said), redirect_stderr(wrong):
        run(arguments)
    if not said.getvalue():
        raise AssertionError(wrong.getvalue())
    return [
        each
        for each in json.loads(said.getvalue())["troubles"]
        for each in (each, *each["others"])
        if each["code"].startswith("VALUE-")
    ]


def _is_named(fault: Fault, troubles: Sequence[dict[str, Any]]) -> bool:
    names = {RANGE: "Value", NOT_VALID: "Status"}
    return any(
        one["code"] == fault.code
        and one["unit"] == fault.value.unit
        and any(
            _is_of(each["text"].partition(":")[0], fault, names.get(fault.code, ""))
            for each in one["evidence"]
        )
        for one in troubles
    )


def _is_of(name: str, fault: Fault, point: str) -> bool:
    """True if a name such as `holding 4..5 float32 CDAB ?` is that of the value of a fault."""
    if point:
        return name == point
    place = name.split()[1]
    first, _, last = place.partition("..")
    value = fault.value
    return int(first) < value.address + value.words and int(last or first) >= value.address


def tell_of_shared() -> None:
    """Print the troubles of values of all shared captures, and how long their polling is."""
    number, hours = 0, 0.0
    with TemporaryDirectory() as folder:
        for path in captures():
            judge = Judge(Account(lambda _: None))
            name, options = reading_of(path, Path(folder))
            last_ns = 0
            try:
                for one in Reading([name], options).records():
                    judge.count(one)
                    if not isinstance(one, WireEvent):
                        gap_ns = one.start_ns - last_ns if last_ns else 0
                        hours += min(max(gap_ns, 0), MOST_GAP_S * 10**9) / 3.6e12
                        last_ns = one.start_ns
            except InputError as error:
                print(str(error)[:90])
            for trouble in judge.judgement().troubles:
                for each in trouble.all:
                    if each.code.startswith("VALUE-"):
                        number += 1
                        print(f"{path.name}: {each.cause}")
    print(f"troubles of values in shared captures: {number} in {hours:.2f} h of polling")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--devices", type=int, default=20)
    parser.add_argument("--seed")
    parser.add_argument("--each", type=int, default=3, help="values of each recording and kind")
    parser.add_argument("--missed", action="store_true", help="print what was not named")
    parser.add_argument("--shared", action="store_true", help="look for false alarms only")
    chosen = parser.parse_args()
    if chosen.shared:
        tell_of_shared()
        return
    seed = (
        chosen.seed
        or subprocess.run(
            ["git", "rev-parse", "HEAD"], capture_output=True, text=True, check=True
        ).stdout.strip()
    )
    print(f"seed {seed}")
    public = [public_folder() / name for name in PUBLIC]
    recordings = [one for path in public if path.exists() for one in public_recordings(path)]
    recordings += [generated_recording(f"{seed}-{number}") for number in range(chosen.devices)]
    counts: dict[str, Counter[str]] = {code: Counter() for code in CODES}
    false: Counter[str] = Counter()
    healthy = 0.0
    with TemporaryDirectory() as temporary:
        folder = Path(temporary)
        for recording in recordings:
            rng = Random(f"{seed} {recording.name}")
            for one in told(recording.reads, folder, 1, ""):
                false[one["code"]] += 1
                print(f"{recording.name}: healthy, but {one['cause']}")
            healthy += recording.reads[-1].at_ns / 3.6e12
            is_public = not recording.name.startswith("generated")
            done: Counter[str] = Counter()
            for fault in faults(recording, rng):
                if not is_public and done[fault.code] == chosen.each:
                    continue
                done[fault.code] += 1
                troubles = told(fault.reads, folder, fault.value.unit, fault.profile)
                is_named = _is_named(fault, troubles)
                own = counts[fault.code]
                kind = "others'" if is_public else "generated"
                own[kind] += 1
                own[f"{kind} named"] += is_named
                codes = {one["code"] for one in troubles} - {fault.code}
                own["other code"] += bool(codes)
                if chosen.missed and (not is_named or codes):
                    value = fault.value
                    print(
                        f"{recording.name}: {fault.code} of {value.type} {value.order} at "
                        f"{value.address} of unit {value.unit} ({value.what}): "
                        f"{[one['cause'] for one in troubles]}"
                    )
    heads = ("others'", "others' named", "generated", "generated named", "other code")
    print(f"{'fault':18}" + "".join(f"{head:>17}" for head in heads))
    total = sum(counts.values(), Counter())
    for code, own in [*counts.items(), ("all", total)]:
        print(f"{code:18}" + "".join(f"{own[head]:17}" for head in heads))
    injected = total["others'"] + total["generated"]
    named = total["others' named"] + total["generated named"]
    print(f"named: {named} of {injected} ({100 * named / max(injected, 1):.1f} %)")
    print(f"false alarms in the same recordings without faults: {false.total()} in {healthy:.1f} h")


if __name__ == "__main__":
    main()
