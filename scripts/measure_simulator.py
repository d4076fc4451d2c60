"""Compare the simulator preset's patches with the truth, per object and press depth.

    .venv/bin/python scripts/measure_simulator.py [--noise 1] [--seed 0]

Prints the worst share of pixels in the patch over all frames without touch, then the means of IoU,
precision, recall and symmetric RMSE in bands of press depth, and the pipeline's median time.
"""

from __future__ import annotations

import argparse
import statistics

from tactune.core import ContactPipeline, load_preset
from tactune.core.evaluation.metrics import compare_with_truth
from tactune.core.sources.simulator.source import SimulatorSource

OBJECTS = ("cube", "cup", "octopus")
BANDS_MM = ((0, 5), (5, 15), (15, 30), (30, 60))


def measure(scene: str, seed: int, noise: float) -> None:
    """Run a whole press sequence and print its rows."""
    bands: dict[tuple[int, int], list[dict[str, float]]] = {band: [] for band in BANDS_MM}
    untouched_shares, times_ms = [], []
    with SimulatorSource(scene, seed, noise) as source:
        pipeline = ContactPipeline(load_preset("simulator"), source.rig)
        for frame in source:
            patch = pipeline.process(frame)
            times_ms.append(sum(patch.stage_ms.values()))
            depth_mm = 1e3 * source.facts(frame.sequence).depth_m
            assert frame.truth is not None
            if not frame.truth.contact.any():
                untouched_shares.append(100 * len(patch.points) / patch.mask.size)
                continue
            band = next(band for band in BANDS_MM if band[0] <= depth_mm < band[1])
            bands[band].append(compare_with_truth(patch, frame.truth, source.rig))
    print(
        f"{scene}: {len(untouched_shares)} frames without touch, worst share of pixels {max(untouched_shares):.4f} %; "
        f"median {statistics.median(times_ms):.1f} ms a frame"
    )
    for (near, far), scores in bands.items():
        iou, precision, recall, rmse_mm = (
            statistics.fmean(score[key] for score in scores) for key in ("iou", "precision", "recall", "rmse_mm")
        )
        print(
            f"  {near:2d}-{far:2d} mm  {len(scores):2d} frames  IoU {iou:.3f}  precision {precision:.3f}  "
            f"recall {recall:.3f}  RMSE {rmse_mm:.2f} mm"
        )


def main() -> None:
    """Measure every object."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--noise", type=float, default=1.0)
    arguments = parser.parse_args()
    for scene in OBJECTS:
        measure(scene, arguments.seed, arguments.noise)


if __name__ == "__main__":
    main()
