"""The sockets of a process on which it listens, free ports and free domains of DDS."""

from __future__ import annotations

import random
import socket

import psutil

_KINDS = {socket.SOCK_STREAM: "tcp", socket.SOCK_DGRAM: "udp"}


def listening(pid: int | None = None) -> set[tuple[str, str, int]]:
    """Return protocol, address and port of every TCP and UDP socket on which a process listens."""
    opened = psutil.Process(pid).net_connections("inet")
    waiting = (psutil.CONN_LISTEN, psutil.CONN_NONE)
    return {(_KINDS[each.type], *each.laddr) for each in opened if each.status in waiting and not each.raddr}


def free_port() -> int:
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        return int(free.getsockname()[1])


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
