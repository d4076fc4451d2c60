"""The commands ``tactune demo``: closed loops on the simulator."""

from __future__ import annotations

import json
from dataclasses import asdict
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from ...core.errors import minus
from ...core.model.files import finite_or_none
from .common import CliProgress

if TYPE_CHECKING:
    from ...core.estimation.balance import AngleErrors, BalanceSummary, Gains

demo_commands = typer.Typer(help="Show what a robot can do with a patch, on the simulator.")


@demo_commands.callback()
def demo() -> None:
    """Keep ``balance`` a subcommand while it is the only one."""


@demo_commands.command()
def balance(
    *,
    method: Annotated[
        Literal["patch", "proximity"],
        typer.Option("--method", help="Angle from the contact patch or from the proximity camera alone."),
    ] = "patch",
    sensor: Annotated[
        str, typer.Option("--sensor", metavar="NAME", help="Errors of the simulated cameras, as in 'sim:?sensor=NAME'.")
    ] = "l515-d405",
    seed: Annotated[int, typer.Option("--seed", min=0, metavar="N", help="Noise of the cameras.")] = 0,
    seconds: Annotated[
        float,
        typer.Option("--seconds", min=1.0, max=600.0, metavar="S", help="Simulated time; books come at 3, 6, 9 s."),
    ] = 12.0,
    p_gain: Annotated[
        float, typer.Option("--p-gain", min=0.0, max=50.0, metavar="P", help="Sensor's rate per roll of the tray, 1/s.")
    ] = 5.0,
    d_gain: Annotated[
        float, typer.Option("--d-gain", min=0.0, max=5.0, metavar="D", help="Sensor's rate per rate of the tray.")
    ] = 0.1,
    as_json: Annotated[bool, typer.Option("--json", help="Print the summary as one JSON object.")] = False,
) -> None:
    """Level a tray on the membrane while books are put on it.

    The controller turns the sensor about the roll axis. The noise of both cameras is measured first, as on a real rig.
    """
    from ...core.estimation.balance import BalanceLoop, Gains, summarise
    from ...core.evaluation.sensor_table import measured_rig
    from ...core.sources.presets import load_preset
    from ...core.sources.simulator.source import SimulatorSource

    gains = Gains(p_gain, d_gain)
    with CliProgress() as bar, SimulatorSource("tray", seed=seed, sensor=sensor, progress=bar.preparing) as source:
        loop = BalanceLoop(source, measured_rig(load_preset("simulator"), source), method, gains)
        steps, total = [], round(seconds * source.frame_rate_hz)
        for _ in range(total):
            steps.append(loop.step())
            bar.frames(len(steps), total)
        name = source.name
    summary = summarise(steps)
    if as_json:
        record = {"source": name, "method": method, "gains": asdict(gains)} | asdict(summary)
        typer.echo(json.dumps(_finite(record), allow_nan=False))
    else:
        typer.echo(_report(name, method, gains, summary))


def _report(name: str, method: str, gains: Gains, found: BalanceSummary) -> str:
    from ...core.estimation.balance import LEVEL_DEG
    from ...core.sources.simulator.tray import BOOKS, DELAY_S, MAX_RATE_DEG_S

    books = ", ".join(f"{1e3 * book.mass_kg:.0f} g at {book.time_s:g} s" for book in BOOKS)
    settled = ", ".join("never" if each is None else f"{each:.2f} s" for each in found.settle_s)
    used = "the patch" if method == "patch" else "the proximity camera alone"
    return "\n".join(
        [
            f"{name}, {found.frames} frames; books: {books}",
            f"controller        angle from {used}; P {gains.p_per_s:g} 1/s, D {gains.d:g}; actuator at most "
            f"{MAX_RATE_DEG_S:g} degrees/s, {1e3 * DELAY_S:.0f} ms late",
            f"loop              {found.loop_hz:.0f} frames/s, simulation included",
            f"frame to angle    {found.latency_median_ms:.1f} ms, 95 % below {found.latency_p95_ms:.1f} ms; processor "
            f"time {found.processor_median_ms:.1f} ms, 95 % below {found.processor_p95_ms:.1f} ms",
            f"level to {LEVEL_DEG:g} degree after each book: {settled or 'no book'}",
            f"patch             {_line(found.patch)}",
            f"proximity alone   {_line(found.proximity)}",
            f"proximity alone has {found.rms_factor:.2f} times the RMS error and {found.noise_factor:.2f} times the "
            "noise of the patch",
        ]
    )


def _line(errors: AngleErrors) -> str:
    missing = f"; {errors.missing} frames without an angle" if errors.missing else ""
    return (
        f"{errors.rms_deg:.2f} degrees RMS: offset {minus(f'{errors.bias_deg:+.2f}')}, noise from frame to frame "
        f"{errors.noise_deg:.2f}; {100 * errors.within_1:.0f} % within one standard deviation, "
        f"{100 * errors.within_2:.0f} % within two{missing}"
    )


def _finite(value: Any) -> Any:
    """Replace numbers that JSON cannot hold by None."""
    if isinstance(value, dict):
        return {key: _finite(each) for key, each in value.items()}
    return finite_or_none(value) if isinstance(value, float) else value
