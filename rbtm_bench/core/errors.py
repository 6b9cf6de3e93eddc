"""One exception tree: whatever a user can cause or meet prints as one line.

``exit_code`` is what the command line answers with: 2 for a mistake in what the user gave
(settings or data), 1 for a run that failed.
"""


class RbtmBenchError(Exception):
    """Base of every error that is expected to reach a user."""

    exit_code = 1


LINE = 1000
"""Characters of an error's words that are told: they go into rows, tables and the pair store."""


def one_line(error: object, most: int = LINE) -> str:
    """The words of an error, or of anything, on one line of bounded length; "" if it has none.

    A plug-in's error may be unable to say what it is, or say more than memory holds.
    """
    try:
        text = str(error)
    except Exception as why:
        return f"(its words cannot be read: {type(why).__name__})"
    line = " ".join(text[: 2 * most].split())
    if len(text) <= 2 * most and len(line) <= most:
        return line
    return f"{line[:most]} ... ({len(text)} characters)"


class ConfigError(RbtmBenchError):
    """A setting is unknown, of the wrong type, out of range, or does not fit the data."""

    exit_code = 2


class DataError(RbtmBenchError):
    """A file is missing, empty, truncated or malformed."""

    exit_code = 2

    @classmethod
    def at(cls, path: object, line: int, field: str, expected: str) -> "DataError":
        """A one-line message that names file, line, field and what was expected."""
        return cls(f"{path}, line {line}, {field}: expected {expected}")


class BackendError(RbtmBenchError):
    """A registration could not be done: too few points, bad input, or the library raised."""


class RunError(RbtmBenchError):
    """A run could not be finished."""


class WriteError(RunError, OSError):
    """A file could not be written: made with an error number, its words and the file's path."""

    def __str__(self) -> str:
        return f"{self.filename}: cannot be written: {self.strerror}"
