"""Several slaves of a recording, each on a link of its own."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from mbtool.core import InputError, LinkError, TcpLink, UsageError, parse_link
from mbtool.master.links import open_master
from mbtool.replay import AnsweredFrom, MatchStrategy, TimeRange
from mbtool.workflows.replay_site import PlayedSite, SiteRun
from mbtool.workflows.replay_slave import SlaveOptions
from tests.sources.live_helpers import MASTER_TIMEOUT_NS
from tests.workflows.evidence import polling_log
from tests.workflows.site import HOSTS, READ_INPUTS, READ_THREE, exchanges, site_capture

if TYPE_CHECKING:
    from pathlib import Path


@pytest.fixture
def site(tmp_path: Path) -> str:
    path = tmp_path / "site.pcap"
    path.write_bytes(site_capture())
    return str(path)


def _places(site: str, *on: str, said: list[str] | None = None) -> dict[str, str]:
    run = SiteRun(site, on, SlaveOptions(), (said if said is not None else []).append)
    return {player.name: str(player.link) for player in run.players}


def _link(played: PlayedSite, name: str) -> TcpLink:
    """Where a slave answers, once it does."""
    (slave,) = (slave for player, slave in played.played if player.name == name)
    link = parse_link(slave.shell.place)
    assert isinstance(link, TcpLink)
    return link


def test_each_slave_gets_the_address_with_its_own_last_number(site: str) -> None:
    assert _places(site, "all=tcp:127.0.0.0/24:1502") == {
        host: f"tcp:127.0.0.{host[-3:]}:1502" for host in HOSTS
    }


def test_what_does_not_fit_gets_the_lowest_free_address(site: str) -> None:
    assert list(_places(site, "all=rtu+tcp:127.0.1.96/29").values()) == [
        "rtu+tcp:127.0.1.101:502",
        "rtu+tcp:127.0.1.102:502",
        "rtu+tcp:127.0.1.97:502",  # .103 is the network's last address
        "rtu+tcp:127.0.1.98:502",  # .104 would end like the network itself
        "rtu+tcp:127.0.1.99:502",
        "rtu+tcp:127.0.1.100:502",
    ]
    with pytest.raises(UsageError, match="has too few addresses for the slaves"):
        _places(site, "all=tcp:127.0.0.0/30")


def test_a_slave_that_is_named_answers_where_it_is_told(site: str) -> None:
    said: list[str] = []
    on = ("192.168.1.101=tcp:127.0.0.11:1502", "192.168.1.103/1=tcp:[::1]:1502")
    assert _places(site, *on, said=said) == {
        "192.168.1.101": "tcp:127.0.0.11:1502",
        "192.168.1.103/1": "tcp:[::1]:1502",
    }
    assert said == [
        "mbtool: not played: 192.168.1.102, 192.168.1.104, 192.168.1.105, 192.168.1.106; "
        "--on all=LINK is for the rest"
    ]
    places = _places(site, "all=tcp:127.0.0.0/24:0", on[0])
    assert places["192.168.1.101"] == "tcp:127.0.0.11:1502"
    assert places["192.168.1.102"] == "tcp:127.0.0.102:0"


@pytest.mark.parametrize(
    ("on", "message"),
    [
        (["192.168.1.109=tcp:127.0.0.1"], "has no such slave, but 192.168.1.101, 192.168.1.102"),
        (["7=tcp:127.0.0.1"], "--on 7=tcp:127.0.0.1: .* has no such slave"),
        (
            ["all=tcp:127.0.0.2", "1=tcp:127.0.0.1"],
            "--on all=tcp:127.0.0.2: each slave that it fits has a closer --on",
        ),
        (["all=tcp:127.0.0.1"], "unit 1 is on several links"),
        (["tcp:127.0.0.1"], "--on WHO=LINK, or --on all=tcp:127.0.0.0/24:1502"),
        (["tcp:127.0.0.1", "all=tcp:127.0.0.2"], "each says which slaves answer there"),
        (["nobody=tcp:127.0.0.1"], "device 'nobody': WHO is 5, 192.168.3.250"),
        (["=tcp:127.0.0.1"], "device '': WHO is"),
        (["all=net:eth0"], "a slave needs rtu:PORT"),
        (["all=tcp:127.0.0.0/33"], "does not appear to be"),
        (["all=tcp:127.0.0.0/24:70000"], "70000 is no port"),
    ],
)
def test_a_wrong_link_is_one_line(site: str, on: list[str], message: str) -> None:
    with pytest.raises(UsageError, match=message):
        _places(site, *on)


def test_a_name_without_a_slave_is_the_only_complaint(site: str) -> None:
    said: list[str] = []
    with pytest.raises(UsageError, match="has no such slave"):
        _places(site, "99=tcp:127.0.0.1", said=said)
    assert said == []


def test_a_slave_without_a_request_in_the_part_is_left_out(site: str) -> None:
    said: list[str] = []
    options = SlaveOptions(window=TimeRange(0, 1_500_000_000))
    run = SiteRun(site, ["all=tcp:127.0.0.0/24:0"], options, said.append)
    assert [player.name for player in run.players] == list(HOSTS[:2])
    assert len(said) == 4
    assert said[0].startswith("mbtool: 192.168.1.103: not played: ")
    nothing = SlaveOptions(window=TimeRange(100_000_000_000))
    with pytest.raises(InputError, match="no request to play an answer for"):
        SiteRun(site, ["all=tcp:127.0.0.0/24:0"], nothing)


def test_a_serial_line_is_called_by_its_name(tmp_path: Path) -> None:
    path = polling_log(tmp_path / "tap.mcap", {0: 5.0}, polls=2)
    names = _places(str(path), "all=tcp:127.0.0.0/24:0")
    (name,) = names
    assert _places(str(path), f"{name}=tcp:127.0.0.1:0") == {name: "tcp:127.0.0.1:0"}


def test_every_slave_answers_as_it_did_and_its_answers_are_counted(site: str) -> None:
    played = SiteRun(site, ["all=tcp:127.0.0.0/24:0"], SlaveOptions(rate=None)).play()
    with played.shells:
        for device, host in enumerate(HOSTS):
            with open_master(_link(played, host), MASTER_TIMEOUT_NS) as master:
                for request, response in exchanges(device):
                    assert master.ask(1, request) == response
    counts = {player.name: dict(slave.counts()) for player, slave in played.played}
    assert counts == {host: {AnsweredFrom.RECORDED: len(exchanges(0))} for host in HOSTS}


def test_answers_from_elsewhere_are_counted_as_such(site: str) -> None:
    on = ["192.168.1.102=tcp:127.0.0.1:0"]
    played = SiteRun(site, on, SlaveOptions(rate=None)).play()
    with played.shells, open_master(_link(played, "192.168.1.102"), MASTER_TIMEOUT_NS) as master:
        assert master.ask(1, bytes.fromhex("03 0000 0001")) == bytes.fromhex("03 02 0001")
        assert master.ask(1, bytes.fromhex("03 7000 0001")) == bytes.fromhex("83 02")
        assert master.ask(1, READ_INPUTS) == bytes.fromhex("04 04 000A 0000")
    ((_, slave),) = played.played
    assert slave.counts() == {
        AnsweredFrom.IMAGE: 1, AnsweredFrom.NOWHERE: 1, AnsweredFrom.RECORDED: 1
    }  # fmt: skip


def test_the_clocks_of_all_start_with_the_first_request_to_any(site: str) -> None:
    options = SlaveOptions(match=MatchStrategy.TIME)
    played = SiteRun(site, ["all=tcp:127.0.0.0/24:0"], options).play()
    assert all(slave.progress().is_waiting for _, slave in played.played)
    with played.shells, open_master(_link(played, HOSTS[3]), MASTER_TIMEOUT_NS) as master:
        assert master.ask(1, READ_THREE) is not None
    assert not any(slave.progress().is_waiting for _, slave in played.played)


def test_if_one_link_cannot_be_opened_none_stays_open(site: str) -> None:
    first = SiteRun(site, ["192.168.1.101=tcp:127.0.0.1:0"], SlaveOptions()).play()
    with first.shells:
        taken = _link(first, "192.168.1.101")
        on = ["192.168.1.101=tcp:127.0.0.2:0", f"192.168.1.102={taken}"]
        second = SiteRun(site, on, SlaveOptions()).play()
        with pytest.raises(LinkError, match="in use"), second.shells:
            pass
        with pytest.raises(LinkError, match="cannot be reached"):
            open_master(_link(second, "192.168.1.101"), MASTER_TIMEOUT_NS)
