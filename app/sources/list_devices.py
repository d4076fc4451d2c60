"""Lists the connected cameras as JSON. Runs in its own process, because the driver may hang or crash."""

from __future__ import annotations

import json
import sys
from dataclasses import asdict

from ...core.errors import TactuneError


def main() -> int:
    """Write ``{"devices": [...], "hint": clause, "problems": [clause, ...]}`` or ``{"problem": clause}`` to stdout.

    The three are those of `list_devices`; a device has the fields of `DeviceInfo`.
    """
    from ...core.sources.cameras.drivers import list_devices

    try:
        devices, hint, problems = list_devices()
        answer: dict[str, object] = {
            "devices": [asdict(device) for device in devices],
            "hint": hint,
            "problems": problems,
        }
    except TactuneError as error:
        answer = {"problem": str(error)}
    sys.stdout.write(json.dumps(answer) + "\n")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
