"""Print a hash of every result that a refactoring must not change, bit for bit.

Results of both contact tests on simulated presses, on still scenes, on a recording and, if available, on the real pair:
points, provenance and the numbers of ``tactune run --json``. Times are excluded. Compare the output of two versions
with ``diff``; equal lines mean equal bits.

    .venv/bin/python scripts/hash_results.py > before.txt
"""

from __future__ import annotations

import hashlib
import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from tactune.core import ContactPipeline, Preset, SensorFrame, load_preset, open_source
from tactune.core.lab.methods import make_method, method_names
from tactune.core.rig.untouched import untouched_frame

OBJECTS = ("cube", "cup", "octopus")
#: Hashed frames of a press: approach, touch, deep, release.
PRESS_FRAMES = (0, 20, 35, 50, 65, 80)
DATA = Path(os.environ.get("TACTUNE_TEST_DATA", Path(__file__).resolve().parents[2] / "shared" / "data"))
TACTUNE = (sys.executable, "-P", "-m", "tactune.app")
#: Correction of the bias between the cameras of the real pair, metres.
REAL_OFFSET_M = 0.0169


def digest(*parts: Any) -> str:
    """Return the first sixteen digits of the SHA-256 of arrays and JSON values."""
    content = hashlib.sha256()
    for part in parts:
        if isinstance(part, np.ndarray):
            content.update(str((part.dtype, part.shape)).encode() + np.ascontiguousarray(part).tobytes())
        else:
            content.update(json.dumps(part).encode())
    return content.hexdigest()[:16]


def chosen_frames(source: str, wanted: tuple[int, ...]) -> Iterator[SensorFrame]:
    """Yield the frames of a source with these indices."""
    with open_source(source) as opened:
        for place, frame in enumerate(opened):
            if place in wanted:
                yield frame
            if place >= max(wanted):
                return


def print_patches(title: str, source: str, preset: Preset, wanted: tuple[int, ...]) -> None:
    """Print one line per frame: points, provenance, area and relative difference of both contact tests."""
    with open_source(source) as opened:
        rig = opened.rig
    tests: dict[str, dict[str, Any]] = {
        "tolerance": {"contact_test": "tolerance"},
        "membrane": {"contact_test": "membrane", "membrane.frames": 1},
        "averaged": {"contact_test": "membrane", "membrane.frames": 5},
    }
    for name, values in tests.items():
        pipeline = ContactPipeline(preset.with_values(values), rig)
        for frame in chosen_frames(source, wanted):
            patch = pipeline.process(frame)
            parts = patch.points, patch.provenance, patch.mask, patch.area_mm2, patch.relative_difference
            print(title, name, frame.sequence, len(patch.points), digest(*parts), flush=True)


def print_run(title: str, source: str, options: list[str]) -> None:
    """Print the hash of the output of ``tactune run --json``, without times."""
    command = [*TACTUNE, "run", "--source", source, "--json", *options]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    lines = [json.loads(line) for line in done.stdout.splitlines()]
    for line in lines:
        for key in [key for key in line if key.endswith("_ms") or key in ("ms", "timestamp")]:
            del line[key]
    # Earlier versions had two more keys, which named other methods: so the hashes of both can be compared.
    lines = [_with_method(line) for line in lines]
    print(title, "exit", done.returncode, "lines", len(lines), digest(lines), flush=True)


def _with_method(line: dict[str, Any]) -> dict[str, Any]:
    items = list(line.items())
    place = list(line).index("averaged_frames") + 1
    return dict([*items[:place], ("method", "fusion"), ("failure", ""), *items[place:]])


def print_methods(source: str, preset: Preset) -> None:
    """Print one line per method of the lab: points and mask in the first frame of a press."""
    with open_source(source) as opened:
        untouched, frame = untouched_frame(opened), next(iter(opened))
        for name in method_names():
            patch = make_method(name, preset, opened.rig, untouched)(frame)
            print("method", name, len(patch.points), digest(patch.points, patch.mask), flush=True)


def main() -> None:
    """Print all hashes."""
    simulator = load_preset("simulator")
    for name in OBJECTS:
        print_patches(f"sim:{name}", f"sim:{name}?sensor=datasheet", simulator, PRESS_FRAMES)
        print_patches(f"sim:{name}?press=medium", f"sim:{name}?press=medium&sensor=datasheet", simulator, (0, 1, 2, 3))
        print_run(f"run sim:{name}", f"sim:{name}?sensor=datasheet", ["--frames", "40", "--truth"])
    test = ["--set", "contact_test=membrane"]
    print_run("run membrane", "sim:cup?press=high&sensor=datasheet", ["--frames", "4", "--truth", *test])
    print_methods("sim:cup?press=medium&sensor=datasheet", simulator)
    if (DATA / "real_pair").is_dir():
        real = f"folder:{DATA / 'real_pair'}"
        for offset in (0.0, REAL_OFFSET_M):
            print_patches(f"real pair {offset}", real, Preset().with_value("alignment.depth_offset_m", offset), (0,))
        print_run("run real pair", real, [])
    else:
        print(f"skipped: there is no {DATA / 'real_pair'}")
    with tempfile.TemporaryDirectory() as folder:
        path = str(Path(folder) / "octopus.mcap")
        record = [*TACTUNE, "record", "--source", "sim:octopus?sensor=datasheet", "--preset", "simulator"]
        subprocess.run([*record, "--out", path, "--frames", "60"], check=True, capture_output=True)
        print_patches("recording", path, simulator, (0, 30, 45, 59))
        print_run("run recording", path, ["--truth"])


if __name__ == "__main__":
    main()
