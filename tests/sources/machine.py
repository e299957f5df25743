"""A machine made of files: what a kernel would show below /sys, /proc and /dev."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path


class Machine:
    """A folder that is some machine's root."""

    def __init__(self, root: Path) -> None:
        self.root = root

    def write(self, files: Mapping[str, object], *, below: str = "") -> None:
        for name, text in files.items():
            path = self.root / below / name
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(f"{text}\n")

    def link(self, path: str, target: str) -> None:
        """Let a path lead to another below the root."""
        link = self.root / path
        link.parent.mkdir(parents=True, exist_ok=True)
        (self.root / target).mkdir(parents=True, exist_ok=True)
        link.symlink_to(self.root / target)

    def usb_adapter(
        self, name: str, *, driver: str, usb: Mapping[str, object], **attributes: object
    ) -> None:
        """An adapter with one port, as usb-serial and cdc_acm show it."""
        device = f"sys/devices/usb1/1-{name}"
        interface = f"{device}/1-{name}:1.0"
        self.write(usb, below=device)
        if driver == "cdc_acm":
            hardware, bus = interface, "usb"
        else:
            hardware, bus = f"{interface}/{name}", "usb-serial"
        self.link(f"{hardware}/subsystem", f"sys/bus/{bus}")
        self.link(f"{hardware}/driver", f"sys/bus/{bus}/drivers/{driver}")
        self.write(attributes, below=hardware)
        self.link(f"sys/class/tty/{name}/device", hardware)
        self.write({name: ""}, below="dev")

    def uart(self, name: str, **attributes: object) -> None:
        """A port of a PC, as Linux 6.5 and later show it: two devices before the hardware."""
        hardware = f"sys/devices/pnp0/00:{name}"
        port = f"{hardware}/00:{name}:0/00:{name}:0.0"
        self.link(f"{hardware}/subsystem", "sys/bus/pnp")
        self.link(f"{hardware}/driver", "sys/bus/pnp/drivers/serial")
        self.link(f"{port}/subsystem", "sys/bus/serial-base")
        self.link(f"{port}/driver", "sys/bus/serial-base/drivers/port")
        self.link(f"sys/class/tty/{name}/device", port)
        self.write(attributes, below=f"sys/class/tty/{name}")
        self.write({name: ""}, below="dev")

    def stable_name(self, kind: str, link: str, port: str) -> None:
        path = self.root / "dev/serial" / kind / link
        path.parent.mkdir(parents=True, exist_ok=True)
        path.symlink_to(f"../../{port}")

    def process(self, pid: int, command: str, *files: str) -> Path:
        """A process with files open; what is given is its folder."""
        folder = self.root / "proc" / str(pid)
        (folder / "fd").mkdir(parents=True)
        for number, file in enumerate(files):
            (folder / "fd" / str(number)).symlink_to(file)
        (folder / "comm").write_text(f"{command}\n")
        (folder / "cmdline").write_text(f"/usr/bin/{command}\0")
        return folder
