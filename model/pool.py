"""Work spread over the cores of this machine, or over those of a dask cluster, and kept as soon as it is done."""

import hashlib
import json
import signal
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from contextlib import contextmanager
from multiprocessing import get_context
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from tissue_contact.errors import InputError
from tissue_contact.files import publish

Task = TypeVar("Task")
Done = TypeVar("Done")
Spread = Callable[[Callable[[Any], Any], Sequence[Any], Callable[[int, Any], None]], list[Any]]

CONNECT_TIMEOUT = 10  # [s]


def in_line(work: Callable[[Task], Done], tasks: Sequence[Task], on_done: Callable[[int, Done], None]) -> list[Done]:
    """All tasks one after the other, in this process; `on_done` gets number and result of each."""
    results = []
    for n, task in enumerate(tasks):
        results.append(work(task))
        on_done(n, results[-1])
    return results


@contextmanager
def _interrupted_later() -> Iterator[None]:
    """Have an interruption wait, also in processes that are started meanwhile, until `_end_quietly`."""
    if not hasattr(signal, "pthread_sigmask"):  # Windows
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, [signal.SIGINT])
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _end_quietly() -> None:
    """Have a worker end without a word where it is interrupted: who spread the work says what is kept."""
    if signal.getsignal(signal.SIGINT) != signal.SIG_IGN:  # as in the background of a script, where all go on
        signal.signal(signal.SIGINT, signal.SIG_DFL)
    if hasattr(signal, "pthread_sigmask"):
        signal.pthread_sigmask(signal.SIG_UNBLOCK, [signal.SIGINT])


@contextmanager
def pool(workers: int, scheduler: str | None = None) -> Iterator[Spread]:
    """A function like `in_line` that spreads the tasks over processes.

    Parameters
    ----------
    workers
        Processes on this machine; with 1 the work is done in this one.
    scheduler
        Address of a dask scheduler, whose workers are used instead.

    Raises
    ------
    InputError
        No scheduler answers there.
    """
    if scheduler is not None:
        with _cluster(scheduler) as spread:
            yield spread
    elif workers == 1:
        yield in_line
    else:
        # A forked process would inherit the locks of libraries that this one has started.
        with ProcessPoolExecutor(workers, mp_context=get_context("spawn"), initializer=_end_quietly) as executor:

            def spread(work: Any, tasks: Sequence[Any], on_done: Callable[[int, Any], None]) -> list[Any]:
                with _interrupted_later():  # or workers that are just starting would tell of it
                    futures = {executor.submit(work, task): n for n, task in enumerate(tasks)}
                try:
                    for future in as_completed(futures):
                        on_done(futures[future], future.result())
                except BaseException:
                    executor.shutdown(cancel_futures=True)
                    raise
                return [future.result() for future in futures]

            yield spread


@contextmanager
def _cluster(address: str) -> Iterator[Spread]:
    from distributed import Client
    from distributed import as_completed as as_finished

    try:
        client = Client(address, timeout=CONNECT_TIMEOUT)
    except (OSError, ValueError) as error:
        way_out = "Start one with `dask scheduler` and `dask worker ADDRESS`, or leave --scheduler out"
        raise InputError("--scheduler", "a dask scheduler must answer there", address, way_out) from error
    with client:

        def spread(work: Any, tasks: Sequence[Any], on_done: Callable[[int, Any], None]) -> list[Any]:
            # Two tasks that look the same are two tasks.
            futures = [client.submit(work, task, pure=False) for task in tasks]
            place = {future.key: n for n, future in enumerate(futures)}
            for future in as_finished(futures):
                on_done(place[future.key], future.result())
            return [future.result() for future in futures]

        yield spread


class Kept:
    """Results of tasks in a file, so that what was interrupted goes on where it was."""

    def __init__(self, path: Path, problem: str) -> None:
        self.path, self._problem = path, problem
        self.done: dict[str, Any] = {}
        self.remark = ""  # for the user, of what is there already
        if path.is_file():
            try:
                kept = json.loads(path.read_bytes())
            except ValueError:
                kept = {}
            found = kept.get("done", {})
            if found and kept.get("problem") == problem:
                self.done = found
                self.remark = f"going on with {len(found)} finished tasks of {path}"
            elif found:
                why = "of another scene, with other options or of another version"
                self.remark = f"{path} has {len(found)} finished tasks {why}: they say nothing here and are replaced"

    def spread(
        self, spread: Spread, work: Callable[[Any], Any], tasks: Sequence[Any], keys: Sequence[str],
        on_done: Callable[[], None],
    ) -> list[Any]:  # fmt: skip
        """Results of all tasks, of which only those are done that are not kept; every one is kept at once."""
        open_ = [n for n, key in enumerate(keys) if key not in self.done]
        for _ in range(len(keys) - len(open_)):
            on_done()

        def keep(n: int, result: Any) -> None:
            done = {**self.done, keys[open_[n]]: result}
            publish(self.path, json.dumps({"problem": self._problem, "done": done}).encode())
            self.done = done  # what is interrupted before is not kept
            on_done()

        spread(work, [tasks[n] for n in open_], keep)
        return [self.done[key] for key in keys]


def problem_of(*parts: object) -> str:
    """Digest of all that some work depends on, for `Kept`."""
    own = hashlib.sha256()
    for part in parts:
        own.update(part.tobytes() if isinstance(part, np.ndarray) else repr(part).encode())
        own.update(b"\0")
    return own.hexdigest()
