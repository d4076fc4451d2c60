"""``python -m tactune.app`` is the command ``tactune``."""

from __future__ import annotations

import signal
import sys


def main() -> int:
    """Run the command. SIGTERM ends it as Ctrl+C does: no process and no part of a file is left."""
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        from .cli.main import main as run  # here, so that Ctrl+C meanwhile has no traceback

        return run()
    except KeyboardInterrupt:
        return 130
    except SystemError as error:
        cause: BaseException | None = error
        while isinstance(cause, SystemError):  # so numba wraps Ctrl+C while a kernel runs
            cause = cause.__cause__
        if not isinstance(cause, KeyboardInterrupt):
            raise
        return 130


if __name__ == "__main__":
    sys.exit(main())
