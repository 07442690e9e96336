"""Rehearsal of a motion before a robot plays it: limits, contacts, and a run under control in the simulator."""

from __future__ import annotations

import tempfile
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from gtau.campaigns.folder import MOTION, WARM_UP, digest, scene, seal, write_json
from gtau.documents.files import folder_of, write_table
from gtau.errors import GtauError
from gtau.excitation.design import Design, check
from gtau.excitation.design_file import DesignFile
from gtau.excitation.forecast import Outlook, sampled_run
from gtau.excitation.prior import file_parameters, rough_parameters, with_drives
from gtau.findings import Progress
from gtau.model.home import load_robot
from gtau.model.inverse_dynamics import InverseDynamics
from gtau.report.design import trajectory_table
from gtau.robots.parameter import torque_unit
from gtau.robots.readers.mjcf_file import refuse_deadly
from gtau.signals.reading.logs import read_log
from gtau.signals.reading.statements import FIRST_MOMENTS
from gtau.simulation.simulate import simulate
from gtau.simulation.trajectories import log_column

NEAR = {True: 0.02, False: 0.002}  # rad and m, tolerance of the pose at the start
STRAY = {True: 0.03, False: 0.003}  # rad and m, smallest tolerance of tracking
PART = 0.05  # tolerance of tracking over the joint's range in the motion
EVERY = 0.01  # s between the poses checked for contacts: 1 cm at a tool speed of 1 m/s
CSV = "motion.csv"


@dataclass(frozen=True)
class Rehearsal:
    """Result of a rehearsal: largest usage of a limit (``used``), tool ``speed`` (m/s), and a run under control.

    ``errors`` and ``torques`` are the largest tracking errors, rad or m, and torques, N m or N, by joint. ``notes``
    say what was not rehearsed as usual.
    """

    used: float
    limit: str
    speed: float
    errors: Mapping[str, float]
    torques: Mapping[str, float]
    notes: tuple[str, ...]


def rehearse(design: Design, file: DesignFile, model: Path | None, progress: Progress) -> Rehearsal:
    """Check all limits along the motion, and play it in the simulator with the heaviest payload.

    The robot has the identified ``model``, or the inertias of the robot's file if there is no model or the model does
    not move (poorly determined parameters may be unphysical). Raises GtauError if a limit or the tracking tolerance is
    exceeded.
    """
    task, notes = design.task, list[str]()
    worst = max(check(task, design.x), key=lambda usage: usage.excess)
    if worst.excess > 1:
        raise GtauError(f"the motion exceeds a limit: the {worst.what} must be {worst.allowed}; widen it or redesign.")
    try:
        errors, torques = _under_control(design, file, model, progress)
    except GtauError:
        if model is None:
            raise
        errors, torques = _under_control(design, file, None, progress)
        notes.append("rehearsal: with the inertias of the robot's file, as the identified parameters do not move")
    outlook, allowed = Outlook(design, {}), tolerances(design)
    for joint, error in errors.items():
        if error > allowed[joint]:
            raise GtauError(
                f"in the rehearsal joint '{joint}' strays by {error:.3g} from the motion, {allowed[joint]:.3g} is "
                f"allowed; limit its acceleration or jerk in the design file."
            )
    time, joints = outlook.run
    if unseen := check_contacts(Path(file.robot), task.model, time, joints):
        notes.append(f"contacts in MuJoCo: not checked, {unseen}")
    robot = load_robot(file.robot)
    for joint, torque in torques.items():
        # of the file, as the design's share leaves a reserve for control
        most = robot.joint(joint).limits.effort
        if most is not None and torque > most:
            raise GtauError(
                f"in the rehearsal joint '{joint}' takes {torque:.3g} {torque_unit(robot, joint)}, "
                f"{most:.3g} is allowed; limit its acceleration in the design file."
            )
    return Rehearsal(worst.excess, worst.what, outlook.tool[0], errors, torques, tuple(notes))


def _under_control(
    design: Design, file: DesignFile, model: Path | None, progress: Progress
) -> tuple[dict[str, float], dict[str, float]]:
    """Play the motion in the simulator; return the largest tracking errors and torques by joint."""
    task = design.task
    loads = [payload for payload in task.payloads if payload is not None]
    heaviest = max(loads, key=lambda payload: payload.mass or 0.0, default=None)
    time, joints = sampled_run(task, design.x)
    with tempfile.TemporaryDirectory() as name:
        out = Path(name)
        write_table(trajectory_table(task, time, joints), out / CSV)
        run: dict[str, Any] = {"name": "loaded", "trajectory": {"csv": str(out / CSV)}}
        if heaviest is not None:
            moments = dict(zip(FIRST_MOMENTS, task.prior.moments(heaviest).tolist(), strict=True))
            run["payload"] = {"name": heaviest.name, "mass": heaviest.mass, "parameters": moments | heaviest.parameters}
        truth: dict[str, Any] = {"model": str(model)}
        if model is None:  # the robot's file without the margin where it states inertias
            rough, _ = rough_parameters(task.model, task.base, (heaviest and heaviest.mass) or 1.0)
            truth = {"parameters": with_drives(task.model, file_parameters(task.model, rough))}
        drives = {joint: {"gain": 1.0} for joint in task.model.actuated}
        rate = max(task.rate, 500.0)
        simulated = {"robot": file.robot, "rate": rate, "drives": drives, "runs": [run], **truth}
        try:
            simulate(simulated, out / "logs", lambda _, done, total: progress("rehearsing", done, total))
        except KeyboardInterrupt:
            raise KeyboardInterrupt from None  # its text names a folder that is removed
        columns = ("t", *(log_column(kind, joint) for kind in "qv" for joint in task.model.actuated))
        log = read_log(out / "logs" / "loaded.csv", columns).arrays()
    errors, torques = {}, {}
    for k, joint in enumerate(task.model.actuated):
        designed = np.interp(log["t"], time, joints[0, k])
        errors[joint] = float(np.abs(log[log_column("q", joint)] - designed).max())
        torques[joint] = float(np.abs(log[log_column("v", joint)]).max())
    return errors, torques


def tolerances(design: Design) -> dict[str, float]:
    """Tracking tolerances of all joints, rad or m."""
    _, joints = sampled_run(design.task, design.x)
    robot = design.task.model.robot
    return {
        name: max(PART * float(np.ptp(row)), STRAY[robot.joint(name).turns])
        for name, row in zip(robot.actuated, joints[0], strict=True)
    }


def write_motion(
    folder: Path, file: DesignFile, design: Design, rehearsal: Rehearsal, decided: Mapping[str, Any]
) -> None:
    """Write ``motion.csv``, then ``motion.json``, which completes the round; see docs/lookup/players.md.

    ``decided`` holds the ``purpose`` of the motion, the round ``after`` which it was designed, and ``warm_up``, whether
    a warm-up run comes first.
    """
    task, robot = design.task, design.task.model.robot
    time, joints = sampled_run(task, design.x)
    write_table(trajectory_table(task, time, joints), folder_of(folder) / CSV)
    allowed = tolerances(design)
    names = [*([WARM_UP] if decided["warm_up"] else []), *(f"run{k + 1}" for k in range(len(task.payloads)))]
    loads = (task.payloads[0], *task.payloads)[-len(names) :]
    described = [
        {
            "name": name,
            "unit": robot.joint(name).unit,
            "start": float(row[0]),
            "start_tolerance": NEAR[robot.joint(name).turns],
            "tracking_tolerance": allowed[name],
        }
        for name, row in zip(robot.actuated, joints[0], strict=True)
    ]
    runs = [
        {"name": name, "payload": None if load is None else {"name": load.name, "mass": load.mass}}
        for name, load in zip(names, loads, strict=True)
    ]
    motion = {
        "schema": "gtau-motion/1",
        "files": digest([folder / CSV, *scene(folder.parent, file)], folder),
        "robot": robot.name,
        "rate": task.rate,
        "duration": float(time[-1]),
        "joints": described,
        "runs": runs,
        "guards": [*task.guards, *rehearsal.notes],
        "series": {"period": task.series.period, "repetitions": task.repetitions, "x": design.x.tolist()},
        "rehearsal": asdict(rehearsal),
        **decided,
    }
    write_json(folder / MOTION, motion | {"hash": seal(motion)})


def check_contacts(file: Path, model: InverseDynamics, time: np.ndarray, joints: np.ndarray) -> str:
    """Check a motion (q, qd, qdd of the actuated joints, (3, n, N)) at ``time`` (N,) for contacts in MuJoCo.

    Shapes that overlap at the start are taken as drawn that way and ignored. Returns why contacts cannot be checked,
    empty if they can; raises GtauError if bodies touch.
    """
    try:
        import mujoco  # type: ignore[import-untyped, unused-ignore]
    except ImportError:
        return "MuJoCo is not installed"
    if file.suffix.lower() not in (".xml", ".urdf"):
        return "the robot's file holds no shapes"
    try:
        refuse_deadly(file)
        compiled = mujoco.MjModel.from_xml_path(str(file))
        places = [compiled.joint(joint.name).qposadr[0] for joint in model.robot.joints]
    except (ValueError, KeyError) as error:
        return f"MuJoCo cannot load the robot's file: {str(error).splitlines()[0].removeprefix('Error: ').rstrip('.')}"
    data, drawn = mujoco.MjData(compiled), None
    step = max(1, round(EVERY / (time[1] - time[0])))
    for t, c in zip(time[::step], model.motion(*joints[:3, :, ::step]).c.T, strict=True):
        data.qpos[places] = c[: len(places)]
        mujoco.mj_kinematics(compiled, data)
        mujoco.mj_comPos(compiled, data)
        mujoco.mj_collision(compiled, data)
        touching = {
            tuple(sorted(compiled.geom(geom).name or compiled.body(compiled.geom_bodyid[geom]).name for geom in pair))
            for pair in (contact.geom for contact in data.contact if contact.dist < 0)
        }
        drawn = touching if drawn is None else drawn
        if new := sorted(touching - drawn):
            first, second = new[0]
            raise GtauError(
                f"in the rehearsal '{first}' touches '{second}' at {t:.3g} s, as MuJoCo sees the robot's file; "
                "limit its joints or give its surroundings in the design file."
            )
    return ""
