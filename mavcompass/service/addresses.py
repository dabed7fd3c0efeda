"""Where other machines find the page: this computer's addresses, and a picture for a phone's camera."""

from __future__ import annotations

import fcntl
import io
import socket
import struct
from contextlib import suppress

_SIOCGIFADDR = 0x8915  # netdevice(7): the IPv4 address of an interface
_ANYWHERE = ("192.0.2.1", 9)  # of no network (RFC 5737): the way there is the one that leads out of here
_WHITE_ON_BLACK, _PLAIN = "\x1b[97;40m", "\x1b[0m"
_QUIET_ZONE = 2  # modules; fewer than the standard's four are read, and a phone's terminal has 40 columns


def addresses_of_this_computer() -> dict[str, str]:
    """List its IPv4 addresses but loopback with their interfaces' names, that of the way out first."""
    found: dict[str, str] = {}
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as asking:
        with suppress(OSError):
            asking.connect(_ANYWHERE)  # nothing is sent
            found[asking.getsockname()[0]] = ""
        for _, name in socket.if_nameindex():
            with suppress(OSError):
                told = fcntl.ioctl(asking, _SIOCGIFADDR, struct.pack("256s", name.encode()[:15]))
                found[socket.inet_ntoa(told[20:24])] = name
    return {address: name for address, name in found.items() if not address.startswith("127.")}


def page_urls(host: str, port: int) -> dict[str, str]:
    """List the addresses of the page, each with its interface's name ("": this one was asked for)."""
    everywhere = host in ("0.0.0.0", "::")
    hosts = addresses_of_this_computer() if everywhere else {host: ""}
    return {
        f"http://{f'[{one}]' if ':' in one else one}:{port}/": name
        for one, name in (hosts or {"127.0.0.1": ""}).items()
    }


def qr_code(text: str) -> list[str]:
    """Draw a QR code for a terminal, two modules a letter, white on black whatever the terminal's colours."""
    import segno

    drawn = io.StringIO()
    segno.make(text, error="l", micro=False).terminal(out=drawn, border=_QUIET_ZONE, compact=True)
    return [f"{_WHITE_ON_BLACK}{line}{_PLAIN}" for line in drawn.getvalue().splitlines()]
