"""The analog FA3 modules: chapter 10.5, message by message."""

from __future__ import annotations

from mbtool.devices import load_profile
from mbtool.modbus import Table
from mbtool.slave.device.connection_policy import Loss
from mbtool.slave.device.image import RegisterImage
from mbtool.slave.families import make_device
from mbtool.slave.families.fa3 import Fa3

SECOND = 1_000_000_000

Y9_ON, Y9_OFF, READ_X9 = "05 0009 FF00", "05 0009 0000", "02 0009 0001"
READ_FLAGS, READ_VALUES = "02 0010 0008", "04 0002 0008"


class _Module:
    def __init__(self, name: str) -> None:
        profile = load_profile(name)
        self.device = make_device(profile, RegisterImage.of(profile))
        assert isinstance(self.device.behaviour, Fa3)
        self.behaviour = self.device.behaviour
        self.now_ns = 0

    def ask(self, request: str) -> str:
        answer = self.device.respond(0, bytes.fromhex(request), self.now_ns)
        assert answer is not None
        return answer.pdu.hex(" ")

    def write(self, address: int, *values: int) -> None:
        data = b"".join(value.to_bytes(2, "big") for value in values)
        head = address.to_bytes(2, "big") + len(values).to_bytes(2, "big") + bytes([len(data)])
        assert self.ask(f"10 {(head + data).hex()}")[:2] == "10"

    def set_inputs(self, *values: int) -> None:
        self.device.image.set(Table.INPUT_REGISTERS, 2, [value & 0xFFFF for value in values])

    def values(self) -> list[int]:
        data = bytes.fromhex(self.ask(READ_VALUES))[2:]
        return [int.from_bytes(data[i : i + 2], "big", signed=True) for i in range(0, 16, 2)]

    def start(self) -> None:
        assert self.ask(Y9_ON)[:2] == "05"
        assert self.ask(READ_X9) == "02 01 01"
        assert self.ask(Y9_OFF)[:2] == "05"
        assert self.ask(READ_X9) == "02 01 00"

    def outputs(self) -> list[int]:
        return [output.value for output in self.behaviour.outputs()]


def test_the_example_of_the_input_module_comes_out_as_printed() -> None:
    module = _Module("fa3-at1m8x")
    # 7.5 of 10 V, 8 mA of 4 to 20, what makes 2700 of 4000, and 2.5 V of 1 to 5.
    module.set_inputs(12000, 4000, 9, 9, 9, 10800, 9, 6000)
    module.ask("06 0102 005C")
    module.write(0x0105, 0x0000, 0x2010, 0, 0, 0, 0, 0, 5000, 0, 100)
    module.write(0x0133, 0x005F, *[0] * 10, 0, 4000, 0, 0, 0, 100)
    module.start()
    assert module.ask(READ_FLAGS) == "02 01 03"
    module.now_ns = SECOND // 10  # A hundred conversions of CH8.
    assert module.ask(READ_FLAGS) == "02 01 83"
    module.now_ns = 5 * SECOND
    assert module.ask(READ_FLAGS) == "02 01 a3"
    assert module.ask(READ_VALUES).replace(" ", "") == (
        "0410" "2EE0" "0FA0" "0000" "0000" "0000" "0A8C" "0000" "0025"
    ).lower()  # fmt: skip


def test_no_input_is_converted_before_the_first_initial_setting() -> None:
    module = _Module("fa3-at1m8x")
    module.set_inputs(1, 2, 3, 4, 5, 6, 7, -8)
    module.behaviour.inputs_set(0)
    assert module.values() == [0] * 8
    assert module.ask(READ_FLAGS) == "02 01 00"
    module.start()
    assert module.values() == [1, 2, 3, 4, 5, 6, 7, -8]
    assert module.ask(READ_FLAGS) == "02 01 ff"


def test_while_the_first_mean_of_a_scaled_channel_is_made_it_has_no_unscaled_value() -> None:
    module = _Module("fa3-at1m8x")
    module.set_inputs(*[10800] * 8)
    module.values()
    module.ask("06 0106 0010")  # CH6: time average
    module.ask("06 010C 1388")  # of 5000 ms
    module.write(0x013E, 0, 4000)
    module.start()
    assert module.values()[5] == 0
    module.now_ns = 5 * SECOND
    assert module.values()[5] == 2700


def test_settings_take_effect_with_y9_and_not_before() -> None:
    module = _Module("fa3-at1m8x")
    module.set_inputs(*[1000] * 8)
    module.start()
    module.ask("06 0102 00FE")
    assert module.values() == [1000] * 8
    module.start()
    assert module.values() == [1000] + [0] * 7
    module.ask("06 0102 0000")
    module.ask(Y9_OFF)
    assert module.values() == [1000] + [0] * 7
    module.ask(Y9_ON)
    assert module.values() == [1000] * 8
    module.ask("06 0102 00FF")
    module.ask(Y9_ON)  # It is on already.
    assert module.values() == [1000] * 8
    module.ask("0F 0008 0003 01 00")
    module.ask("0F 0008 0003 01 02")
    assert module.values() == [0] * 8


def test_while_the_first_mean_is_made_the_value_before_stands() -> None:
    module = _Module("fa3-at1m8x")
    module.set_inputs(*[1000] * 8)
    module.start()
    assert module.values()[0] == 1000
    module.write(0x0105, 0x0001, 0, 2000)
    module.start()
    module.set_inputs(*[3000] * 8)
    assert module.values() == [1000] + [3000] * 7
    assert module.ask(READ_FLAGS) == "02 01 fe"
    module.now_ns = 2 * SECOND
    assert module.values() == [3000] * 8
    assert module.ask(READ_FLAGS) == "02 01 ff"


def test_time_count_and_moving_average_differ_as_they_should() -> None:
    module = _Module("fa3-at1m8x")
    module.set_inputs(*[0] * 8)
    # CH1 sampling, CH2 1000 ms, CH3 1000 times, CH4 moving over 1000.
    module.write(0x0105, 0x3210, 0, 0, 1000, 1000, 1000)
    module.start()
    module.now_ns = SECOND // 2
    module.set_inputs(*[8000] * 4, 0, 0, 0, 0)
    assert module.values()[0] == 8000
    module.now_ns = SECOND
    assert module.values()[:4] == [8000, 4000, 4000, 4000]
    module.now_ns = SECOND + SECOND // 4
    assert module.values()[:4] == [8000, 4000, 4000, 6000]
    module.now_ns = 2 * SECOND
    assert module.values()[:4] == [8000, 8000, 8000, 8000]


def test_a_mean_knows_of_an_input_from_when_it_is_told() -> None:
    module = _Module("fa3-at1m8x")
    module.set_inputs(*[0] * 8)
    module.write(0x0105, 0x0001, 0, 1000)
    module.start()
    module.now_ns = SECOND // 4
    module.set_inputs(*[8000] * 8)
    module.behaviour.inputs_set(module.now_ns)
    module.now_ns = SECOND
    assert module.values()[0] == 6000


def test_a_time_or_count_of_nothing_is_sampling() -> None:
    module = _Module("fa3-at1m8x")
    module.write(0x0105, 0x0321)
    module.start()
    module.set_inputs(*[5] * 8)
    assert module.values() == [5] * 8


def test_a_reading_that_only_touches_the_channels_shows_them_too() -> None:
    module = _Module("fa3-at1m8x")
    module.set_inputs(*[7] * 8)
    module.ask("06 0102 0001")
    module.start()
    module.device.image.set(Table.INPUT_REGISTERS, 0, [0, 0x0E40])
    assert module.ask("04 0000 0004") == "04 08 00 00 0e 40 00 00 00 07"
    assert module.ask("04 0009 0002") == "04 04 00 07 00 00"
    assert module.ask("04 000A 0001") == "04 02 00 00"
    assert module.ask("02 0000 0020") == "02 04 00 00 fe 00"


def test_a_reset_forgets_settings_and_handshake() -> None:
    module = _Module("fa3-at1m8x")
    module.set_inputs(*[7] * 8)
    module.ask(Y9_ON)
    assert module.values() == [7] * 8
    assert module.device.respond(0, bytes.fromhex("41 00"), 0) is None
    assert module.ask(READ_X9) == "02 01 00"
    assert module.ask("01 0009 0001") == "01 01 00"
    assert module.values() == [0] * 8
    module.start()
    assert module.values() == [7] * 8


def _started_output() -> _Module:
    """The example of the output module, after its last message."""
    module = _Module("fa3-at1m8y")
    module.behaviour.connections.admit("10.0.0.1", 0)
    module.ask("06 0102 00B6")
    module.write(0x0105, 0x0101, 0x1010, 0x00FE, 8000, 0)
    module.start()
    module.write(0x0002, 3600, 0, 0, 9600, 0, 0, 15000, 0)
    assert module.outputs() == [0] * 8
    module.ask("0F 0010 0008 01 49")
    return module


def test_the_example_of_the_output_module_puts_out_what_is_printed() -> None:
    module = _started_output()
    assert module.outputs() == [3600, 0, 0, 9600, 0, 0, 15000, 0]
    names = [(output.name, output.text) for output in module.behaviour.outputs()]
    assert names[0] == ("CH1", "1.900 V")
    assert names[3] == ("CH4", "3.400 V")  # What the converter makes 13.6 mA of.
    assert names[7] == ("CH8", "1.000 V")


def test_an_output_needs_both_its_conversion_and_its_output_enabled() -> None:
    module = _started_output()
    module.write(0x0002, *[100] * 8)
    module.ask("0F 0010 0008 01 FF")
    assert module.outputs() == [100, 0, 0, 100, 0, 0, 100, 0]
    module.ask("05 0010 0000")
    assert module.outputs() == [0, 0, 0, 100, 0, 0, 100, 0]


def test_no_output_is_converted_before_the_first_initial_setting() -> None:
    module = _Module("fa3-at1m8y")
    module.behaviour.connections.admit("10.0.0.1", 0)
    module.write(0x0002, *range(1, 9))
    module.ask("0F 0010 0008 01 FF")
    assert module.outputs() == [0] * 8
    module.start()
    assert module.outputs() == [1, 2, 3, 4, 5, 6, 7, 8]


def test_hold_keeps_and_clear_clears_until_a_connection_comes() -> None:
    module = _Module("fa3-at1m8y")
    peer = module.behaviour.connections.admit("10.0.0.1", 0).peer
    assert peer is not None
    module.write(0x0105, 0x0101, 0x1010)  # HOLD for CH1, 3, 6 and 8.
    module.start()
    module.write(0x0002, *range(1, 9))
    module.ask("0F 0010 0008 01 FF")
    assert module.outputs() == [1, 2, 3, 4, 5, 6, 7, 8]
    module.behaviour.connections.lost(peer, Loss.CLOSED, 1)
    assert module.outputs() == [1, 0, 3, 0, 0, 6, 0, 8]
    module.behaviour.connections.admit("10.0.0.1", 2)
    assert module.outputs() == [1, 2, 3, 4, 5, 6, 7, 8]


def test_a_value_beyond_its_warning_limits_is_told() -> None:
    module = _started_output()
    assert module.behaviour.outputs()[0].text == "1.900 V"
    module.write(0x0002, 8001)
    assert module.behaviour.outputs()[0].text == "3.000 V, beyond its warning limits 0..8000"
    assert module.outputs()[0] == 8001


def test_a_reset_puts_nothing_out() -> None:
    module = _started_output()
    assert module.device.respond(0, bytes.fromhex("41 00"), 0) is None
    assert module.outputs() == [0] * 8
