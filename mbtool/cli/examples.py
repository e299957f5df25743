"""Two examples of each command and its documentation page, which end the command's help."""

from __future__ import annotations

from typing import NamedTuple


class HelpExamples(NamedTuple):
    """The documentation page and the examples at the end of a command's help."""

    page: str
    first: str
    second: str


MOST_USED = (
    ("listen to a line, and log it", "mbtool sniff rtu:/dev/ttyUSB0@auto -w site.mcap"),
    ("read a capture or a log", "mbtool decode site.mcap"),
    ("find what is wrong in it", "mbtool check site.mcap"),
    ("make a page to hand over", "mbtool report site.mcap -o site.html"),
    ("let it answer your program", "mbtool replay site.mcap --as-slave --on tcp:127.0.0.1:1502"),
)
"""`mbtool` without a command prints these five tasks, each with a command line for it."""

_PORT = "rtu:/dev/ttyUSB0"
EXAMPLES = {
    "sniff": HelpExamples(
        "links",
        f"mbtool sniff {_PORT} -w site.mcap --device 5=idec-ft1a-touch",
        "mbtool sniff tap:127.0.0.1:1502=192.168.3.250:502 -w net.mcap",
    ),
    "status": HelpExamples(
        "service", "mbtool status site.mcap", "mbtool status /var/log/mbtool/site.mcap --json"
    ),
    "decode": HelpExamples(
        "table",
        "mbtool decode plant.pcapng --where 'outcome != \"ok\"'",
        "mbtool decode site.mcap -o site.csv",
    ),
    "inventory": HelpExamples(
        "inventory",
        "mbtool inventory plant.pcap -o monday.json",
        "mbtool inventory today.pcap --baseline monday.json",
    ),
    "check": HelpExamples(
        "findings",
        "mbtool check site.mcap",
        "mbtool check plant.pcap --select SEC -o plant.sarif",
    ),
    "stats": HelpExamples("stats", "mbtool stats plant.pcap", f"mbtool stats {_PORT}"),
    "watch": HelpExamples(
        "watch", f"mbtool watch {_PORT} -w site.mcap", "mbtool watch site.mcap --play"
    ),
    "report": HelpExamples(
        "report",
        "mbtool report site.mcap -o site.html",
        "mbtool report after.mcap --against before.mcap -o change.html",
    ),
    "plot": HelpExamples(
        "plot", "mbtool plot site.mcap", "mbtool plot site.mcap 'holding 0..3' -o site.svg"
    ),
    "convert": HelpExamples(
        "convert",
        "mbtool convert site.mcap site.pcapng",
        "mbtool convert plant.pcap part.pcap --start 1h --end 1h30m",
    ),
    "recover": HelpExamples(
        "log-format",
        "mbtool recover broken.mcap -o good.mcap",
        "mbtool recover broken.mcap.zst -o good.mcap --overwrite",
    ),
    "replay": HelpExamples(
        "replay",
        "mbtool replay site.mcap --as-slave --on tcp:127.0.0.1:1502",
        f"mbtool replay site.mcap --as-master --to {_PORT} --report result.xml",
    ),
    "diff": HelpExamples(
        "diff",
        "mbtool diff good-day.mcap bad-day.mcap",
        "mbtool diff a.pcap b.pcap --ignore 'holding 9..19' --no-latency",
    ),
    "slave": HelpExamples(
        "slave",
        "mbtool slave fa3-at1m8x --on tcp:127.0.0.1:1502",
        f"mbtool slave idec-ft1a-touch --on {_PORT} --fault noisy.toml",
    ),
    "read": HelpExamples(
        "master",
        "mbtool read tcp:192.168.3.250:502 'holding 0..9'",
        f"mbtool read {_PORT} HR400001..400010 --device 5=idec-ft1a-touch",
    ),
    "write": HelpExamples(
        "master",
        "mbtool write tcp:127.0.0.1:1502 'holding 0=77'",
        f"mbtool write {_PORT} HR400001=4660,22136 --device 5=idec-ft1a-touch",
    ),
    "test": HelpExamples(
        "master",
        f"mbtool test my-device.toml {_PORT}@19200-8E1 --unit 5",
        "mbtool test fa3-at1m8x tcp:192.168.3.250:502 --report result.xml",
    ),
    "scan": HelpExamples(
        "master",
        f"mbtool scan {_PORT}@19200-8E1",
        "mbtool scan tcp:192.168.3.250:502 --units 1 -o plc.toml",
    ),
    "poll": HelpExamples(
        "master",
        "mbtool poll tcp:127.0.0.1:1502 'input 0..3' --every 250ms",
        f"mbtool poll {_PORT} --unit 3 'holding 0..7' --count 100",
    ),
    "find": HelpExamples(
        "find",
        "mbtool find site.mcap 23.4@10:15:03 23.9@10:16:00",
        "mbtool find site.mcap Voltage=236.8V Current=1.158A --keep meter.toml",
    ),
    "links": HelpExamples("links", "mbtool links", "mbtool links --format jsonl"),
    "doctor": HelpExamples("install", "mbtool doctor", "mbtool doctor --json"),
    "line": HelpExamples(
        "start/integrator",
        "mbtool line ./plc ./panel ./usb",
        "mbtool line ./plc ./panel --settings 9600-7E1",
    ),
    "demo": HelpExamples("start/scada", "mbtool demo", "mbtool demo -w first.mcap"),
    "extcap": HelpExamples("wireshark", "mbtool extcap --install", "mbtool extcap --uninstall"),
    "devices": HelpExamples(
        "devices", "mbtool devices fa3-at1m8x", "mbtool devices --match site.mcap"
    ),
    "devices new": HelpExamples(
        "adding-a-device", "mbtool devices new pump.toml", "mbtool devices new profiles/oven.toml"
    ),
    "devices import": HelpExamples(
        "adding-a-device",
        "mbtool devices import list.csv -o pump.toml",
        "mbtool devices import --sunspec model_1.json model_103.json -o inverter.toml",
    ),
    "devices draft": HelpExamples(
        "adding-a-device",
        "mbtool devices draft site.mcap --unit 5 -o pump.toml",
        "mbtool devices draft plant.pcap --unit 192.168.3.250/5",
    ),
    "devices export": HelpExamples(
        "devices",
        "mbtool devices export pump.toml --csv",
        "mbtool devices export fa3-at1m8x --telegraf -o fa3.conf",
    ),
    "devices schema": HelpExamples(
        "devices", "mbtool devices schema", "mbtool devices schema > mbtool-profile.json"
    ),
}
"""By command: the name of its page in docs/ without `.md`, and two command lines."""


def examples_of(command_path: str) -> HelpExamples | None:
    """Return the examples of a command; None if it has none.

    `command_path` is the command's name, such as `devices new`; it may begin with `mbtool`.
    """
    return EXAMPLES.get(command_path.partition("mbtool")[2].strip() or command_path)


def first_steps() -> list[str]:
    """Return the lines that `mbtool` prints without a command."""
    lines = ["Capture, decode and replay Modbus. The commands used most:", ""]
    for wish, line in MOST_USED:
        lines += [f"  {wish}", f"    {line}"]
    lines += [
        "",
        "No device at hand? mbtool demo -w site.mcap makes a recording to try them with.",
        "mbtool --help lists all commands, mbtool COMMAND --help tells of one, and",
        "mbtool doctor says what this machine lacks.",
    ]
    return lines
