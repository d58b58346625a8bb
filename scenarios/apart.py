"""Work in a process of its own, for what may be missing, fail, crash or hang.

A module of its own, with nothing heavy: the process loads it, and then what the work needs.
"""

import os
import signal
import tempfile
from collections.abc import Callable
from multiprocessing import get_context
from multiprocessing.connection import Connection
from typing import Any

LIMIT = 120.0  # s, for one work


class LeftOut(Exception):
    """Why something could not be measured."""


def _send(sender: Connection, folder: str, work: Callable[..., Any], arguments: tuple[Any, ...]) -> None:
    os.chdir(folder)  # some libraries leave a log where they run
    try:
        sender.send((work(*arguments), ""))
    except ImportError as error:
        sender.send((None, f"not installed: {error}"))
    except Exception as error:
        sender.send((None, f"{type(error).__name__}: {error}"))


def apart(work: Callable[..., Any], *arguments: Any, limit: float = LIMIT) -> Any:
    """What a function gives in a process of its own; raises LeftOut where it gives nothing."""
    context = get_context("spawn")
    receiver, sender = context.Pipe(duplex=False)
    with tempfile.TemporaryDirectory() as folder:
        process = context.Process(target=_send, args=(sender, folder, work, arguments))
        process.start()
        sender.close()
        try:
            if not receiver.poll(limit):
                raise LeftOut(f"not done after {limit:g} s")
            result, reason = receiver.recv()
        except EOFError:
            process.join()
            code = process.exitcode or 0
            end = f"by {signal.Signals(-code).name}" if code < 0 else f"with exit code {code}"
            raise LeftOut(f"ended {end}") from None
        finally:
            process.kill()
            process.join()
    if reason:
        raise LeftOut(reason)
    return result
