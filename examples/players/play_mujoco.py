"""Play a round's motion on a robot in MuJoCo that nobody identified.

    python play_mujoco.py camp/01 [--speed 0.1] [--robot camp/mujoco.yaml]

``mujoco.yaml`` names an MJCF file, whose joints have friction and armature of their own and the same names as in the
robot's file, and says what no log shows:

    model: arm.xml
    bandwidth: 60                       # rad/s, of the controller
    drives: {shoulder: {gain: 2.7, delay: 0.001, noise: 0.01, quantum: 1e-5}}   # N m/A, s, A, rad
    payloads: {payload: {body: wrist, mass: 2.0, center: [0.05, 0, 0.03]}}   # by name, as in design.yaml
    cold: {more: 0.3, fades: 60}        # friction at the round's start beyond that when warm, s of its time constant
    supply: {voltage: 24, resistance: 0.05}   # V, ohm by which it sags: logs then have duties and supply voltages

On a supply, drives have a ``resistance`` (ohm), and may have ``warming``, ``convention``, ``dead_time``,
``duty_quantum``, ``proportional_gain`` and ``dead_band``, as in simulation files.

At a reduced speed nothing is written: that is the dry run.
"""

from __future__ import annotations

import argparse
import sys
from os.path import normpath
from pathlib import Path

import mujoco
import numpy as np
import yaml
from contract import Motion, play_round, read_motion, write_log

STEP = 2.5e-4  # s
AHEAD = 1.0  # s that it holds the first position before it moves, and the last one after
HELD = 0.02  # s between two inertia matrices of the controller
ZERO = {"delay": 0.0, "noise": 0.0, "quantum": 0.0, "zero": 0.0, "saturation": 0.0, "unsigned": False}
MOTOR = {"warming": 0.0, "dead_time": 0.0, "duty_quantum": 0.0, "proportional_gain": np.nan, "dead_band": 0.0}
CONVENTIONS = {"dc": 1.0, "power": 1.0, "amplitude": 1.5}
SMALL = 4e-3  # of the stall current, below which a bridge loses less than its dead time


def described(file: Path, joints: list[str], payload: str | None) -> tuple[mujoco.MjSpec, dict]:
    """Read mujoco.yaml and its MJCF file; end the program where they lack a joint or the payload, or are wrong."""
    if not file.is_file():
        sys.exit(f"{file} describes the simulated robot and does not exist; write it (see --help), or give --robot.")
    try:
        truth = yaml.safe_load(file.read_text())
        spec = mujoco.MjSpec.from_file(str(file.parent / truth["model"]))
        drives = {
            str(name): ZERO | MOTOR | {key: CONVENTIONS.get(drive[key]) or float(drive[key]) for key in drive}
            for name, drive in truth["drives"].items()
        }
        lacking = [f"joint '{joint}' in the model" for joint in joints if spec.joint(joint) is None]
        lacking += [f"drive '{joint}'" for joint in joints if joint not in drives]
        needed = ("gain", "resistance") if "supply" in truth else ("gain",)
        lacking += [f"{key} of drive '{name}'" for name, drive in drives.items() for key in needed if key not in drive]
        if payload is not None and payload not in (loads := truth.get("payloads", {})):
            lacking.append(f"payload '{payload}'")
        elif payload is not None and spec.body(loads[payload]["body"]) is None:
            lacking.append(f"body '{loads[payload]['body']}' in the model")
    except (AttributeError, KeyError, TypeError, ValueError, yaml.YAMLError) as error:
        sys.exit(f"{file} is not as this player's --help describes it: {' '.join(str(error).split())}")
    if lacking:
        sys.exit(f"{file} lacks: {', '.join(lacking)}.")
    return spec, truth | {"drives": drives}


class Machine:
    """A robot with one payload, or none, under a PID controller with the robot's own inertia matrix."""

    def __init__(self, file: Path, joints: list[str], payload: str | None):
        spec, truth = described(file, joints, payload)
        if payload is not None:
            load = truth["payloads"][payload]
            size = load["mass"] * 0.05**2 * np.ones(3) * 0.4  # a ball
            spec.body(load["body"]).add_body(
                name=f"payload {payload}",
                pos=load["center"],
                ipos=[0.0, 0.0, 0.0],  # otherwise MuJoCo takes pos once more
                mass=load["mass"],
                inertia=size,
                explicitinertial=True,
            )
        self.model, self.drives = spec.compile(), [truth["drives"][name] for name in joints]
        self.model.opt.timestep = STEP
        self.supply = {"resistance": 0.0} | truth["supply"] if "supply" in truth else None
        self.bandwidth, self.at = truth.get("bandwidth", 60.0), truth.get("at", {})
        self.cold = {"more": 0.0, "fades": 1.0} | truth.get("cold", {})
        self.warm = self.model.dof_frictionloss.copy(), self.model.dof_damping.copy()
        self.data = mujoco.MjData(self.model)
        if self.model.nkey:  # a pose in which loops are closed
            mujoco.mj_resetDataKeyframe(self.model, self.data, 0)
        places = [self.model.joint(name) for name in joints]
        self.q, self.v = (np.array([getattr(joint, key)[0] for joint in places]) for key in ("qposadr", "dofadr"))
        self.free = spec.compile()  # without friction and ends of travel, for the controller
        self.free.dof_frictionloss[:] = 0.0
        self.free.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_LIMIT | mujoco.mjtDisableBit.mjDSBL_CONTACT
        self.trial = mujoco.MjData(self.free)

    def column(self, key: str) -> np.ndarray:
        """Return a number of every drive (n,)."""
        return np.array([drive.get(key, 1.0) for drive in self.drives], dtype=float)

    def electrical(
        self, wanted: np.ndarray, error: np.ndarray, voltage: float, done: float
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return currents and duties (n,) at a supply ``voltage``: of servos, and of drives as far as it allows."""
        gain, dead_time, warming, K = map(self.column, ("gain", "dead_time", "warming", "proportional_gain"))
        resistance = self.column("resistance") * (1 + warming * (1 - np.exp(-2 * done)))
        emf, lost = gain / self.column("convention") * self.data.qvel[self.v], dead_time * voltage
        push = np.sign(error) * np.maximum(np.abs(error) - self.column("dead_band"), 0.0)
        duty = np.clip(K * push, -1.0, 1.0)
        free = duty * voltage - emf
        servo = np.sign(free) * np.maximum(np.abs(free) - lost, 0.0) / resistance
        held = np.clip(wanted, (lost - voltage - emf) / resistance, (voltage - lost - emf) / resistance)
        current = np.where(np.isfinite(K), servo, held)
        bridge = lost * np.clip(current * resistance / (SMALL * voltage), -1.0, 1.0)
        return current, np.where(np.isfinite(K), duty, (resistance * current + emf + bridge) / voltage)

    def inertia(self) -> np.ndarray:
        """Inertia matrix (n, n) of the motors, loops included: the inverse of what unit torques accelerate."""
        pushed = []
        for push in (None, *range(len(self.v))):
            self.trial.qpos, self.trial.qvel = self.data.qpos, 0.0
            self.trial.qfrc_applied = 0.0
            if push is not None:
                self.trial.qfrc_applied[self.v[push]] = 1.0
            mujoco.mj_forward(self.free, self.trial)
            pushed.append(self.trial.qacc[self.v].copy())
        return np.linalg.inv(np.array(pushed[1:]) - pushed[0])

    def play(
        self, motion: Motion, rng: np.random.Generator, moved: float
    ) -> tuple[tuple[np.ndarray, np.ndarray, np.ndarray], dict[str, np.ndarray], str]:
        """Follow the motion, having ``moved`` for some s; return time, positions and currents as logged, and the end.

        With a supply, duties and supply voltages are beside them.
        """
        gain, zero, quantum, bend = map(self.column, ("gain", "zero", "quantum", "saturation"))
        if not self.model.neq:
            self.data.qpos[self.q] = [self.at.get(joint["name"], joint["start"]) for joint in motion.file["joints"]]
        mujoco.mj_forward(self.model, self.data)
        motion.refuse_start(self.data.qpos[self.q] + zero)
        rate = motion.file["rate"]
        steps = max(1, round(1 / rate / STEP))
        self.model.opt.timestep = 1 / rate / steps
        kp, ki, kd = 3 * self.bandwidth**2, self.bandwidth**3, 3 * self.bandwidth
        integral, inertia, rows, end = np.zeros(len(gain)), np.eye(len(gain)), [], "completed"
        late = np.round(self.column("delay") * rate * steps).astype(int)
        past = [self.data.qpos[self.q].copy()] * (late.max() + 1)
        voltage, duty = self.supply["voltage"] if self.supply else np.nan, np.zeros(len(gain))
        for k in range(round((motion.time[-1] + AHEAD) * rate) + 1):
            q, qd, qdd = motion.at(k / rate - AHEAD)
            here = self.data.qpos[self.q] + zero
            if k % max(1, round(HELD * rate)) == 0:
                inertia = self.inertia()
            if end := motion.strayed(here, q):
                break
            e, ed = q - here, qd - self.data.qvel[self.v]
            integral += ki * e / rate
            current = inertia @ (qdd + kp * e + kd * ed + integral) / gain
            seen = np.array([past[d][j] for j, d in enumerate(late)]) + zero
            volts, wanted, done = np.full(len(gain), voltage), current, k / rate / (motion.time[-1] + AHEAD)
            if self.supply:
                current, duty = self.electrical(wanted, e, voltage, done)
            rows.append((k / rate, seen, current, duty, volts))
            cold = 1 + self.cold["more"] * np.exp(-(moved + k / rate) / self.cold["fades"])
            self.model.dof_frictionloss[:], self.model.dof_damping[:] = (cold * friction for friction in self.warm)
            for _ in range(steps):
                if self.supply:  # back-EMF acts within a sample, too
                    current, _ = self.electrical(wanted, e, volts[0], done)
                self.data.qfrc_applied[self.v] = gain * current * (1 - bend * np.abs(current))
                mujoco.mj_step(self.model, self.data)
                past = [self.data.qpos[self.q].copy(), *past[:-1]]
            if self.supply:
                voltage = self.supply["voltage"] - self.supply["resistance"] * float(np.sum(rows[-1][2] * duty))
        time, seen, current, duty, volts = (np.array(column) for column in zip(*rows, strict=True))
        logged = current + self.column("noise") * rng.standard_normal(current.shape)
        logged = np.where(self.column("unsigned") > 0, np.abs(logged), logged)
        beside = {"duty": rounded(duty, self.column("duty_quantum")), "supply_voltage": volts} if self.supply else {}
        return (time, rounded(seen, quantum), logged), beside, end or "completed"


def rounded(values: np.ndarray, quantum: np.ndarray) -> np.ndarray:
    """Round values to multiples of a quantum; a quantum of zero leaves them unchanged."""
    step = np.where(quantum > 0, quantum, 1.0)
    return np.where(quantum > 0, np.round(values / step) * step, values)


def main() -> None:
    """Play all runs of a round."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("round", type=Path)
    parser.add_argument("--speed", type=float, default=1.0)
    parser.add_argument("--robot", type=Path)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    file = options.robot or Path(normpath(options.round / ".." / "mujoco.yaml"))
    motion = read_motion(options.round)
    for run in motion.file["runs"]:
        described(file, motion.joints, (run["payload"] or {}).get("name"))
    rng = np.random.default_rng([options.seed, int(options.round.resolve().name)])

    def one_run(run: dict, motion: Motion) -> tuple[str, str]:
        machine = Machine(file, motion.joints, (run["payload"] or {}).get("name"))
        log, beside, end = machine.play(motion, rng, motion.file["runs"].index(run) * motion.time[-1])
        return write_log(motion, run["name"], *log, **beside), end

    kinds = {"position": "q", "current": "i", "duty": "duty", "supply_voltage": "supply_voltage"}
    signals = {key: {name: f"{kind}_{name}" for name in motion.joints} for key, kind in kinds.items()}
    supplied = "supply" in yaml.safe_load(file.read_text())
    play_round(options.round, options.speed, one_run, {"time": "t", **signals} if supplied else None)


if __name__ == "__main__":
    main()
