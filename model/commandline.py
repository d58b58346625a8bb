"""What the command and the tools of `make` share: an option, and how they end where something is wrong."""

import errno
import functools
from collections.abc import Callable
from typing import Annotated, Any, NoReturn

import typer

from tissue_contact.errors import InputError, TissueContactError

Workers = Annotated[int, typer.Option(min=1, max=1024, help="Processes to spread the work over.")]


def guarded(function: Callable[..., None], name: str) -> Callable[..., None]:
    """The function; an error ends it with one line on stderr, after ``name``, and 2 for wrong input, 1 for others."""

    def fail(text: str, code: int) -> NoReturn:
        typer.echo(f"{name}: {' '.join(text.split())}", err=True)
        raise typer.Exit(code)

    @functools.wraps(function)
    def guard(*args: Any, **kwargs: Any) -> None:
        try:
            function(*args, **kwargs)
        except InputError as error:
            fail(str(error), 2)
        except TissueContactError as error:
            fail(str(error), 1)
        except OSError as error:
            if error.errno in (None, errno.EPIPE):  # of a cluster; of a reader that has gone, as click knows
                raise
            place, rule = str(error.filename or "a file"), "it must be possible to read or write it"
            fail(str(InputError(place, rule, error.strerror, "Give another path, or make room")), 2)
        except KeyboardInterrupt as error:
            fail(str(error) or "interrupted", 130)

    return guard
