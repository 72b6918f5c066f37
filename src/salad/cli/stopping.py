"""Being stopped: Ctrl-C and SIGTERM end a command the same way wherever it is, with one sentence and no traceback.

What a command does last is its own: it catches `KeyboardInterrupt`, as for Ctrl-C, and commits what it has. Nothing
heavy is imported here, for this is what the command line is made ready by before anything else.
"""

from __future__ import annotations

import os
import signal
import sys

INTERRUPTED, TERMINATED = 128 + 2, 128 + 15  # as shells have it: 128 and the signal's number
_SOON = 0.01  # seconds
_SENTENCE = "index, compress, train, compare and weights fetch go on where they stopped when run again"


class Terminated(KeyboardInterrupt):
    """SIGTERM came; whatever is done upon Ctrl-C is done."""


def listen() -> None:
    """Have SIGTERM and Ctrl-C raise, in this process alone, until `leave`."""
    home = os.getpid()

    def stop(number: int, *_: object) -> None:
        if os.getpid() != home:  # a fork of ours, which is ended by whoever made it
            signal.signal(number, signal.SIG_DFL)
            os.kill(os.getpid(), number)
        raise Terminated if number == signal.SIGTERM else KeyboardInterrupt

    def unheard(unraisable: sys.UnraisableHookArgs) -> None:
        # It came within a callback of Python's own, which imports are full of and which can raise nothing.
        if isinstance(unraisable.exc_value, KeyboardInterrupt) and hasattr(signal, "setitimer"):
            number = _number(unraisable.exc_value)
            signal.signal(signal.SIGALRM, lambda *_: stop(number))
            signal.setitimer(signal.ITIMER_REAL, _SOON)
        else:
            sys.__unraisablehook__(unraisable)

    for number in (signal.SIGINT, signal.SIGTERM):
        if signal.getsignal(number) != signal.SIG_IGN:  # nohup and shell scripts ask for it, and mean it
            signal.signal(number, stop)
    sys.unraisablehook = unheard


def leave() -> None:
    """Have signals end the process at once and in silence: all that there was to say is said."""
    for number in (signal.SIGINT, signal.SIGTERM):
        if callable(signal.getsignal(number)):
            signal.signal(number, signal.SIG_DFL)


def stopped_by(error: BaseException | None) -> KeyboardInterrupt | None:
    """The interrupt that an error is or came of: what is written in C makes an ImportError of it, for one."""
    seen: set[int] = set()
    while error is not None and id(error) not in seen:
        if isinstance(error, KeyboardInterrupt):
            return error
        seen.add(id(error))
        error = error.__cause__ or error.__context__
    return None


def told(stop: KeyboardInterrupt) -> tuple[int, str]:
    """The exit code of a command that was stopped, and what to say."""
    code = 128 + _number(stop)
    return code, f"{'terminated' if code == TERMINATED else 'interrupted'}; {_SENTENCE}"


def _number(stop: BaseException | None) -> int:
    return int(signal.SIGTERM if isinstance(stop, Terminated) else signal.SIGINT)
