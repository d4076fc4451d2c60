"""Compare strain measured from the simulated dots with the solver's, in percent.

    python scripts/measure_strain.py [SEED] [FRAMES]

Three numbers each along length and width: the largest measured, the solver's largest between neighbours of which
the tactile camera sees both dots, and its largest of all, hidden dots included. A dot counts as seen if any bit
of it is, so the second number may be that of a sliver at an edge whose middle is hidden. FRAMES (1) are averaged.
"""

from __future__ import annotations

import sys

from tactune.core.evaluation.strain import measure_strain
from tactune.core.evaluation.strain_average import average_still
from tactune.core.sources.registry import open_source

_SCENES = [
    (f"{shape} {press} {side}".strip(), f"sim:{shape}?press={press}&grid=dots" + f"&side={side}" * bool(side))
    for press, sides in (("low", ("",)), ("medium", ("",)), ("high", ("right", "left")))
    for shape in ("cube", "cup", "octopus")
    for side in sides
]

_HEAD = f"""Largest strain between neighbouring dots, percent. dots: measured. seen: the solver's, where the tactile
camera sees at least a bit of both dots. all: the solver's, hidden dots included.
{"scene":31s}|    length: dots, seen, all  |     width: dots, seen, all"""


def main() -> None:
    """Print a line a scene."""
    seed, count = (sys.argv[1:] + ["0", "1"][len(sys.argv) - 1 :])[:2]
    print(_HEAD)
    for name, scene in _SCENES:
        with open_source(f"{scene}&seed={seed}") as source:
            frame, _ = average_still([frame for _, frame in zip(range(int(count)), source, strict=False)], source.rig)
            measured, truth = measure_strain(frame, source.rig), frame.truth
        assert truth is not None and truth.strain is not None
        known = truth.strain
        words = [f"{name:20s}{measured.dots:4d} dots"]
        for axis, seen, every in (
            (measured.length, known.length_seen, known.length),
            (measured.width, known.width_seen, known.width),
        ):
            words.append(f"{100 * axis.largest:6.1f} {100 * seen:6.1f} {100 * every:6.1f}")
        print("  |".join(words), flush=True)


if __name__ == "__main__":
    main()
