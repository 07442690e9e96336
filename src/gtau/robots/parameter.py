"""Parameters of the model by kind, body and run, and the names that people read and write."""

from __future__ import annotations

from typing import NamedTuple


class Parameter(NamedTuple):
    """A parameter: its kind (``mx``, ``fs``, ``gain``), its body, joint or channel, and the run it differs in.

    ``run`` is the number of a run from 0 for the difference of a drifting parameter from its mean, None otherwise.
    """

    kind: str
    body: str
    run: int | None = None

    @property
    def name(self) -> str:
        """The printed name: ``mx_31``, or ``fs_left@2`` for the difference in the second run."""
        return f"{self.kind}_{self.body}" + ("" if self.run is None else f"@{self.run + 1}")


def parameter_of(name: str) -> Parameter:
    """Return the parameter of a printed name; of one without a body (``m`` of a payload) the body is empty.

    The body keeps the ``R`` of a regrouped base parameter, as the name alone does not show whether it belongs to it.
    """
    whole, _, run = name.partition("@")
    kind, _, body = whole.partition("_")
    return Parameter(kind, body, int(run) - 1 if run else None)
