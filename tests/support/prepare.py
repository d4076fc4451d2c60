"""Compile the kernels and solve the scenes that many tests use, once, before two test processes need them.

A second run finds everything on the disk and takes a few seconds.
"""

from __future__ import annotations

from coarse_scenes import solve_coarsely
from tactune.core.sources.registry import open_source
from tactune.core.warmup import warm_up_if_needed

SCENES = (
    "cup",
    "cup?press=none",
    "cup?press=low",
    "cup?press=medium",
    "cup?press=low&grid=dots",
    "tray",
)

if __name__ == "__main__":
    solve_coarsely()
    warm_up_if_needed(lambda share, words: None)
    for scene in SCENES:
        open_source(f"sim:{scene}").close()
