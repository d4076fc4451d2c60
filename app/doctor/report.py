"""All checks of this computer in the order of the report, and the report as text."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor

from . import cameras, system
from .checks import Check, State


def check_computer() -> list[Check]:
    """Run all checks in parallel and return their lines in order. It takes seconds and never raises."""
    with ThreadPoolExecutor(max_workers=4) as pool:
        return [line for lines in pool.map(_guarded, all_checks()) for line in lines]


def all_checks() -> Sequence[Callable[[], Sequence[Check]]]:
    return (
        system.check_python,
        system.check_packages,
        system.check_cache_folder,
        system.check_shared_memory,
        cameras.check_drivers,
        cameras.check_udev_rules,
        cameras.check_cameras,
        system.check_window,
        system.check_qt_libraries,
    )


def _guarded(check: Callable[[], Sequence[Check]]) -> Sequence[Check]:
    try:
        return check()
    except Exception as error:
        name = check.__name__.removeprefix("check_").replace("_", " ")
        problem = f"could not be checked ({type(error).__name__}: {error})"
        return [Check(name, State.WARN, problem, "Please report this with the line above.")]


def report(lines: Sequence[Check]) -> str:
    """Return the lines as text, with their number at the end."""
    failed, warned = (sum(line.state is state for line in lines) for state in (State.FAIL, State.WARN))
    checks = "\n".join(line.text() for line in lines)
    return f"{checks}\n\n{len(lines)} checks: {failed} failed, {warned} with a warning"
