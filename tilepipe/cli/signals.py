"""Signals that ask a program to end: the first is an interruption, the second ends it at once."""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from types import FrameType

_ENDING = tuple(getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name))
"""Ctrl-C, what systems and batch queues send, and the loss of the terminal."""


@dataclass
class Interruption:
    """Whether a signal has come, and whether what it ends can be resumed."""

    received: bool = False
    resumable: bool = True


@contextmanager
def interruptible() -> Iterator[Interruption]:
    """Make each signal that asks for the end a ``KeyboardInterrupt`` for the length of a block.

    The second one has its effect of old, so that a block that waits for its threads can be ended.  A signal that is
    ignored stays so (``nohup``, a job in the background), and one that somebody else handles is theirs.

    Yields
    ------
    Interruption
        Told when a signal has come.

    Examples
    --------
    >>> import signal
    >>> from tilepipe.cli.signals import interruptible
    >>> with interruptible() as interruption:
    ...     try:
    ...         signal.raise_signal(signal.SIGTERM)
    ...     except KeyboardInterrupt:
    ...         print(interruption.received)
    True
    """
    interruption = Interruption()
    # only the main thread hears of signals
    before = {} if threading.current_thread() is not threading.main_thread() else _handled_by_none()

    def interrupt(number: int, frame: FrameType | None) -> None:
        interruption.received = True
        for each in before:
            signal.signal(each, signal.SIG_DFL)
        raise KeyboardInterrupt

    for number in before:
        signal.signal(number, interrupt)
    try:
        yield interruption
    finally:
        # after an interruption the next signal is to end what is left
        if not interruption.received:
            for number, handler in before.items():
                signal.signal(number, handler)


def _handled_by_none() -> dict[signal.Signals, signal._HANDLER]:
    handlers = {number: signal.getsignal(number) for number in _ENDING}
    return {number: old for number, old in handlers.items() if old in (signal.SIG_DFL, signal.default_int_handler)}
