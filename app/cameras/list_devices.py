"""Lists the connected cameras as JSON; run in a process of its own, which a driver may hang or crash."""

from __future__ import annotations

import json
import sys
from dataclasses import asdict

from ...core.errors import TactuneError


def main() -> int:
    """Write ``{"devices": [...]}`` or ``{"problem": sentence}`` to standard output."""
    from ...core.sources.realsense.devices import list_devices

    try:
        answer: dict[str, object] = {"devices": [asdict(device) for device in list_devices()]}
    except TactuneError as error:
        answer = {"problem": str(error)}
    sys.stdout.write(json.dumps(answer, default=str) + "\n")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
