"""What holds for every test."""

from __future__ import annotations

import signal

from hypothesis import settings

# A busy machine is no failure.
settings.register_profile("tactune", deadline=None)
settings.load_profile("tactune")

# A shell makes what it runs in the background ignore interrupts, and so would every program that a test starts.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)
