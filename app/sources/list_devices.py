"""Lists the connected cameras as JSON. Runs in its own process, because the driver may hang or crash."""

from __future__ import annotations

import json
import sys
from dataclasses import asdict
from typing import Final

from ...core.errors import TactuneError

#: What a Python interpreter runs to list the cameras.
PROGRAM: Final = ("-P", "-m", "tactune.app.sources.list_devices")


def main() -> int:
    """Write ``{"devices": [...], "hint": clause, "problems": [clause, ...]}`` or ``{"problem": clause}`` to stdout."""
    from ...core.sources.cameras.drivers import list_devices

    try:
        devices, hint, problems = list_devices()
        answer = {"devices": [asdict(device) for device in devices], "hint": hint, "problems": problems}
    except TactuneError as error:
        answer = {"problem": str(error)}
    sys.stdout.write(json.dumps(answer) + "\n")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
