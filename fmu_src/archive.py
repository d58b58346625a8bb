"""The .fmu file: a zip that is either complete or not there."""

import zipfile
from collections.abc import Mapping
from pathlib import Path

from tissue_contact.files import whole

_EPOCH = (1980, 1, 1, 0, 0, 0)  # the same bytes whenever it is built


def write(output: Path, entries: Mapping[str, bytes]) -> None:
    """Write entries, given by their names with forward slashes, to ``output`` at once.

    Interrupted or failing, it leaves what was at ``output`` before and nothing beside it.

    Raises
    ------
    OSError
        The file cannot be written.
    """
    with whole(output) as file, zipfile.ZipFile(file, "w") as archive:
        for entry in sorted(entries):
            info = zipfile.ZipInfo(entry, _EPOCH)
            info.compress_type = zipfile.ZIP_DEFLATED
            info.create_system = 3  # so that the permissions below are read
            info.external_attr = (0o100755 if entry.startswith("binaries/") else 0o100644) << 16
            archive.writestr(info, entries[entry])
