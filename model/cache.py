"""Where compiled code is kept between runs: one folder for each version of the sources it was made from."""

import hashlib
import os
from collections.abc import Iterable
from pathlib import Path


def folder() -> Path:
    """Folder of all that is cached: TISSUE_CONTACT_CACHE, or tissue-contact in the user's cache folder."""
    chosen = os.environ.get("TISSUE_CONTACT_CACHE")
    if chosen:
        return Path(chosen)
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "tissue-contact"


def digest(files: Iterable[Path], *facts: str) -> str:
    """Short hash of the contents of files and of some more facts; the order of the files does not matter."""
    hashed = hashlib.sha256()
    for file in sorted(files):
        hashed.update(file.name.encode() + b"\0" + file.read_bytes() + b"\0")
    for fact in facts:
        hashed.update(fact.encode() + b"\0")
    return hashed.hexdigest()[:16]
