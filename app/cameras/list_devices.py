"""Lists the connected cameras as JSON; run in a process of its own, which a driver may hang or crash."""

from __future__ import annotations

import json
import sys
from dataclasses import asdict

from ...core.errors import TactuneError


def main() -> int:
    """Write ``{"devices": [...], "hint": sentence}`` or ``{"problem": sentence}`` to standard output.

    A device has the fields of `DeviceInfo`. The hint says why this driver finds no L515.
    """
    from ...core.sources.realsense.devices import list_devices
    from ...core.sources.realsense.driver import driver_version, no_l515_sentence

    try:
        devices = [asdict(device) for device in list_devices()]
        answer: dict[str, object] = {"devices": devices, "hint": no_l515_sentence(driver_version())}
    except TactuneError as error:
        answer = {"problem": str(error)}
    sys.stdout.write(json.dumps(answer) + "\n")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
