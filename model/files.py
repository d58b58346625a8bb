"""Files appear whole or not at all."""

import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import BinaryIO


@contextmanager
def whole(path: Path) -> Iterator[BinaryIO]:
    """A file to write, of which whoever looks at ``path`` sees all or what was there before; makes its folder.

    An ``OSError`` names ``path``: by itself it would name the file beside it, and of a full disk none.
    """
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        handle, name = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.")
        try:
            with os.fdopen(handle, "wb") as file:
                yield file
            mask = os.umask(0)
            os.umask(mask)
            Path(name).chmod(0o666 & ~mask)  # mkstemp makes files that only their owner may read
            Path(name).replace(path)
        except BaseException:
            Path(name).unlink(missing_ok=True)
            raise
    except OSError as error:
        if error.errno is not None:  # else its text would be lost
            error.filename = str(path)
        raise


def publish(path: Path, content: bytes) -> None:
    """Write a file as `whole` does."""
    with whole(path) as file:
        file.write(content)
