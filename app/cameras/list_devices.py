"""Lists the connected cameras as JSON. Runs in its own process, because the driver may hang or crash."""

from __future__ import annotations

import json
import sys
from dataclasses import asdict

from ...core.errors import TactuneError


def main() -> int:
    """Write ``{"devices": [...], "hint": sentence}`` or ``{"problem": sentence}`` to standard output.

    A device has the fields of `DeviceInfo`. The hint says why a driver may not list a camera.
    """
    from ...core.sources.cameras.drivers import list_devices

    try:
        devices, hint = list_devices()
        answer: dict[str, object] = {"devices": [asdict(device) for device in devices], "hint": hint}
    except TactuneError as error:
        answer = {"problem": str(error)}
    sys.stdout.write(json.dumps(answer) + "\n")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
