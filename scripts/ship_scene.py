"""Solve the simulator's default scene, with and without its object, into the package, for the first start.

Needed whenever the parameters or, with `_IMAGES_VERSION`, the code of the clean images change; a test
says so. Older files are removed.

    .venv/bin/python scripts/ship_scene.py
"""

from __future__ import annotations

from tactune.core.sources.simulator.simulator_source import SHIPPED, SimulatorSource, cache_file, save_scene


def main() -> None:
    """Write the files and print their sizes."""
    for older in SHIPPED.glob("*"):
        older.unlink()
    for source in (SimulatorSource(), SimulatorSource().with_object_away()):
        path = SHIPPED / cache_file(source.scene.name, f"{source.scene.key} {source.rig.model_dump_json()}").name
        save_scene(path, source.solve_anew(source.scene, lambda share, words: None))
        print(f"{path}: {path.stat().st_size / 1e6:.1f} MB")


if __name__ == "__main__":
    main()
