"""Links that a Python program listens on."""

from __future__ import annotations

import asyncio
import socket
from typing import TYPE_CHECKING

import pytest

import mbtool
from tests.api.masters import PATIENCE_S, READ_TWO, ask, send

if TYPE_CHECKING:
    from pathlib import Path

TOUCH = "idec-ft1a-touch"


def master_through(capture: mbtool.LiveCapture) -> socket.socket:
    port = int(capture.places[0].partition("=")[0].rpartition(":")[2])
    return socket.create_connection(("127.0.0.1", port), PATIENCE_S)


def test_a_tap_is_heard_and_logged(tmp_path: Path) -> None:
    log = tmp_path / "tap.mcap"
    with mbtool.Slave(TOUCH) as slave:
        tap = f"tap:127.0.0.1:0={slave.host}:{slave.port}"
        with (
            mbtool.sniff(tap, devices={1: TOUCH}, log=log) as capture,
            master_through(capture) as master,
        ):
            ask(master, 1, bytes.fromhex(READ_TWO))
            (one,) = capture.transactions(count=1, seconds=PATIENCE_S)
            assert one.reference == "HR400001..400002"
            ask(master, 1, bytes.fromhex("03 0008 0001"))
            for two in capture:
                assert two.reference == "HR400009"
                break
            ask(master, 1, bytes.fromhex("03 0009 0001"))
            capture.stop()
            assert [each.reference for each in capture] in ([], ["HR400010"])
    assert [each.reference for each in mbtool.open(log)][:2] == ["HR400001..400002", "HR400009"]


def test_no_transaction_is_lost_between_two_calls() -> None:
    with mbtool.Slave(TOUCH) as slave:
        tap = f"tap:127.0.0.1:0={slave.host}:{slave.port}"
        with mbtool.sniff(tap) as capture, master_through(capture) as master:
            for address in range(3):
                send(master, 1, bytes([3, 0, address, 0, 1]))
            ask(master, 1, bytes.fromhex("03 0003 0001"))
            heard = [
                one.address
                for _ in range(4)
                for one in capture.transactions(count=1, seconds=PATIENCE_S)
            ]
            assert heard == [0, 1, 2, 3]


def test_where_chooses_what_is_given_and_time_ends_the_listening() -> None:
    with mbtool.Slave(TOUCH) as slave:
        tap = f"tap:127.0.0.1:0={slave.host}:{slave.port}"
        with mbtool.sniff(tap, where="function == 6") as capture, master_through(capture) as master:
            ask(master, 1, bytes.fromhex(READ_TWO))
            ask(master, 1, bytes.fromhex("06 0000 0001"))
            (one,) = capture.transactions(count=1, seconds=PATIENCE_S)
            assert one.function == 6
            assert list(capture.transactions(seconds=0)) == []
            assert list(capture) == []  # The time was over, so nobody listens any more.
            assert list(capture.transactions(count=0)) == []


def test_a_wrong_argument_is_refused_before_anything_is_opened(tmp_path: Path) -> None:
    for link, options, message in (
        ("tcp", {}, "link 'tcp': write"),
        ("net:eth0", {"where": "unit ="}, "unit ="),
        ("net:eth0", {"allow": ["10.0.0.1/8"]}, "10.0.0.1/8"),
    ):
        with pytest.raises(mbtool.UsageError, match=message):
            mbtool.sniff(link, **options)
    with (
        pytest.raises(mbtool.LinkError),
        mbtool.sniff(f"rtu:{tmp_path / 'none'}@19200-8E1", log=tmp_path / "x.mcap"),
    ):
        pass
    assert not (tmp_path / "x.mcap").exists()


def test_a_capture_is_entered_before_it_is_read() -> None:
    with pytest.raises(RuntimeError, match=r"with mbtool\.sniff"):
        list(mbtool.sniff("net:lo"))


def test_a_program_with_asyncio_listens_without_waiting() -> None:
    async def listen(capture: mbtool.LiveCapture, master: socket.socket) -> list[int | None]:
        heard: list[int | None] = []
        ask(master, 1, bytes.fromhex(READ_TWO))
        async for one in capture:
            heard.append(one.address)
            if len(heard) == 3:
                break
            ask(master, 1, bytes([3, 0, len(heard), 0, 1]))
        return heard

    with mbtool.Slave(TOUCH) as slave:
        tap = f"tap:127.0.0.1:0={slave.host}:{slave.port}"
        with mbtool.sniff(tap) as capture, master_through(capture) as master:
            assert asyncio.run(listen(capture, master)) == [0, 1, 2]


def test_cancelling_the_task_that_listens_ends_the_listening() -> None:
    async def listen(capture: mbtool.LiveCapture) -> None:
        task = asyncio.ensure_future(anext(aiter(capture)))
        await asyncio.sleep(0)
        task.cancel()
        with pytest.raises(asyncio.CancelledError):
            await task

    with mbtool.Slave(TOUCH) as slave:
        tap = f"tap:127.0.0.1:0={slave.host}:{slave.port}"
        with mbtool.sniff(tap) as capture:
            asyncio.run(asyncio.wait_for(listen(capture), PATIENCE_S))
            assert list(capture) == []
