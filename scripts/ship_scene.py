"""Solve the simulator's default scene and write it into the package, where the first start finds it.

Needed whenever the parameters or, with `_IMAGES_VERSION`, the code of the clean images change; a test
says so. Older files are removed.

    .venv/bin/python scripts/ship_scene.py
"""

from __future__ import annotations

from tactune.core.sources.simulator.source import SHIPPED, SimulatorSource, cache_file, save_scene


def main() -> None:
    """Write the file and print its size."""
    simulator = SimulatorSource()
    path = SHIPPED / cache_file(simulator.scene.name, f"{simulator.scene.key} {simulator.rig.model_dump_json()}").name
    solved = simulator.solve_anew(simulator.scene, lambda share, words: None)
    for older in SHIPPED.glob("*"):
        older.unlink()
    save_scene(path, solved)
    print(f"{path}: {path.stat().st_size / 1e6:.1f} MB")


if __name__ == "__main__":
    main()
