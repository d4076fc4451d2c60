"""What is taken where nobody says."""

from __future__ import annotations

from contextlib import suppress

from ...core.errors import TactuneError
from ...core.model.files import user_path

SOURCE = "sim"


def default_preset(source: str) -> str:
    """Return the preset that suits a source, as `load_preset` takes it.

    A recording's own where it holds one; the simulator, played live or not, has its own; else ``default``.
    """
    plain = source.removeprefix("live:")
    path = user_path(plain.removeprefix("mcap:"))
    if path.suffix == ".mcap" and path.is_file():
        from ...core.preset.file import load_preset

        with suppress(TactuneError):  # opening the source tells what is wrong with it
            load_preset(path)
            return str(path)
    return "simulator" if plain.partition(":")[0] == "sim" else "default"
