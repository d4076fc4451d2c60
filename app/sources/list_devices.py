"""Lists the connected cameras; asked for in a process of its own, because the driver may hang or crash."""

from __future__ import annotations

import json
import sys
from dataclasses import asdict
from typing import Any, Final

from ...core.errors import SourceError, TactuneError
from ..doctor import checks

#: What a Python interpreter runs to list the cameras.
PROGRAM: Final = ("-P", "-m", "tactune.app.sources.list_devices")
#: Longest wait for it, seconds. Loading the driver takes a second or two.
PATIENCE_S = 15.0


def ask_driver() -> dict[str, Any]:
    """Return ``{"devices": [...], "hint": clause, "problems": [clause, ...]}``; `SourceError` if there is no answer."""
    child = checks.run_child([sys.executable, *PROGRAM], PATIENCE_S)
    answer = child.answer()
    if "problem" in answer:
        raise SourceError(str(answer["problem"]))
    if child.problem or "devices" not in answer:
        raise SourceError(
            f"the camera driver does not list its cameras ({child.problem or 'no answer'}); unplug the cameras and "
            "plug them in again, or run tactune doctor, which finds other causes"
        )
    return answer


def main() -> int:
    """Write the answer, or ``{"problem": clause}``, to standard output."""
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
