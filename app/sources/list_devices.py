"""Lists the connected cameras as JSON. Runs in its own process, because the driver may hang or crash."""

from __future__ import annotations

import json
import sys
from dataclasses import asdict
from typing import Final

from ...core.errors import TactuneError
from ...core.sources.cameras.camera import StreamLens

#: What a Python interpreter runs to list the cameras.
PROGRAM: Final = ("-P", "-m", "tactune.app.sources.list_devices")


def main() -> int:
    """Write ``{"devices": [...], "hint": clause, "problems": [clause, ...]}`` or ``{"problem": clause}`` to stdout.

    The three are those of `list_devices`; a device has the fields of `DeviceInfo`. With the argument ``--lenses`` it
    has also ``lenses``, each with ``kind``, ``depth_unit_m`` and the fields of `Intrinsics`.
    """
    from ...core.sources.cameras.drivers import list_devices, list_lenses

    try:
        devices, hint, problems = list_devices()
        described = [asdict(device) for device in devices]
        if "--lenses" in sys.argv:
            lenses = list_lenses()
            described = [each | {"lenses": _as_json(lenses.get(each["serial"], []))} for each in described]
        answer: dict[str, object] = {
            "devices": described,
            "hint": hint,
            "problems": problems,
        }
    except TactuneError as error:
        answer = {"problem": str(error)}
    sys.stdout.write(json.dumps(answer) + "\n")
    return 0


def _as_json(lenses: list[StreamLens]) -> list[dict[str, object]]:
    return [
        {"kind": lens.kind, "depth_unit_m": lens.depth_unit_m, **lens.intrinsics.model_dump(mode="json")}
        for lens in lenses
    ]


if __name__ == "__main__":
    raise SystemExit(main())
