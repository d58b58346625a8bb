"""The .fmu file: a zip that is either complete or not there."""

import os
import tempfile
import zipfile
from collections.abc import Mapping
from pathlib import Path

_EPOCH = (1980, 1, 1, 0, 0, 0)  # the same bytes whenever it is built


def write(output: Path, entries: Mapping[str, bytes]) -> None:
    """Write entries, given by their names with forward slashes, to ``output`` at once.

    Interrupted or failing, it leaves what was at ``output`` before and nothing beside it.

    Raises
    ------
    OSError
        The directory cannot be written.
    """
    handle, name = tempfile.mkstemp(dir=output.parent, prefix=f".{output.name}.", suffix=".part")
    try:
        with os.fdopen(handle, "wb") as file, zipfile.ZipFile(file, "w") as archive:
            for entry in sorted(entries):
                info = zipfile.ZipInfo(entry, _EPOCH)
                info.compress_type = zipfile.ZIP_DEFLATED
                info.create_system = 3  # so that the permissions below are read
                info.external_attr = (0o100755 if entry.startswith("binaries/") else 0o100644) << 16
                archive.writestr(info, entries[entry])
        umask = os.umask(0)
        os.umask(umask)
        Path(name).chmod(0o666 & ~umask)
        Path(name).replace(output)
    except BaseException:
        Path(name).unlink(missing_ok=True)
        raise
