"""Parameters of the model by kind, body and run, and the names that people read and write."""

from __future__ import annotations


class Parameter(str):
    """A parameter: its kind (``mx``, ``fs``, ``gain``), its body, joint or channel, and the run it differs in.

    Its text is the printed name: ``mx_31``, ``mx_31R`` of one that regroups others, or ``fs_left@2`` for the difference
    in the second run. ``run`` is the number of a run from 0 for the difference of a drifting parameter from its mean,
    None otherwise.
    """

    __slots__ = ("body", "kind", "regrouped", "run")
    kind: str
    body: str
    run: int | None
    regrouped: bool

    def __new__(cls, kind: str, body: str, run: int | None = None, regrouped: bool = False) -> Parameter:
        """Print the name, and keep what it is made of."""
        text = (
            (f"{kind}_{body}" if body else kind) + ("R" if regrouped else "") + ("" if run is None else f"@{run + 1}")
        )
        made = super().__new__(cls, text)
        made.kind, made.body, made.run, made.regrouped = kind, body, run, regrouped
        return made

    def __getnewargs__(self) -> tuple[str, str, int | None, bool]:  # type: ignore[override]
        """Return what copies and pickles are made from."""
        return self.kind, self.body, self.run, self.regrouped


def parameter_of(name: str, regrouped: bool = False) -> Parameter:
    """Return the parameter of a name in a file; of one without a body (``m`` of a payload) the body is empty.

    ``regrouped`` says whether the name is that of a base parameter that regroups others, and ends in ``R``: the name
    alone does not show it.
    """
    if isinstance(name, Parameter):
        return name
    label, _, run = name.partition("@")
    kind, _, body = (label.removesuffix("R") if regrouped else label).partition("_")
    return Parameter(kind, body, int(run) - 1 if run else None, regrouped)
