"""What goes wrong on purpose: wrong input (exit code 2) and work that failed (exit code 1)."""


class TissueContactError(Exception):
    """Base of every error that is meant for the user to read."""


class InputError(TissueContactError):
    """The user's input breaks a rule.

    Parameters
    ----------
    place : str
        Where: file and key, file and line, or argument.
    rule : str
        What must hold there, as a sentence without a full stop.
    value : object
        What was found instead.
    way_out : str
        What to do about it, as a sentence without a full stop.
    """

    def __init__(self, place: str, rule: str, value: object, way_out: str) -> None:
        self.place, self.rule, self.value, self.way_out = place, rule, value, way_out
        super().__init__(f"{place}: {rule}; found {value}. {way_out}.")


class WorkError(TissueContactError):
    """The input is right, but the work on it failed (a build, a check, a simulation step)."""
