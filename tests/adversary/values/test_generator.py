"""The generated devices are what they say they are."""

from __future__ import annotations

import struct
from random import Random

from tests.adversary.values.generator import ORDERS, REGISTERS, generated, on_the_wire


def test_the_four_orders_place_the_bytes_as_their_names_say() -> None:
    assert [on_the_wire(bytes.fromhex("0A0B0C0D"), order) for order in ORDERS] == [
        (0x0A0B, 0x0C0D),
        (0x0C0D, 0x0A0B),
        (0x0B0A, 0x0D0C),
        (0x0D0C, 0x0B0A),
    ]


def test_a_device_has_enough_registers_without_overlap_and_all_of_them_are_read() -> None:
    for seed in range(10):
        device = generated(Random(seed))
        places = [
            address
            for value in device.values
            for address in range(value.address, value.address + value.words)
        ]
        assert len(places) == len(set(places)) >= REGISTERS
        read = {address + at for _, address, words in device.reads for at in range(len(words))}
        assert read == set(places)


def test_the_words_of_a_float_hold_its_number() -> None:
    floats = [
        value
        for seed in range(10)
        for value in generated(Random(seed)).values
        if value.type == "float32" and value.order == "ABCD"
    ]
    assert floats
    for value in floats:
        for number, row in zip(value.numbers, value.rows, strict=True):
            assert struct.unpack(">f", struct.pack(">HH", *row)) == (number,)


def test_the_same_seed_gives_the_same_device() -> None:
    assert generated(Random("a")) == generated(Random("a"))
