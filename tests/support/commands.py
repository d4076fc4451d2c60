"""How a command of Tactune ended."""

from __future__ import annotations

from typing import NamedTuple


class Finished(NamedTuple):
    """Exit status, standard output and standard error."""

    status: int
    out: str
    err: str

    @property
    def sentence(self) -> str:
        """The one sentence on standard error of a command that failed as it should."""
        assert self.status == 2, self
        assert self.out == ""
        assert self.err.startswith("tactune: ")
        assert self.err.count("\n") == 1
        return self.err
