"""What a run tells about its progress, and to whom: a bar, a log, nobody."""

from __future__ import annotations

from typing import Protocol


class Progress(Protocol):
    """What a run tells about its progress."""

    def start(self, name: str, total: int, done: int) -> None:
        """A stage of ``total`` tiles begins, of which ``done`` were finished by an earlier run."""
        ...

    def advance(self, name: str) -> None:
        """One more tile is finished."""
        ...

    def __call__(self, stage: str, done: int, total: int) -> None:
        """Work that counts by itself has finished ``done`` of ``total``."""
        ...

    def compiling(self) -> None:
        """A kernel is compiled for this machine, as each is once; told again for every one."""
        ...


class Silent:
    """Progress that tells nothing."""

    def start(self, name: str, total: int, done: int) -> None:
        """See `Progress.start`."""

    def advance(self, name: str) -> None:
        """See `Progress.advance`."""

    def __call__(self, stage: str, done: int, total: int) -> None:
        """See `Progress.__call__`."""

    def compiling(self) -> None:
        """See `Progress.compiling`."""
