"""Settings of live connections and the sinks that follow from them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from .publisher import Sink

#: The address that only programs on this computer reach.
LOOPBACK: Final = "127.0.0.1"
FOXGLOVE_PORT: Final = 8765
#: Most clients of Foxglove at a time, unless told otherwise.
MAX_CLIENTS: Final = 16


@dataclass(frozen=True)
class Connections:
    """Settings of live connections. By default nothing listens; ``port`` 0 is any free one."""

    foxglove: bool = False
    ros2: bool = False
    host: str = LOOPBACK
    port: int = FOXGLOVE_PORT
    domain: int = 0
    namespace: str = "tactune"
    max_clients: int = MAX_CLIENTS
    origins: tuple[str, ...] = ()

    @property
    def warning(self) -> str:
        """Who else can connect, as a sentence without a full stop; empty if only this computer can."""
        if self.host in ("", LOOPBACK, "localhost", "::1"):
            return ""
        return "other computers can connect and read everything, without a password"

    def make_sinks(self) -> list[Sink]:
        """Return a sink for each connection, not started yet; `PublishError` if a value is not valid."""
        sinks: list[Sink] = []
        if self.foxglove:
            from .foxglove import FoxgloveSink

            sinks.append(FoxgloveSink(self.host or LOOPBACK, self.port, self.max_clients, self.origins))
        if self.ros2:
            from .ros2 import Ros2Sink

            sinks.append(Ros2Sink(self.domain, self.namespace, self.host))
        return sinks
