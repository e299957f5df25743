"""Scores the directions of frames in text logs: python -m tests.sources.text_directions [--help].

Conversations whose truth is known are written in all forms of text_logs.py, as the master's log and
as the slave's, in which received is the request, and in forms without any word or arrow. A row of
the table says how many of the frames were found, and how many of these have the right direction.
With files, it says the same of them, as far as the form of a frame alone shows its direction.
"""

from __future__ import annotations

import argparse
import io
import sys
from difflib import SequenceMatcher
from pathlib import Path
from random import Random
from typing import TYPE_CHECKING, NamedTuple

from mbtool.core import Chunk, Direction, SerialFormat
from mbtool.modbus import exception_pdu, mbap_adu, rtu_adu
from mbtool.sources.text_log import TextLog
from tests.sources.text_logs import FORMS, Said

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

POLLS = 200
"""The requests of a conversation."""
NO_ANSWER, EXCEPTION = 0.03, 0.03
"""The shares of requests without a response, and with an exception."""


class Score(NamedTuple):
    """How many frames there are, were found, and have the right direction."""

    frames: int = 0
    found: int = 0
    right: int = 0

    def __add__(self, other: object) -> Score:
        assert isinstance(other, Score)
        return Score(*(a + b for a, b in zip(self, other, strict=True)))

    def __str__(self) -> str:
        return (
            f"{self.frames:7,} {self.found:7,} {self.right:7,}  "
            f"{100 * self.right / max(self.found, 1):6.2f} %"
        )


def _stamped(one: Said) -> str:
    return f"{one.time:%Y-%m-%d %H:%M:%S}.{one.time.microsecond // 1000:03d}"


WITHOUT_WORDS: dict[str, Callable[[Sequence[Said]], str]] = {
    "bare bytes": lambda said: "\n".join(one.data.hex(" ") for one in said),
    "times and bytes": lambda said: "\n".join(
        f"{_stamped(one)} {one.data.hex(' ')}" for one in said
    ),
    "one word for both": lambda said: "\n".join(
        f"{_stamped(one)} bus: frame {one.data.hex(' ')} ({len(one.data)} bytes)" for one in said
    ),
    "a table": lambda said: "time,length,data\n" + "\n".join(
        f"{one.ms / 1000:.3f},{len(one.data)},{one.data.hex()}" for one in said
    ),
}  # fmt: skip


def conversation(chance: Random, transport: str) -> list[Said]:
    """Polls of several units, with writes, retries and exceptions among them."""
    units = chance.sample(range(1, 40), chance.randint(1, 4))
    reads = [
        (chance.choice((1, 2, 3, 3, 3, 4)), chance.randrange(1000), chance.randint(1, 20))
        for _ in range(chance.randint(2, 6))
    ]
    said: list[Said] = []
    ms = 0
    for number in range(POLLS):
        unit = chance.choice(units)
        request, response = _exchange(chance, *chance.choice(reads))
        if chance.random() < EXCEPTION:
            response = exception_pdu(request[0], chance.randint(1, 4))
        for _ in range(3):
            is_answered = chance.random() >= NO_ANSWER
            said.append(Said(True, _adu(transport, number, unit, request), ms))
            if is_answered:
                ms += chance.randint(3, 60)
                said.append(Said(False, _adu(transport, number, unit, response), ms))
            ms += chance.randint(20, 400) if is_answered else 1000
            if is_answered:
                break
    return said


def _exchange(chance: Random, code: int, address: int, quantity: int) -> tuple[bytes, bytes]:
    at = address.to_bytes(2)
    match chance.randrange(20):
        case 0:
            pdu = bytes([5]) + at + chance.choice((b"\xff\0", b"\0\0"))
            return pdu, pdu
        case 1:
            pdu = bytes([6]) + at + chance.randbytes(2)
            return pdu, pdu
        case 2:
            head = bytes([16]) + at + quantity.to_bytes(2)
            return head + bytes([2 * quantity]) + chance.randbytes(2 * quantity), head
        case 3:
            pdu = bytes.fromhex("080000") + chance.randbytes(2)
            return pdu, pdu
        case _:
            size = (quantity + 7) // 8 if code in (1, 2) else 2 * quantity
            values = bytes([size]) + chance.randbytes(size)
            return bytes([code]) + at + quantity.to_bytes(2), bytes([code]) + values


def _adu(transport: str, number: int, unit: int, pdu: bytes) -> bytes:
    return rtu_adu(unit, pdu) if transport == "rtu" else mbap_adu(number, unit, pdu)


def read(text: bytes) -> list[tuple[bytes, Direction | None]]:
    log = TextLog(io.BytesIO(text), "log", "log", SerialFormat())
    return [(one.data, one.direction) for one in log.pieces() if isinstance(one, Chunk)]


def score(said: Sequence[Said], text: str) -> Score:
    """Compare the frames of a text with those that it was written from."""
    truth = [(one.data, one.is_request) for one in said]
    found = read(text.encode())
    blocks = SequenceMatcher(
        None, [raw for raw, _ in truth], [raw for raw, _ in found], autojunk=False
    ).get_matching_blocks()
    pairs = [(one.a + at, one.b + at) for one in blocks for at in range(one.size)]
    right = sum(truth[a][1] == (found[b][1] is Direction.REQUEST) for a, b in pairs)
    return Score(len(truth), len(pairs), right)


def groups() -> Iterator[tuple[str, list[Callable[[Sequence[Said]], str]], str, bool]]:
    """Each row of the table: its name, its forms, the transport, and True if words are swapped."""
    streams = {"terminal", "hexdump", "xxd"}
    worded = [make for name, make in FORMS.items() if name not in streams]
    no_words = [*WITHOUT_WORDS.values()]
    for transport in ("rtu", "tcp"):
        yield f"{transport}, words of a master", worded, transport, False
        yield f"{transport}, words of a slave", worded, transport, True
        yield f"{transport}, no words", no_words, transport, False
    yield "rtu, no words and no lines", [FORMS[name] for name in sorted(streams)], "rtu", False


def total(seeds: int, forms: Sequence[Callable[[Sequence[Said]], str]], transport: str,
          *, swapped: bool) -> Score:  # fmt: skip
    whole = Score()
    for seed in range(seeds):
        said = conversation(Random(seed), transport)
        for make in forms:
            shown = [one._replace(is_request=not one.is_request) for one in said]
            whole += score(said, make(shown if swapped else said))
    return whole


def of_file(path: Path) -> Score:
    """Score the frames of 03 and 04 whose length only one direction has."""
    found = read(path.read_bytes())
    frames, right = 0, 0
    for raw, direction in found:
        is_answer, is_request = len(raw) == 5 + raw[2], len(raw) == 8
        if raw[1] in (3, 4) and is_answer != is_request:
            frames += 1
            right += (direction is Direction.REQUEST) == is_request
    return Score(len(found), frames, right)


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--seeds", type=int, default=5, help="conversations for each form")
    parser.add_argument("file", nargs="*", type=Path)
    given = parser.parse_args()
    rows = [(str(path), of_file(path)) for path in given.file] or [
        (name, total(given.seeds, forms, transport, swapped=swapped))
        for name, forms, transport, swapped in groups()
    ]
    lines = [f"{'':28} {'frames':>7} {'found':>7} {'right':>7}"]
    lines += [f"{name:28} {one}" for name, one in rows]
    sys.stdout.write("\n".join(lines) + "\n")


if __name__ == "__main__":
    main()
