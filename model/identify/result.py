"""What an identification came to: the file `result.json`, read back by `run --parameters`."""

from pathlib import Path
from typing import Literal

from pydantic import BaseModel, ConfigDict, ValidationError

from tissue_contact.errors import InputError
from tissue_contact.files import publish

FORMAT = 1  # of the file; raised when a reader of the last one would read it wrongly

Verdict = Literal["identified", "weak", "at bound", "not identifiable", "given"]


class _Part(BaseModel):
    # A constant that cannot be identified has no number: null in the file.
    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


class Estimate(_Part):
    """A constant with its confidence interval, in ``unit``."""

    name: str
    unit: str
    value: float | None
    standard_error: float | None = None
    low: float | None = None
    high: float | None = None
    verdict: Verdict
    reason: str = ""


class Fitted(_Part):
    """One fit: all probes together, those of a region, or one."""

    scope: Literal["pooled", "region", "probe"]
    label: str
    law: str  # or "scene" for a fit of a whole model
    estimates: tuple[Estimate, ...]
    correlation: tuple[tuple[float, ...], ...]  # of the fitted constants with a number, in their order
    samples: int
    rmse: float  # [N]
    r2: float | None
    aic: float
    autocorrelation: float  # of neighbouring residuals
    evaluations: int
    converged: bool
    message: str


class HeldOut(_Part):
    """Error on what a fit had not seen."""

    law: str
    what: str  # is left out: probes, or stretches of one recording
    folds: int
    rmse: float  # [N]
    r2: float | None


class Result(_Part):
    """Everything that is reported of an identification."""

    format: int = FORMAT
    data: tuple[str, ...]  # files
    probes: int
    samples: int
    excluded: tuple[str, ...]  # rows and probes that were left out, with their reasons
    notes: tuple[str, ...]  # what was done to the data, and what to mind
    fits: tuple[Fitted, ...]
    held_out: tuple[HeldOut, ...] = ()
    chosen: str  # the law with the least error on what was held out
    parameters: dict[str, float]  # of the FMU, by the names of its variables

    def pooled(self, law: str) -> Fitted:
        """The fit of all probes together."""
        return next(f for f in self.fits if f.law == law and f.scope == "pooled")


def write_result(result: Result, path: Path) -> None:
    """Write a result as JSON, whole or not at all."""
    publish(path, (result.model_dump_json(indent=1) + "\n").encode())


def read_result(path: Path) -> Result:
    """Result of a file that `write_result` made; InputError when it is none."""
    rule, way_out = "the file must be a result of tissue-contact fit", "Give the result.json of a fit"
    try:
        result = Result.model_validate_json(path.read_bytes())
    except FileNotFoundError as error:
        raise InputError(str(path), "the file must exist", "no such file", way_out) from error
    except (ValidationError, UnicodeDecodeError) as error:
        raise InputError(str(path), rule, str(error).splitlines()[0], way_out) from error
    if result.format != FORMAT:
        raise InputError(str(path), f"the format of a result must be {FORMAT}", result.format, "Run the fit again")
    return result
