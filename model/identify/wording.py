"""Results in words and numbers, the same on the page and in the terminal."""

import re
from collections import Counter
from collections.abc import Sequence

from tissue_contact.identify.result import Estimate, Fitted, Result

DIGITS = 3
MOST_DIGITS = 6  # of a value that is known better
CORRELATED = 0.3  # neighbouring residuals: above it the intervals are told as too narrow
ALIKE = 0.005  # relative difference of errors below which laws are told as equally good
RAISED = str.maketrans("0123456789-", "⁰¹²³⁴⁵⁶⁷⁸⁹⁻")


def number(value: float, digits: int = DIGITS) -> str:
    """A number to so many digits, with a power of ten where it is far from 1."""
    power = _power(value, digits)
    if not -4 <= power < 6:
        mantissa = f"{value:.{digits - 1}e}".partition("e")[0].replace("-", "−")
        return f"{mantissa} × 10{str(power).translate(RAISED)}"
    places = digits - 1 - power
    return f"{round(value, places):,.{max(places, 0)}f}".replace("-", "−")


def _power(value: float, digits: int) -> int:
    """Of ten, once the value is rounded."""
    return int(f"{value:.{digits - 1}e}".partition("e")[2]) if value else 0


def unit(text: str) -> str:
    """A unit of the scene as one reads it."""
    if text == "1":
        return ""
    return re.sub(r"(?<=[a-z])\d", lambda digit: digit[0].translate(RAISED), text).replace(".", "·")


def measure(e: Estimate) -> str:
    """Value ± standard error, to the second digit of the error; that there is none."""
    if e.value is None:
        return "not identifiable"
    if e.standard_error is None:
        return number(e.value)
    power = _power(e.value, DIGITS)
    scale = 1.0 if -4 <= power < 6 else 10.0**power
    text = f"{number(e.value / scale, _digits(e))} ± {number(e.standard_error / scale, 2)}"
    return text if scale == 1.0 else f"({text}) × 10{str(power).translate(RAISED)}"


def interval(e: Estimate) -> str:
    """Confidence interval, to the digits of the value."""
    if e.value is None or e.low is None or e.high is None:
        return "–"
    return f"{number(e.low, _digits(e))} to {number(e.high, _digits(e))}"


def _digits(e: Estimate) -> int:
    if not e.value or not e.standard_error:
        return DIGITS
    wanted = _power(e.value, DIGITS) - _power(e.standard_error, 2) + 2
    return min(max(wanted, DIGITS), MOST_DIGITS)


def judged(e: Estimate) -> str:
    """Verdict with its reason; of what has no number the reason alone."""
    parts = [e.verdict if e.value is not None else "", e.reason]
    return ": ".join(p for p in parts if p)


def exponent_note(result: Result) -> str:
    """What to mind of a stiffness where there is an exponent."""
    if not any(e.name.endswith("exponent") for e in result.pooled(result.chosen).estimates):
        return ""
    return (
        "With an exponent n the force goes with stiffness · depth · (depth / 1 m)ⁿ⁻¹: stiffness is that at 1 m, "
        "far beyond the data, and stiffnesses with different exponents cannot be compared."
    )


def amount(count: int, what: str) -> str:
    """So many of something."""
    return f"{count:,} {what if count == 1 else what + 's'}"


def laws(result: Result) -> list[str]:
    """The laws that were fitted, the chosen one first."""
    others = [f.law for f in result.fits if f.scope == "pooled" and f.law != result.chosen]
    return [result.chosen, *dict.fromkeys(others)]


def comparison(result: Result) -> list[str]:
    """The chosen law against each other one, a sentence each."""
    chosen, *others = laws(result)
    unseen = {h.law: h for h in result.held_out}
    sentences = []
    for other in others:
        own, its = result.pooled(chosen), result.pooled(other)
        if chosen in unseen and other in unseen:
            errors, where = (unseen[chosen].rmse, unseen[other].rmse), f"on held-out {unseen[chosen].what}"
        else:
            errors, where = (own.rmse, its.rmse), "on the data it was fitted to; none were held out"
        gain = 1.0 - errors[0] / errors[1] if errors[1] > 0.0 else 0.0
        if abs(gain) < ALIKE:
            how = f"errs as much as {other}"
        elif gain > 0.0:
            how = f"errs {gain:.0%} less than {other}".replace("%", " %")
        else:
            how = f"errs {-gain:.0%} more than {other}".replace("%", " %")
        aic = own.aic - its.aic
        astray = ", which speaks for the other" if gain * aic > 0.0 else ""
        sentences.append(
            f"{chosen} {how} {where}: {number(errors[0])} N against {number(errors[1])} N. "
            f"Its AIC is {number(abs(aic))} {'lower' if aic <= 0.0 else 'higher'}{astray}."
        )
    return sentences


def cautions(result: Result) -> list[str]:
    """What makes the constants less certain than their numbers look."""
    pooled = result.pooled(result.chosen)
    found = []
    if pooled.autocorrelation > CORRELATED:
        found.append(
            f"The intervals are too narrow: neighbouring residuals have a correlation of {pooled.autocorrelation:.2f}, "
            "while the theory of the intervals takes them as independent."
        )
    found += [
        f"The fit of {law} to all data did not converge: {result.pooled(law).message}"
        for law in laws(result)
        if not result.pooled(law).converged
    ]
    found += [f"{e.name} is at its bound: {e.reason}" for e in pooled.estimates if e.verdict == "at bound"]
    for scope in ("region", "probe"):
        fits = scoped(result, scope, result.chosen)
        astray = sum(not f.converged for f in fits)
        bound = sum(any(e.verdict == "at bound" for e in f.estimates) for f in fits)
        if astray:
            found.append(f"{astray} of {amount(len(fits), 'fit')} to a single {scope} did not converge.")
        if bound:
            found.append(f"{bound} of {amount(len(fits), 'fit')} to a single {scope} have a constant at its bound.")
    return found


def scoped(result: Result, scope: str, law: str) -> list[Fitted]:
    """The fits of a law to each region or probe."""
    return [f for f in result.fits if f.scope == scope and f.law == law]


def verdicts(estimates: Sequence[Estimate]) -> str:
    """How often each verdict came."""
    return ", ".join(f"{word} {count}" for word, count in Counter(e.verdict for e in estimates).most_common())
