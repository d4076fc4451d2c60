"""All checks of this computer in the order of the report, and the report as text."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from . import cameras, system
from .checks import Check, State, run_checks


def check_computer() -> list[Check]:
    """Run all checks in parallel and return their lines. It takes seconds and never raises."""
    return run_checks(all_checks())


def report(lines: Sequence[Check]) -> str:
    """Return the lines as text, with their number at the end."""
    failed, warned = (sum(line.state is state for line in lines) for state in (State.FAIL, State.WARN))
    checks = "\n".join(text for line in lines for text in line.lines())
    return f"{checks}\n\n{len(lines)} checks: {failed} failed, {warned} with a warning"


def all_checks() -> Sequence[Callable[[], Sequence[Check]]]:
    """Return the checks in the order of the report."""
    return (
        system.check_python,
        system.check_packages,
        system.check_compiled_code,
        system.check_cache_folder,
        system.check_shared_memory,
        cameras.check_driver,
        cameras.check_all_drivers,
        cameras.check_udev_rules,
        cameras.check_cameras,
        system.check_window,
        system.check_qt_libraries,
    )
