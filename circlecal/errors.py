"""Every error that circlecal raises on purpose. Imports nothing."""


class CirclecalError(Exception):
    """Root of the errors that a user can cause; its text is one clear line."""


class ConfigError(CirclecalError):
    """The configuration or a field template is wrong: names the file, the key and the mend."""


class InputError(CirclecalError):
    """An input or output file is unusable: names the file, what is wrong with it and the mend."""


class OutputError(InputError):
    """A file or folder cannot be written: the disk is full or read-only. It says nothing of what was to be written."""


class MissingExtraError(CirclecalError):
    """An optional package is not installed; the text says how to install it from an index or from a checkout.

    Parameters
    ----------
    package : str
        The package that could not be imported.
    extra : str
        The extra of circlecal that brings it.
    """

    def __init__(self, package: str, extra: str) -> None:
        super().__init__(
            f"{package} is not installed; pip install {package}, or pip install '.[{extra}]' in a checkout"
        )
        self.package = package
        self.extra = extra


class EstimationError(CirclecalError):
    """A stage cannot give an answer for this frame; the frame is refused, not the run.

    Parameters
    ----------
    stage : str
        The stage that gave up, e.g. ``"ellipse"``.
    code : str
        Machine-readable reason, e.g. ``"arc_too_short"``.
    reason : str
        Reason in words, for people.
    """

    def __init__(self, stage: str, code: str, reason: str) -> None:
        super().__init__(f"{stage}: {reason}")
        self.stage = stage
        self.code = code
        self.reason = reason


class InterruptedCommandError(Exception):
    """A command was ended by Ctrl-C or SIGTERM; its text, if any, says how to go on.

    Unlike KeyboardInterrupt it passes through typer.
    """


def reading_failure(error: Exception) -> str:
    """Why a file cannot be read, in words that do not name it again."""
    return getattr(error, "strerror", None) or str(error)


_PLAIN_WORDS = {
    "extra_forbidden": "is unknown",
    "missing": "is missing",
    "model_type": "should be a mapping",
    "model_attributes_type": "should be a mapping",
    "dict_type": "should be a mapping",
    "tuple_type": "should be a list",
    "list_type": "should be a list",
}
"""What users of YAML and JSON call it, by pydantic's type of a problem."""


def explain_problem(kind: str, message: str) -> str:
    """What is wrong with a value, in words that follow the name of its key.

    Parameters
    ----------
    kind, message : str
        ``type`` and ``msg`` of one of the errors of a pydantic ``ValidationError``.
    """
    if kind in ("too_short", "too_long"):
        return message.partition(" ")[2].replace(" after validation", "")
    return _PLAIN_WORDS.get(kind) or message.removeprefix("Value error, ").removeprefix("Input ")
