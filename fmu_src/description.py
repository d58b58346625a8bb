"""``modelDescription.xml``, made from the table of variables."""

import importlib.metadata
import math
import re

from lxml import etree

from tissue_contact.assembly import Assembly
from tissue_contact.errors import WorkError
from tissue_contact.fmu.model_bin import LOG_CATEGORIES
from tissue_contact.fmu.units import base_unit
from tissue_contact.variables import CAUSALITY, VARIABILITY, Block

# Relative tolerance that the description proposes; the substep follows from stability and does not depend on
# it.
TOLERANCE = 1e-6


def generation_tool() -> str:
    """Name and version of this product."""
    return f"tissue-contact {importlib.metadata.version('tissue-contact')}"


def model_identifier(name: str) -> str:
    """A scene's name as a C identifier."""
    identifier = re.sub(r"[^A-Za-z0-9_]", "_", name)
    return identifier if re.match(r"[A-Za-z_]", identifier) else f"_{identifier}"


def number(value: float) -> str:
    """Shortest decimal text that reads back as the same double."""
    return repr(float(value))


def _check(assembly: Assembly) -> None:
    names = [v.name for v in assembly.variables]
    if len(set(names)) != len(names):
        raise WorkError(f"variable names must be unique; twice: {sorted({n for n in names if names.count(n) > 1})}")
    for v in assembly.variables:
        if v.block != "outputs" and not (math.isfinite(v.start) and v.minimum <= v.start <= v.maximum):
            raise WorkError(f"{v.name} starts at {v.start}, outside [{v.minimum}, {v.maximum}]")


def _units(root: etree._Element, assembly: Assembly) -> None:
    definitions = etree.SubElement(root, "UnitDefinitions")
    for unit in sorted({v.unit for v in assembly.variables} | {"s"}):
        element = etree.SubElement(definitions, "Unit", name=unit)
        etree.SubElement(element, "BaseUnit", {base: str(power) for base, power in base_unit(unit).items()})


def _variables(root: etree._Element, assembly: Assembly) -> None:
    variables = etree.SubElement(root, "ModelVariables")
    for reference, v in enumerate(assembly.variables):
        attributes = {
            "name": v.name,
            "valueReference": str(reference),
            "description": v.description,
            "causality": CAUSALITY[v.block],
            "variability": VARIABILITY[v.block],
        }
        if v.block == "outputs":
            attributes["initial"] = "calculated"
        elif v.block == "parameters":
            attributes["initial"] = "exact"
        real = {"unit": v.unit}
        if math.isfinite(v.minimum):
            real["min"] = number(v.minimum)
        if math.isfinite(v.maximum):
            real["max"] = number(v.maximum)
        if v.block != "outputs":
            real["start"] = number(v.start)
        element = etree.SubElement(variables, "ScalarVariable", attributes)
        etree.SubElement(element, "Real", real)


def _structure(root: etree._Element, assembly: Assembly) -> None:
    def places(*wanted: Block) -> list[str]:
        return [str(i) for i, v in enumerate(assembly.variables, start=1) if v.block in wanted]

    structure = etree.SubElement(root, "ModelStructure")
    # Parameters are knowns of the initial values only; FMI does not list them for the outputs.
    for element, knowns in (
        ("Outputs", places("inputs")),
        ("InitialUnknowns", places("inputs", "parameters")),
    ):
        unknowns = etree.SubElement(structure, element)
        for index in places("outputs"):
            etree.SubElement(
                unknowns,
                "Unknown",
                index=index,
                dependencies=" ".join(knowns),
                dependenciesKind=" ".join(["dependent"] * len(knowns)),
            )


def write(assembly: Assembly, guid: str) -> bytes:
    """UTF-8 text of modelDescription.xml.

    Raises
    ------
    WorkError
        A variable has an unknown unit, a start outside its bounds, or a name that another one has.
    """
    _check(assembly)
    root = etree.Element(
        "fmiModelDescription",
        fmiVersion="2.0",
        modelName=assembly.name,
        guid=guid,
        description=assembly.description,
        version=importlib.metadata.version("tissue-contact"),
        license="MIT",
        generationTool=generation_tool(),
        variableNamingConvention="structured",
        numberOfEventIndicators="0",
    )
    etree.SubElement(
        root,
        "CoSimulation",
        modelIdentifier=model_identifier(assembly.name),
        canHandleVariableCommunicationStepSize="true",
        canInterpolateInputs="false",
        maxOutputDerivativeOrder="0",
        canRunAsynchronuously="false",
        canBeInstantiatedOnlyOncePerProcess="false",
        canNotUseMemoryManagementFunctions="true",
        canGetAndSetFMUstate="true",
        canSerializeFMUstate="true",
        providesDirectionalDerivative="false",
    )
    _units(root, assembly)
    categories = etree.SubElement(root, "LogCategories")
    for name, description in LOG_CATEGORIES.values():
        etree.SubElement(categories, "Category", name=name, description=description)
    etree.SubElement(
        root,
        "DefaultExperiment",
        startTime=number(assembly.start_time),
        stopTime=number(assembly.stop_time),
        tolerance=number(TOLERANCE),
        stepSize=number(assembly.step_size),
    )
    _variables(root, assembly)
    _structure(root, assembly)
    return etree.tostring(root, xml_declaration=True, encoding="UTF-8", pretty_print=True)
