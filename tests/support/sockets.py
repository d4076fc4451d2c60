"""The sockets of a process on which it listens, and free domains of DDS."""

from __future__ import annotations

import os
import random
import re
import socket
from pathlib import Path

_LISTENING, _UNCONNECTED = "0A", "07"


def listening(pid: int | None = None) -> set[tuple[str, str, int]]:
    """Return protocol, address (IPv4) and port of every TCP and UDP socket on which a process listens."""
    process = Path("/proc") / str(pid or os.getpid())
    inodes = set()
    for entry in (process / "fd").iterdir():
        try:
            match = re.fullmatch(r"socket:\[(\d+)\]", str(entry.readlink()))
        except FileNotFoundError:
            continue
        if match:
            inodes.add(match[1])
    found = set()
    for protocol, state in (("tcp", _LISTENING), ("tcp6", _LISTENING), ("udp", _UNCONNECTED), ("udp6", _UNCONNECTED)):
        for line in (process / "net" / protocol).read_text().splitlines()[1:]:
            words = line.split()
            if words[3] == state and words[9] in inodes:
                address, _, port = words[1].partition(":")
                octets = bytes.fromhex(address)[::-1] if len(address) == 8 else b""
                found.add((protocol, ".".join(map(str, octets)), int(port, 16)))
    return found


def free_domain() -> int:
    """Return a DDS domain id, as ROS_DOMAIN_ID, that nobody on this computer uses."""
    while True:
        number = random.SystemRandom().randrange(1, 200)
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
            try:
                probe.bind(("0.0.0.0", 7400 + 250 * number + 10))
            except OSError:
                continue
            return number
