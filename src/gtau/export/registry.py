"""Registry of export kinds: a new one is a function of a module and a line in both tables."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from difflib import get_close_matches
from importlib import import_module
from pathlib import Path

from gtau.documents.validation import PATH, TEXT, WHOLE, takes
from gtau.errors import GtauError
from gtau.estimation.results.payload import PayloadBody
from gtau.estimation.results.result import Result
from gtau.export.exported import Exported, written
from gtau.robots.floating import refuse_floating

KINDS = {
    "c": "C99 source of torques, currents, gravity, friction, inertia and regressor, with a controller",
    "mjcf": "MuJoCo model whose ctrl is the motors' current",
    "mujoco-actuators": "actuators for MuJoCo in a file that the model of the bodies includes",
    "mjlab": "actuators for mjlab as YAML, and the bodies as MJCF",
    "isaaclab": "actuators for Isaac Lab as YAML, and the bodies as URDF",
    "urdf": "URDF with inertias and friction, loops and drives in YAML files beside it",
    "yaml": "gains, friction and base parameters with intervals and regroupings, for a controller",
    "csv": "the same as one table",
    "latex": "tables of geometry, gains and essential parameters for a paper",
    "orders": "parameters of each body in the orders of Pinocchio, MuJoCo, Drake, MATLAB and SYMORO",
    "matlab": "function files for MATLAB and GNU Octave",
    "fmu": "co-simulation FMU 3 with torques and currents for positions, velocities and accelerations",
}

EXPORTERS = {
    "c": "c.export",
    "mjcf": "mjcf.export",
    "mujoco-actuators": "actuators.export_mujoco",
    "mjlab": "actuators.export_mjlab",
    "isaaclab": "actuators.export_isaaclab",
    "urdf": "urdf.export",
    "yaml": "tables.export_yaml",
    "csv": "tables.export_csv",
    "latex": "tables.export_latex",
    "orders": "parameter_orders.export",
    "matlab": "matlab.export",
    "fmu": "fmu.export",
}
"""Module and function of each kind, imported where it is asked for."""

OF_FLOATING = ("yaml", "csv")
"""Kinds that hold parameters alone, whether the base floats or not."""

PAYLOAD_KINDS = {
    "ur": "URScript line, set_target_payload",
    "franka": "JSON of an end effector, and of setLoad",
    "kuka": "KRL record, LOAD_DATA",
    "abb": "RAPID module with a loaddata",
    "ros": "geometry_msgs/Inertia as YAML",
}
"""Kinds of files for a weighed payload."""

SAMPLED = ("mjcf", "urdf", "mujoco-actuators", "mjlab", "isaaclab")
"""Kinds that simulate, of which draws can be made."""

MODELS = 16
"""Draws that are written as models where nobody says how many."""

INTO = {"urdf": "urdf.export_into", "mjcf": "mjcf_into.export"}
"""Kinds that can be put back into the robot's own file, with module and function."""


@takes(
    model=("a result or the path of its file", (Result, str, Path)),
    kind=TEXT,
    out=PATH,
    into=PATH,
    samples=WHOLE,
    models=WHOLE,
    seed=WHOLE,
)
def export_model(
    model: Result | str | Path,
    kind: str,
    out: str | Path,
    into: str | Path | None = None,
    samples: int = 0,
    models: int = MODELS,
    seed: int = 0,
) -> Exported:
    """Export an identified model for a controller, simulator or paper.

    Parameters
    ----------
    model : Result or path
        A result, or its ``model.json``.
    kind : str
        One of ``gtau.export.registry.KINDS``.
    out : path
        Folder of the files.
    into : path, optional
        For the kinds ``urdf`` and ``mjcf``: the robot's own file, of which a copy with the identified parameters
        and everything else as it was is written.
    samples : int
        Number of models to draw as well, see :func:`gtau.export.samples.draw`: ``samples.npz``, and
        for the kinds that simulate the first ``models`` of them, each in a folder of its own (``samples/0000``).
    models, seed : int
        Number of draws written as models, and the seed of the draws.

    Returns
    -------
    Exported
        Files written, and notes on what the target cannot express.

    Raises
    ------
    GtauError
        Where the model lacks what the kind needs, or the files cannot be written.
    """
    refuse_unknown(kind, KINDS)
    result = model if isinstance(model, Result) else Result.load(model)
    if kind not in OF_FLOATING:
        refuse_floating(result.robot, f"export to '{kind}' is")
    if into is not None and kind not in INTO:
        raise GtauError(f"--into puts a model back into a URDF or MJCF file, not into '{kind}'; leave it out.")
    if samples and kind not in SAMPLED:
        raise GtauError(
            f"draws are models for simulators ({', '.join(SAMPLED)}), not for '{kind}'; leave out --samples."
        )

    def one(each: Result, folder: Path) -> Exported:
        module, function = (EXPORTERS if into is None else INTO)[kind].split(".")
        export: Callable[..., Exported] = getattr(import_module(f"gtau.export.{module}"), function)
        return export(each, folder) if into is None else export(each, Path(into), folder)

    exported = one(result, Path(out))
    if not samples:
        return exported
    drawn = import_module("gtau.export.samples").draw(result, samples, seed)
    files = [*exported.files, *written(Path(out), {"samples.npz": drawn.npz()})]
    for k, each in zip(range(models), drawn.results(), strict=False):
        files += one(each, Path(out) / "samples" / f"{k:04d}").files
    figures = {**exported.figures, "moved_share": drawn.moved_share}
    return Exported(tuple(files), (*exported.notes, drawn.note), figures, exported.lost)


@takes(payload=("what PayloadEstimate.in_frame returns", (PayloadBody,)), kind=TEXT, out=PATH)
def export_payload(payload: PayloadBody, kind: str, out: str | Path) -> Exported:
    """Export a weighed payload for a controller.

    Parameters
    ----------
    payload : PayloadBody
        From :meth:`gtau.PayloadEstimate.in_frame`, in the frame that the controller expects.
    kind : str
        One of ``gtau.export.registry.PAYLOAD_KINDS``.
    out : path
        Folder of the files.

    Returns
    -------
    Exported
        Files written, and notes on the frame and on parameters not identifiable from the motion.

    Raises
    ------
    GtauError
        Where the mass is not identifiable, the frame was not named, or the files cannot be written.
    """
    refuse_unknown(kind, PAYLOAD_KINDS)
    return import_module("gtau.export.payload").write_payload(payload, kind, Path(out))


def refuse_unknown(kind: str, kinds: Mapping[str, str]) -> None:
    """Refuse a ``kind`` that is not among ``kinds``."""
    if kind not in kinds:
        close = get_close_matches(kind, kinds, n=1)
        hint = f"did you mean '{close[0]}'?" if close else f"choose from {', '.join(kinds)}."
        raise GtauError(f"there is no export to '{kind}'; {hint}")
