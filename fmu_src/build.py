"""Turn an assembly into an .fmu file."""

import hashlib
from collections.abc import Sequence
from pathlib import Path

from tissue_contact.assembly import Assembly
from tissue_contact.errors import InputError
from tissue_contact.fmu import archive, compile, description, documentation, model_bin
from tissue_contact.fmu.compile import ALL, Progress


def guid_of(description_blank: bytes, model_blank: bytes) -> str:
    """The guid: a hash of modelDescription.xml and model.bin, both with an empty guid."""
    digest = hashlib.sha256(description_blank + model_blank).hexdigest()
    return "{" + "-".join((digest[:8], digest[8:12], digest[12:16], digest[16:20], digest[20:32])) + "}"


def build(
    assembly: Assembly,
    output: Path,
    platforms: Sequence[str] = ALL,
    picture: bytes | None = None,
    on_progress: Progress | None = None,
    kernels: Path = compile.STEP_KERNELS,
) -> Path:
    """Build an .fmu; the same assembly gives the same bytes.

    Parameters
    ----------
    assembly : Assembly
        The scene.
    output : Path
        The .fmu file to write. It is complete or not written at all.
    platforms : sequence of str
        Which of `compile.ALL` to include.
    picture : bytes, optional
        A PNG image of the scene, shown by importers and in the documentation.
    on_progress : callable, optional
        Called with a short text before each slow part.
    kernels : Path
        Python file with the functions ``initialize`` and ``step``.

    Returns
    -------
    Path
        ``output``.

    Raises
    ------
    InputError
        A platform is unknown or none is given, or ``output`` is in no directory.
    WorkError
        A kernel or a C file does not compile, or the assembly contradicts itself.
    """
    progress = on_progress or (lambda _: None)
    if not platforms:
        raise InputError("platforms", "must name at least one platform", "none", f"Choose from {', '.join(ALL)}")
    output = Path(output)
    if not output.parent.is_dir():
        raise InputError("output", "must lie in an existing directory", output, "Make the directory first")

    guid = guid_of(description.write(assembly, ""), model_bin.write(assembly, ""))
    identifier = description.model_identifier(assembly.name)
    entries = {
        "modelDescription.xml": description.write(assembly, guid),
        "resources/model.bin": model_bin.write(assembly, guid),
        "resources/scene.toml": assembly.source,
        **documentation.entries(assembly, picture),
    }
    if picture is not None:
        entries["model.png"] = picture
    for platform, content in compile.shared_libraries(platforms, kernels, progress).items():
        entries[f"binaries/{platform}/{identifier}{compile.target(platform).suffix}"] = content
    progress(f"writing {output}")
    archive.write(output, entries)
    return output
