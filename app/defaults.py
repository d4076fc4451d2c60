"""What is taken where nobody says."""

from __future__ import annotations

SOURCE = "sim"


def default_preset(source: str) -> str:
    """Return the shipped preset that suits a source: the simulator, played live or not, has its own."""
    return "simulator" if source.removeprefix("live:").partition(":")[0] == "sim" else "default"
