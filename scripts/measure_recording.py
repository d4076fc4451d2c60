"""Record a minute of the simulator, play it back, compare every bit, and print the cost.

Frames are passed on at 30 Hz at most, like those of a live rig. The CPU time of the writing thread is
therefore the cost of a recording in a running application.
"""

from __future__ import annotations

import argparse
import hashlib
import itertools
import tempfile
import threading
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from tactune.core import ContactPipeline, load_preset, open_source
from tactune.core.model.frames import SensorFrame
from tactune.core.output import SessionWriter
from tactune.core.sources.mcap.source import McapSource

RATE_HZ = 30.0


def endless(scene: str) -> Iterator[SensorFrame]:
    """Yield the press of a scene repeatedly, with new noise each time, at 30 Hz of source time."""
    count = itertools.count()
    for seed in itertools.count():
        with open_source(f"{scene}{'&' if '?' in scene else '?'}seed={seed}") as source:
            for frame in source:
                number = next(count)
                time_s = 1.7e9 + number / RATE_HZ
                yield replace(frame, sequence=number, proximity_time_s=time_s, tactile_time_s=time_s + 0.0021)


def images_of(frame: SensorFrame) -> list[npt.NDArray[Any]]:
    """Return all images of a frame and of its truth."""
    truth = frame.truth
    images: list[npt.NDArray[Any] | None] = [
        frame.proximity_depth,
        frame.tactile_depth,
        frame.proximity_color,
        frame.tactile_color,
    ]
    if truth is not None:
        images += [truth.contact, truth.depth_m]
    return [image for image in images if image is not None]


def fingerprint(frame: SensorFrame, pipeline: ContactPipeline) -> bytes:
    """Hash the number, times and images of a frame and its patch."""
    patch = pipeline.process(frame)
    digest = hashlib.blake2b(repr((frame.sequence, frame.proximity_time_s, frame.tactile_time_s)).encode())
    for array in (*images_of(frame), patch.points, patch.provenance):
        digest.update(repr((array.dtype, array.shape)).encode())
        digest.update(np.ascontiguousarray(array).data)
    return digest.digest()


def main() -> int:
    """Measure; return 1 if a frame is missing or a bit differs."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--frames", type=int, default=1800, help="number of frames; 1800 frames last one minute")
    parser.add_argument("--scene", default="sim:cup?sensor=datasheet", help="such as sim:cube")
    parser.add_argument(
        "--folder", type=Path, help="folder of the temporary recording; default: the system temporary folder"
    )
    options = parser.parse_args()

    preset = load_preset("simulator")
    with open_source(options.scene) as source:
        rig = source.rig
    pipeline = ContactPipeline(preset, rig)
    with tempfile.TemporaryDirectory(dir=options.folder) as folder:
        path = Path(folder) / "session.mcap"
        expected, raw_bytes, caller_s = [], 0, 0.0
        writer = SessionWriter(path, rig, preset=preset, frame_rate_hz=RATE_HZ)
        (thread,) = [each for each in threading.enumerate() if each.name == "recording"]
        clock = time.pthread_getcpuclockid(thread.ident or 0)
        next_s = start_s = time.monotonic()
        for frame in itertools.islice(endless(options.scene), options.frames):
            expected.append(fingerprint(frame, pipeline))
            time.sleep(max(0.0, next_s - time.monotonic()))
            next_s = max(next_s, time.monotonic()) + 1 / RATE_HZ
            before_s = time.thread_time()
            writer.put(frame, wait=False)
            caller_s += time.thread_time() - before_s
            raw_bytes += sum(image.nbytes for image in images_of(frame))
        while (status := writer.status()).frames + status.dropped < options.frames and not status.error:
            time.sleep(0.01)
        writer_s = time.clock_gettime(clock)
        wall_s = time.monotonic() - start_s
        status = writer.close()

        opening_s = time.monotonic()
        with McapSource(path) as source:
            opening_s = time.monotonic() - opening_s
            pipeline = ContactPipeline(preset, source.rig)
            reading_s = time.process_time()
            played = [fingerprint(frame, pipeline) for frame in source]
            reading_s = time.process_time() - reading_s
            same_rig = source.rig == rig and source.preset() == preset
    seconds = options.frames / RATE_HZ
    differing = sum(one != other for one, other in zip(expected, played, strict=False))
    print(f"recorded       {status.frames} of {options.frames} frames, {status.dropped} dropped {status.error}")
    print(f"played         {len(played)} frames, {differing} differ in images, times or patch; rig same: {same_rig}")
    print(f"file           {status.bytes / 1e6:.0f} MB, {100 * status.bytes / raw_bytes:.0f} % of the images")
    print(f"data rate      {status.bytes / 1e6 / seconds:.1f} MB/s written, {raw_bytes / 1e6 / seconds:.1f} MB/s raw")
    print(
        f"writing thread {1e3 * writer_s / options.frames:.1f} ms per frame, {100 * writer_s / seconds:.0f} % of a core"
    )
    print(f"caller         {1e3 * caller_s / options.frames:.2f} ms per frame")
    print(f"opening        {1e3 * opening_s:.0f} ms")
    print(f"playing        {1e3 * reading_s / len(played):.1f} ms per frame, with the patch and this comparison")
    print(f"wall time      {wall_s:.0f} s for {seconds:.0f} s of frames")
    return int(status.frames != options.frames or played != expected or not same_rig)


if __name__ == "__main__":
    raise SystemExit(main())
