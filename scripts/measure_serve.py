"""Measure what publishing costs: the real window plays a source while a client of its own process takes every topic.

Three states follow each other: nothing published, published without a client, and a client with all topics. For each:
frames shown and published in a second, and the processor time of the whole process per processed frame, which hardly
depends on other load. The client throws the bytes away, as a quick one would::

    QT_QPA_PLATFORM=offscreen python scripts/measure_serve.py --source live:sim:cup --seconds 15
"""

from __future__ import annotations

import argparse
import json
import os
import struct
import subprocess
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path

from PyQt6.QtCore import QTimer
from websockets.sync.client import connect
from websockets.typing import Subprotocol

from tactune.app.cli.common import default_preset
from tactune.app.gui import make_application
from tactune.app.settings import Settings
from tactune.app.window.main_window import MainWindow
from tactune.core.sources.presets import load_preset

PORT = 8797
WARM_UP_MS = 4000
STATES = ("off", "no client", "all topics")


class Measurement:
    """Takes the window through the states and counts."""

    def __init__(self, window: MainWindow, seconds: float) -> None:
        self._window, self._seconds = window, seconds
        self._shown = 0
        self._left = list(STATES)
        command = [sys.executable, __file__, "--client", str(PORT), "--seconds", str(seconds + WARM_UP_MS / 1e3)]
        self._client = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
        self._before: tuple[float, float, int, int] = (0.0, 0.0, 0, 0)
        self.lines: list[str] = []
        window.context.frameShown.connect(self._count)
        self._wait_for_frames()

    def _wait_for_frames(self) -> None:
        ready = self._shown > 30 and self._window.result is not None and self._window.result.patch is not None
        QTimer.singleShot(WARM_UP_MS if ready else 200, self._begin if ready else self._wait_for_frames)

    def _count(self) -> None:
        self._shown += 1

    def _now(self) -> tuple[float, float, int, int]:
        result = self._window.result
        assert result is not None
        return time.perf_counter(), time.process_time(), self._shown, result.processed

    def _begin(self) -> None:
        state, switch = self._left[0], self._window.publishing.window
        if state == "no client":
            switch.port.setValue(PORT)
            switch.start.click()
        if state == "all topics":
            assert self._client.stdin is not None
            print(file=self._client.stdin, flush=True)
        QTimer.singleShot(WARM_UP_MS, self._start)

    def _start(self) -> None:
        self._before = self._now()
        QTimer.singleShot(round(1e3 * self._seconds), self._end)

    def _end(self) -> None:
        seconds, processor_s, shown, processed = (
            after - before for after, before in zip(self._now(), self._before, strict=True)
        )
        state = self._left.pop(0)
        self.lines.append(
            f"{state:11s} {shown / seconds:5.1f} frames/s shown, {processed / seconds:5.1f} processed, "
            f"{1e3 * processor_s / max(processed, 1):6.1f} ms of processor time per processed frame, "
            f"{100 * processor_s / seconds:4.0f} % of a core"
        )
        if self._left:
            self._begin()
            return
        words = self._window.publishing.window.state.text()
        out, _ = self._client.communicate()
        self._window.close_without_asking()
        self.lines += [out.strip(), f"window: {words}"]


def take_all(port: int, seconds: float) -> str:
    """Wait for a line on standard input, subscribe to every topic, read for some seconds, and return what came."""
    sys.stdin.readline()
    topics: dict[int, str] = {}
    counts: Counter[str] = Counter()
    total = 0
    with connect(f"ws://127.0.0.1:{port}", subprotocols=[Subprotocol("foxglove.sdk.v1")], max_size=None) as server:
        spent_s, began_s = time.process_time(), time.monotonic()
        end_s = began_s + seconds
        while time.monotonic() < end_s:
            message = server.recv()
            if isinstance(message, bytes):
                counts[topics[struct.unpack_from("<xI", message)[0]]] += 1
                total += len(message)
            elif (told := json.loads(message))["op"] == "advertise":
                topics |= {channel["id"]: channel["topic"] for channel in told["channels"]}
                wanted = [{"id": number, "channelId": number} for number in topics]
                server.send(json.dumps({"op": "subscribe", "subscriptions": wanted}))
                began_s = time.monotonic()
        took_s = time.monotonic() - began_s
    frames = max(counts["/tactune/frame"], 1)
    return (
        f"client      {frames / took_s:5.1f} frames/s, {counts['/proximity/points'] / took_s:.1f} proximity and "
        f"{counts['/tactile/points'] / took_s:.1f} tactile clouds/s, {len(counts)} topics, "
        f"{total / took_s / 1e6:.0f} MB/s, {1e3 * (time.process_time() - spent_s) / frames:.1f} ms of its own "
        "processor time per frame"
    )


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--source", default="live:sim:cup")
    parser.add_argument("--seconds", type=float, default=15.0, help="for each state")
    parser.add_argument("--size", default="1280x800")
    parser.add_argument("--client", type=int, metavar="PORT", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.client:
        print(take_all(options.client, options.seconds))
        return
    application = make_application()
    with tempfile.TemporaryDirectory() as folder:
        place = Path(folder)
        preset = load_preset(default_preset(options.source))
        window = MainWindow(preset, Settings(place / "window.json"), place, native_dialogs=False)
        window.resize(*map(int, options.size.split("x")))
        window.show()
        window.open_source(options.source)
        measurement = Measurement(window, options.seconds)
        application.exec()
    print(f"{options.source} in a window of {options.size}, {os.cpu_count()} cores, load {os.getloadavg()[0]:.1f}")
    print("\n".join(measurement.lines))


if __name__ == "__main__":
    main()
