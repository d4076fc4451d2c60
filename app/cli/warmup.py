"""The command ``tactune warmup``: compile before the first frame."""

from __future__ import annotations

import time

import typer

from .progress import CliProgress


def warmup() -> None:
    """Compile the pipeline for this computer, so that a robot's first frame does not wait for it."""
    from ...core.contact.warmup import is_compiled, warm_up

    started = time.perf_counter()
    with CliProgress() as progress:
        result = warm_up(progress.preparing) if not is_compiled() else warm_up()
    seconds = time.perf_counter() - started
    if result.compiled:
        typer.echo(f"compiled {result.compiled} kernels and loaded {result.loaded} in {seconds:.1f} s")
    else:
        typer.echo(f"nothing to compile: {result.loaded} kernels loaded in {seconds:.1f} s")
    if result.folders:
        typer.echo("kept in " + ", ".join(str(folder) for folder in result.folders))
    else:
        typer.echo(
            "tactune: no folder to keep them in can be written, so each start compiles anew; "
            "set NUMBA_CACHE_DIR to one that can",
            err=True,
        )
