"""An experiment from logs alone, with a note on every guess."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Literal

from gtau.documents.validation import MAPPING, MASSES, NAMES, NUMBER, PATH, TEXT, expect, takes, validate
from gtau.documents.yaml_document import Document
from gtau.errors import GtauError
from gtau.signals.reading.discovery import Draft
from gtau.signals.reading.drafting import (
    alternatives,
    draft_as,
    draft_logs,
    draft_text,
    guesses,
    to_weigh,
    with_sensors,
)
from gtau.signals.reading.experiment import Experiment, Recording
from gtau.signals.reading.logs import find_columns

KINDS = ("position", "current", "torque", "time")
HERE = Path()
DRAFTED = Path("the draft")
ARGUMENTS = {
    r"--(position|current|torque|time)\b": r"gtau.draft(..., columns={'\1': ...})",
    r"--kind (\w+)": r"gtau.draft(..., kind='\1')",
    r"--payload (\S.*?)=([\d.]+|KG)": r"payload={'\1': \2}",
    r"--(\w+) ([A-Z]+)\b": r"\1='\2'",
    r"--(\w+)": r"\1=",
}  # by the options that sentences on drafts name


def drafted(
    logs: Sequence[Path],
    robot: str | None,
    payload: Mapping[str, float],
    kind: Literal["current", "torque"] | None = None,
    preset: str | None = None,
    columns: Mapping[str, str] | None = None,
    weigh: bool = False,
    recording: Recording | None = None,
    xacro: Mapping[str, str] | None = None,
) -> Draft:
    """Draft an experiment from logs, those without a stated ``payload`` without one, or with ``weigh`` an unknown one.

    Logs with the columns of a ``recording`` are read as it says. Raises GtauError where an answer is needed.
    """
    as_recorded = recording and robot and not (columns or preset) and kind in (None, recording.signals.kind)
    if recording and robot and as_recorded and _has_columns(logs[0], recording):
        draft = draft_as(recording, logs, robot, payload)
    else:
        draft = draft_logs(logs, robot, masses=payload, kind=kind, preset=preset, columns=columns, xacro=xacro)
    draft = to_weigh(draft) if weigh else with_sensors(draft)
    if "file" not in draft.robot:
        raise GtauError(
            f"{logs[0]} does not name its robot; give it by --robot ROBOT, a catalog name (gtau robot) or the path "
            "of a URDF, MJCF or robot file."
        )
    if "rate" in draft.open:
        raise GtauError(
            f"{logs[0]} has neither times nor velocities to find its sampling rate from; draft a file by 'gtau "
            "init', write the rate there (time: {rate: HZ}), and give that file."
        )
    for log, readings in draft.payloads.items():
        if len(readings) > 1:
            raise GtauError(
                f"the name of {log} may mean a payload of {alternatives(readings)} kg, which sets the scale of all "
                f"drive gains; state it by --payload {log.name}={readings[0]:g} (0 for none)."
            )
    return draft


def _has_columns(log: Path, recording: Recording) -> bool:
    signals = recording.signals
    return {*signals.time_columns, *signals.position.values(), *signals.measured} <= {*find_columns(log).columns}


@takes(logs=NAMES, robot=PATH, payload=MASSES, preset=TEXT, columns=MAPPING, kind=TEXT)
def draft(
    logs: Sequence[str | Path],
    robot: str | Path | None = None,
    payload: Mapping[str, float] | None = None,
    preset: str | None = None,
    columns: Mapping[str, str] | None = None,
    kind: str | None = None,
) -> Experiment:
    """Draft an experiment from logs, as ``gtau init`` does: find the columns of time, positions and currents.

    Parameters
    ----------
    logs : sequence of path
        One log per run, all of one layout.
    robot : path, optional
        A name of the catalog or the path of a robot's file.
    payload : mapping, optional
        Log to mass of the payload, kg, 0 for none: ``{"loaded.csv": 0.48}``; by default from names of the files such as
        ``loaded_0.48kg.csv``.
    preset : str, optional
        Recorder of the logs, such as ``"ur_rtde"``.
    columns : mapping, optional
        Columns or patterns by kind: ``{"position": "enc_J*", "current": "iq_J*", "time": "t"}``, for the joints in
        their order.
    kind : str, optional
        What command columns such as ``effort`` hold, ``"current"`` or ``"torque"``; by default judged by their names.

    Returns
    -------
    Experiment
        For :func:`gtau.identify`, :func:`gtau.check` and :func:`gtau.compare`; its ``guesses`` say what is assumed.

    Raises
    ------
    GtauError
        No columns are recognised, the robot is not known, or a guess would set the scale.

    Examples
    --------
    >>> gtau.draft(["empty_1.csv", "loaded_1200g.csv"], robot="five-bar")
    Experiment('five-bar', joints left, right, runs: 2, validation: 0)
    """
    if isinstance(logs, (str, Path)) or not logs or not all(isinstance(log, (str, Path)) for log in logs):
        raise GtauError("logs are a list of paths; give ['empty.csv', 'loaded.csv'].")
    if kind not in (None, "current", "torque"):
        raise GtauError(f"the kind of the commands is '{kind}'; write 'current' or 'torque'.")
    for log, mass in (payload or {}).items():
        expect(f"the payload of '{log}'", mass, NUMBER)
    for signal, pattern in (columns or {}).items():
        expect(f"the columns of '{signal}'", pattern, TEXT)
        if signal not in KINDS:
            raise GtauError(f"'columns' has the key '{signal}'; choose from {', '.join(KINDS)}.")
    paths = [Path(log) for log in logs]
    name = None if robot is None else str(robot)
    try:
        made = drafted(paths, name, payload or {}, kind, preset, columns)  # type: ignore[arg-type]
    except GtauError as error:
        raise type(error)(in_python(error.sentence), error.source) from None
    if made.urdf is not None:
        raise GtauError(f"{paths[0]} holds its robot, which is written beside a draft; run 'gtau init {paths[0]} ...'.")
    text = draft_text(made, HERE)
    experiment = validate(Experiment, Document(DRAFTED, text), context=(HERE, HERE))
    assumed = guesses(made, DRAFTED)
    experiment._guesses = tuple(replace(guess, advice=in_python(guess.advice)) for guess in assumed)
    return experiment


def in_python(sentence: str) -> str:
    """Write the options of the command line that a sentence names as arguments in Python."""
    for option, argument in ARGUMENTS.items():
        sentence = re.sub(option, argument, sentence)
    return sentence
