"""Settings of live connections and the sinks that follow from them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from .parameters import PresetParameters
    from .publisher import Sink

#: The address that only programs on this computer reach.
LOOPBACK: Final = "127.0.0.1"
FOXGLOVE_PORT: Final = 8765


@dataclass(frozen=True)
class Connections:
    """Settings of live connections. By default nothing listens; ``port`` 0 is any free one.

    ``settable`` lets Foxglove clients set preset parameters. It is off by default: a web page that is open on this
    computer can connect to the loopback address, and foxglove-sdk does not let us check where a client comes from.
    """

    foxglove: bool = False
    ros2: bool = False
    host: str = LOOPBACK
    port: int = FOXGLOVE_PORT
    domain: int = 0
    namespace: str = "tactune"
    settable: bool = False

    @property
    def warning(self) -> str:
        """Who else can connect and do what, as a sentence without a full stop; empty if others can only read here."""
        if self.host not in ("", LOOPBACK, "localhost"):
            what = "connect, read everything and set parameters" if self.settable else "connect and read everything"
            return f"other computers can {what}, without a password"
        return "every program and web page on this computer can set parameters" if self.settable else ""

    def make_sinks(self, parameters: PresetParameters) -> list[Sink]:
        """Return a sink for each connection, not started yet; `PublishError` if a value is not valid."""
        sinks: list[Sink] = []
        if self.foxglove:
            from .foxglove import FoxgloveSink

            sinks.append(FoxgloveSink(parameters, self.host, self.port))
        if self.ros2:
            from .dds import DdsSink

            sinks.append(DdsSink(self.domain, self.namespace, self.host))
        return sinks
