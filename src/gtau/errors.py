"""The error that users see, which is a built-in one too where scripts expect that."""


class GtauError(ValueError):
    """Error raised for input that gtau cannot use.

    The message is one sentence for a person: what is wrong, where (file, key, joint, time), and
    what to do about it. It begins with the ``source``, a file, where that is given.
    """

    def __init__(self, sentence: str, source: object = "") -> None:
        self.sentence, self.source = sentence, str(source)
        super().__init__(f"{source}: {sentence}" if self.source else sentence)

    __str__ = BaseException.__str__  # a KeyError shows its message in quotes


def quoted(value: object, longest: int = 60) -> str:
    """Quote a value of a file on one line: its printable characters, others as in Python, and at most ``longest``."""
    text = str(value)
    plain = "".join(c if c.isprintable() else repr(c)[1:-1] for c in text[: longest + 1])
    return f"'{plain}'" if len(plain) <= longest else f"'{plain[: longest - 3]}...'"


class UnknownName(GtauError, KeyError):
    """Error raised for a name (of a joint, a parameter) that is not among those there are."""


class NoFile(GtauError, FileNotFoundError):
    """Error raised for a file that does not exist."""

    __new__ = FileNotFoundError.__new__  # type: ignore[assignment]  # the layout's, which tblib (Dask) calls by name


def unreadable(sentence: str, error: OSError) -> GtauError:
    """Make the error for what the system refuses to read."""
    return (NoFile if isinstance(error, FileNotFoundError) else GtauError)(sentence)


def missing_extra(purpose: str, package: str, extra: str) -> GtauError:
    """Make the error for a ``package`` that is not installed, with the commands that install it as an ``extra``."""
    return GtauError(
        f"{purpose} needs the package {package}, which is not installed; install it with: {install_command(extra)}."
    )


def install_command(extra: str) -> str:
    """Name the command that installs an ``extra``, from the package index and in a clone."""
    return f"pip install 'gtau[{extra}]' (in a clone: pip install '.[{extra}]')"
