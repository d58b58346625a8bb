"""The compiled numerics. Only numpy and numba are known here."""

from pathlib import Path

import numba

from tissue_contact import cache

if not numba.config.CACHE_DIR:  # a folder that NUMBA_CACHE_DIR names is left as it is
    # numba keys a cached function by its own file only: a kernel that was changed, or compiled with other
    # optimisations, would live on inside its callers.
    _SOURCES = [*Path(__file__).parent.glob("*.py"), Path(__file__).parent.parent / "status.py"]
    _KEY = cache.digest(_SOURCES, numba.__version__, str(numba.config.SLP_VECTORIZE))
    numba.config.CACHE_DIR = str(cache.folder() / f"jit-{_KEY}")
