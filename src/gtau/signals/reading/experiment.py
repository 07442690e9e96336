"""The experiment file: robot, columns of the logs, runs with their logs, and payloads."""

from __future__ import annotations

from collections.abc import Mapping
from glob import escape, has_magic
from pathlib import Path
from typing import Annotated, Any

from pydantic import (
    AfterValidator,
    BeforeValidator,
    ConfigDict,
    Field,
    PrivateAttr,
    ValidationInfo,
    field_validator,
    model_validator,
)

from gtau.documents.files import EXPERIMENT, NO_FILE, beside, matching, refuse_other_kind
from gtau.documents.markup import read_yaml
from gtau.documents.validation import PATH, Keys, Positive, takes, validate
from gtau.errors import GtauError, meant
from gtau.findings import Finding
from gtau.robots.parameter import Parameter
from gtau.robots.readers.source import AnySource, RobotSource
from gtau.robots.robot import Robot
from gtau.signals.channel import LINK_SIDE, SIDE_SIGNALS
from gtau.signals.reading import statements
from gtau.signals.reading.columns import Signals
from gtau.signals.reading.logs import is_log_folder
from gtau.signals.reading.samples import Part
from gtau.signals.reading.units import Units, is_angle


def file_or_name(robot: str, folder: Path) -> str:
    """Return the path of a robot file beside an experiment file in ``folder``, or a name of the catalog."""
    file = beside(folder, robot)
    if file.is_file() or (file / "robot.urdf").is_file():
        return str(file)
    if file.suffix or "/" in robot or (file.exists() and not file.is_dir()):
        raise ValueError(_no_file(file))
    return robot


RobotName = Annotated[
    str, AfterValidator(lambda robot, info: robot if info.context is None else file_or_name(robot, info.context))
]
"""Name of the catalog or path of a file, in a file whose folder is the context of its validation."""


class LoggedRun(Part):
    """One run: its log, or two logs with positions and commands, and the payload carried, if any.

    In a file the logs may be patterns (``free_*.csv``): a run for each match, of two patterns the first match of one
    with the first of the other. A folder of ``.parquet`` files is one log, and so is a rosbag2.
    """

    model_config = ConfigDict(populate_by_name=False)

    log: Annotated[
        tuple[Path, ...],
        BeforeValidator(lambda value: (value,) if isinstance(value, (str, Path)) else value),
        Field(min_length=1, max_length=2),
    ]
    payload: statements.CarriedPayload = None

    def overlaps(self, other: LoggedRun) -> bool:
        """Decide whether both runs share rows."""
        episodes = {self.episode, other.episode} - {None}
        return self.log == other.log and len(episodes) < 2 and self.begin < other.end and other.begin < self.end

    @field_validator("log")
    @classmethod
    def _existing(cls, log: tuple[Path, ...], info: ValidationInfo) -> tuple[Path, ...]:
        if info.context is None:
            return log
        _, folder = info.context
        paths, literal = [beside(folder, path) for path in log], Path(escape(str(folder)))
        pairs = zip(log, paths, strict=True)
        placed = tuple(path if path.exists() else beside(literal, written) for written, path in pairs)
        matches = [_logs_at(path) for path in placed]
        for written, path, logs in zip(log, paths, matches, strict=True):
            if not logs and has_magic(str(written)):
                raise ValueError(f"no file matches '{path}'; paths are relative to the experiment file")
            for existing in logs or [path]:
                if not (existing.is_file() or is_log_folder(existing)):
                    raise ValueError(_no_file(existing, "holds no .parquet files and is not a rosbag2"))
        if len({len(logs) for logs in matches}) > 1:
            raise ValueError(
                f"'{log[0]}' matches {len(matches[0])} files and '{log[1]}' {len(matches[1])}; they are paired in "
                f"order, so both must match the same number"
            )
        return placed


def _logs_at(path: Path) -> list[Path]:
    """List the files that a path or a pattern matches; patterns skip YAML files such as the experiment file."""
    return [match for match in matching(path) if match == path or match.suffix not in (".yaml", ".yml")]


def _no_file(path: Path, folder: str = "is a folder, not a file") -> str:
    """Say what is at a path in place of a file, such as a ``folder`` that is none, or which file was meant."""
    if path.is_symlink():
        return f"'{path}' is a link to '{path.readlink()}', which does not exist; correct the link or the path"
    if path.exists():
        return f"'{path}' {folder if path.is_dir() else NO_FILE}; give the path of a file"
    names = [file.name for file in path.parent.iterdir()] if path.parent.is_dir() else []
    return f"there is no file '{path}'; {meant(path.name, names, 'paths are relative to the file that names them')}"


class Recording(Keys):
    """How a recorder writes logs: their columns and units, as in an experiment file."""

    signals: Signals
    units: Units = Units()


class Experiment(Keys):
    """An experiment file; once read, its paths are absolute or relative to the working directory.

    ``robot`` is a file, a name of the catalog, or a group that also says how its base stands and which joints move.
    ``priors`` are given by standard parameter, ``drives`` (data sheets of motors and gears) by joint;
    ``prior_inertias`` is the relative standard deviation of the inertias in the robot's file as priors;
    ``preparation`` holds settings made by hand, ``require`` limits on the result, and ``tolerances`` the changes that
    are accepted of a watched robot.
    """

    robot: AnySource
    signals: Signals
    units: Units = Units()
    prior_gains: dict[str, statements.GainEntry] = Field(default_factory=dict)
    priors: dict[str, statements.Prior] = Field(default_factory=dict)
    prior_inertias: Positive | None = None
    drives: dict[str, statements.Drive] = Field(default_factory=dict)
    preparation: statements.PreparationSettings = statements.CHOSEN
    require: statements.Requirements = statements.Requirements()
    tolerances: statements.Tolerances = statements.Tolerances()
    runs: tuple[LoggedRun, ...] = Field(min_length=1)
    validation: tuple[LoggedRun, ...] = ()
    _guesses: tuple[Finding, ...] = PrivateAttr(())

    def __repr__(self) -> str:
        joints = ", ".join(self.signals.joints)
        runs = f"runs: {len(self.runs)}, validation: {len(self.validation)}"
        return f"Experiment({self.robot_file!r}, joints {joints}, {runs})"

    @property
    def robot_file(self) -> str:
        """File or catalog name of the robot."""
        return self.robot if isinstance(self.robot, str) else self.robot.file

    @field_validator("robot")
    @classmethod
    def _file_or_name(cls, robot: str | RobotSource, info: ValidationInfo) -> str | RobotSource:
        if info.context is None:
            return robot
        folder, _ = info.context
        if isinstance(robot, RobotSource):
            packages = tuple(str(beside(folder, package)) for package in robot.packages)
            return robot.model_copy(update={"file": file_or_name(robot.file, folder), "packages": packages})
        return file_or_name(robot, folder)

    @field_validator("units")
    @classmethod
    def _units_of_signals(cls, units: Units, info: ValidationInfo) -> Units:
        signals: Signals | None = info.data.get("signals")
        if signals is None:
            return units
        held: dict[str, Any] = {kind.calibration: signals.sensors(kind) for kind in LINK_SIDE}
        held |= {"current": signals.current, "torque": signals.torque or signals.motor_torque}
        held |= {"time": signals.time_columns, "pose": signals.pose, "wrenches": signals.all_wrenches}
        held |= {signal.key: signals.side_columns(signal) for signal in SIDE_SIGNALS}
        for key, columns in held.items():
            if key in units.model_fields_set and getattr(units, key) is not None and not columns:
                raise ValueError(f"a unit of '{key}' is given, but the signals hold no {key}; remove it")
        for by_joint in vars(units).values():
            if isinstance(by_joint, dict):
                _refuse_unknown_joints(by_joint, signals)
        return units

    @field_validator("prior_gains", "drives")
    @classmethod
    def _joints_of_signals(cls, entries: dict[str, Any], info: ValidationInfo) -> dict[str, Any]:
        if "signals" in info.data:
            _refuse_unknown_joints(entries, info.data["signals"])
        return entries

    @field_validator("prior_gains")
    @classmethod
    def _nonzero(cls, gains: dict[str, statements.StatedGain]) -> dict[str, statements.StatedGain]:
        if zero := [joint for joint, gain in gains.items() if gain.value == 0]:
            raise ValueError(f"the gain of joint '{zero[0]}' is zero; write the N m/A (or N per A) of its drive")
        return gains

    @field_validator("drives")
    @classmethod
    def _stated_once(cls, drives: dict[str, statements.Drive], info: ValidationInfo) -> dict[str, statements.Drive]:
        kind = info.data["signals"].kind if "signals" in info.data else ""
        for joint, drive in drives.items():
            if drive.gain is not None and kind == "torque":
                raise ValueError(
                    "the signals hold torques, which need no torque constant; remove the 'torque_constant' of "
                    f"'{joint}'"
                )
            if drive.gain is not None and joint in info.data.get("prior_gains", {}):
                raise ValueError(f"joint '{joint}' has a 'prior_gains' too; remove it, or its 'torque_constant' here")
            if drive.inertia is not None and Parameter("ia", joint) in info.data.get("priors", {}):
                raise ValueError(f"'priors' has 'ia_{joint}' too; remove it, or the 'rotor_inertia' of '{joint}' here")
        return drives

    @property
    def guesses(self) -> tuple[Finding, ...]:
        """What a draft from logs assumes, see :func:`gtau.draft`."""
        return self._guesses

    @property
    def stated_gains(self) -> dict[str, statements.StatedGain]:
        """Gains known beforehand, from ``prior_gains`` and data sheets."""
        gains = [(joint, drive.gain) for joint, drive in self.drives.items() if drive.gain is not None]
        return self.prior_gains | {joint: statements.StatedGain(value=gain, std=std) for joint, (gain, std) in gains}

    @property
    def expected_gains(self) -> dict[str, float]:
        """Values of these gains, N m/A or N per A, of torques 1."""
        return {joint: gain.value for joint, gain in self.stated_gains.items()}

    @property
    def expected_parameters(self) -> dict[str, statements.Prior]:
        """Priors of standard parameters: ``priors``, and rotor inertias of data sheets."""
        sheets = [(joint, drive.inertia) for joint, drive in self.drives.items() if drive.inertia is not None]
        rotors = {Parameter("ia", joint): statements.Prior(value=ia, std=std) for joint, (ia, std) in sheets}
        return self.priors | rotors

    @field_validator("runs", "validation")
    @classmethod
    def _each_log_once(cls, runs: tuple[LoggedRun, ...], info: ValidationInfo) -> tuple[LoggedRun, ...]:
        if info.context is not None:
            matches = ((run, logs) for run in runs for logs in zip(*map(_logs_at, run.log), strict=True))
            runs = tuple(run.model_copy(update={"log": logs}) for run, logs in matches)
        for k, run in enumerate(runs):
            if any(run.overlaps(earlier) for earlier in runs[:k]):
                raise ValueError(
                    f"the log '{run.log[0]}' is listed twice; remove one of them, or give parts (from, to) that do not "
                    "overlap"
                )
        return runs

    @model_validator(mode="after")
    def _runs_that_agree(self) -> Experiment:
        for run in self.validation:
            if any(run.overlaps(used) for used in self.runs):
                raise ValueError(
                    f"the log '{run.log[0]}' is listed under 'runs' and under 'validation'; remove one of them, as "
                    "a run used for identification validates nothing"
                )
        payloads: dict[str, statements.Payload] = {}
        for payload in (run.payload for run in (*self.runs, *self.validation)):
            if payload is not None and payloads.setdefault(payload.name, payload) != payload:
                raise ValueError(
                    f"the payload '{payload.name}' is described differently in two runs; "
                    "write the same known values in both, or give the second payload another name"
                )
        return self


def _refuse_unknown_joints(values: Mapping[str, object], signals: Signals) -> None:
    for joint in values:
        if joint not in signals.position:
            raise ValueError(
                f"the signals have no joint '{joint}', but {', '.join(signals.joints)}; add its columns under "
                "'signals' if it has a motor, or correct the name here"
            )


@takes(path=PATH)
def read_experiment(path: str | Path, logs: Path | None = None) -> Experiment:
    """Read an experiment file.

    Parameters
    ----------
    path : str or Path
        A YAML file; the paths in it are relative to its folder. ``robot`` remains a text: the path of a robot file if
        there is such a file, otherwise a name of the catalog.
    logs : Path, optional
        The folder to which the paths of the logs are relative, where it is another one.

    Returns
    -------
    Experiment
        All log files exist; none has been read.

    Raises
    ------
    GtauError
        The file cannot be read, or something in it is missing, misspelt or contradictory.

    Examples
    --------
    >>> gtau.read_experiment("experiment.yaml").signals.kind
    'current'
    """
    refuse_other_kind(path, EXPERIMENT)
    folder = Path(path).parent
    return validate(Experiment, read_yaml(path), context=(folder, logs or folder))


def check_robot(experiment: Experiment, robot: Robot) -> None:
    """Check that an experiment's signals, units and drives suit its robot; raises GtauError."""
    signals, base, pose = experiment.signals, experiment.signals.base, experiment.signals.pose
    if robot.floating and base is None:
        raise GtauError(
            f"the base '{robot.floating}' of robot '{robot.name}' floats, but 'signals' lack its motion; add "
            "'base' with the columns of its 'position' and 'quaternion', and of the 'wrenches' on it."
        )
    if base is not None and base.body != robot.floating:
        that = f"signals.base describes a floating base '{base.body}', but the base of robot '{robot.name}' is"
        if robot.floating:
            raise GtauError(f"{that} called '{robot.floating}'; write 'body: {robot.floating}' there.")
        raise GtauError(f"{that} fixed; write 'robot: {{file: ..., base: floating}}', or remove 'base'.")
    if pose is not None and robot.floating:
        raise GtauError(
            f"signals.pose is to test the geometry of robot '{robot.name}', whose base floats; remove it, or fix the "
            "base by 'base: fixed' beside the robot's 'file'."
        )
    if pose is not None and pose.body is not None and pose.body not in robot.bodies:
        raise GtauError(
            f"signals.pose names the body '{pose.body}', but the bodies of robot '{robot.name}' are "
            f"{', '.join(robot.bodies)}; correct the name."
        )
    for joint in signals.joints:
        if joint not in robot.actuated:
            raise GtauError(
                f"signals.position names the joint '{joint}', but the actuated joints of robot '{robot.name}' are "
                f"{', '.join(robot.actuated)}; correct the name."
            )
    for joint in robot.motors:
        if joint not in signals.position:
            raise GtauError(
                f"signals.position lacks the actuated joint '{joint}' of robot '{robot.name}'; add its column."
            )
        kind, unit = robot.joint(joint).kind, experiment.units.position_unit(joint)
        if unit is not None and is_angle(unit) != (kind == "revolute"):
            raise GtauError(
                f"units.position is '{unit}' for joint '{joint}', which is {kind}; write "
                f"{'rad or deg' if kind == 'revolute' else 'm or mm'} (units may differ by joint: {{{joint}: ...}})."
            )
    statements.check_drives(experiment.drives, robot)
