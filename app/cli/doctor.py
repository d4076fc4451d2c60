"""The command ``tactune doctor``: what is wrong with this computer, and the remedy for each."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from typing import Annotated

import typer

from ..doctor.checks import Check, State, run_checks

#: Exit status where a check fails.
FAILED_STATUS = 1


def doctor(
    *,
    as_json: Annotated[bool, typer.Option("--json", help="Print the checks as JSON.")] = False,
) -> None:
    """Check Python, packages, camera driver, USB, permissions, Qt and OpenGL; say what is wrong and the remedy.

    Exit status 0 where nothing fails (warnings concern only some uses), 1 where something does.
    """
    lines = run_checks(all_checks())
    failed = [line for line in lines if line.state is State.FAIL]
    if as_json:
        typer.echo(json.dumps({"ok": not failed, "checks": [line.to_json() for line in lines]}, indent=2))
    else:
        for line in lines:
            typer.echo("\n".join(line.lines()))
        warned = sum(line.state is State.WARN for line in lines)
        typer.echo(f"\n{len(lines)} checks: {len(failed)} failed, {warned} with a warning")
    if failed:
        raise typer.Exit(FAILED_STATUS)


def all_checks() -> Sequence[Callable[[], Sequence[Check]]]:
    """Return the checks in the order of the report."""
    from ..doctor import cameras, system, window

    return (
        system.check_python,
        system.check_packages,
        system.check_compiled_code,
        system.check_cache_folder,
        system.check_shared_memory,
        cameras.check_libraries,
        cameras.check_driver,
        cameras.check_udev_rules,
        cameras.check_cameras,
        window.check_qt,
        window.check_qt_libraries,
        window.check_opengl,
    )
