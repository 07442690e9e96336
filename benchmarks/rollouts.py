"""Identification by mujoco.sysid, as its documentation says: parameters of a model whose rollouts follow the log."""

from __future__ import annotations

import sys
from collections.abc import Callable
from contextlib import redirect_stdout
from dataclasses import dataclass
from pathlib import Path

import mujoco
import numpy as np

from gtau.robots.robot import Robot

sys.path.append(str(Path(__file__).parents[1] / "tests" / "support"))
from engines import Mujoco, random_parameters

STEP = 2e-3  # s, of the simulation, and the shortest of the samples that it is given
WINDOW, WINDOWS = 0.5, 16  # s, of rollouts that start from the measured state, and their number
ITERATIONS = 12  # of Gauss-Newton; its documentation's 200 take hours here


@dataclass(frozen=True)
class RolloutFit:
    """Values and halves of 95 % intervals by name, and what predicts torques (N, n) of states."""

    values: dict[str, np.ndarray]
    halves: dict[str, np.ndarray]
    predict: Callable[[np.ndarray, np.ndarray, np.ndarray], np.ndarray]


def sysid_fit(robot: Robot, time: np.ndarray, q: np.ndarray, qd: np.ndarray, tau: np.ndarray) -> RolloutFit:
    """Inertia of each body and rotor inertia, friction and offset of each joint; states (N, n) of one log."""
    from mujoco import sysid

    engine = Mujoco(robot, random_parameters(robot, np.random.default_rng(1)))
    spec, names = engine.spec, robot.actuated
    spec.option.disableflags = mujoco.mjtDisableBit.mjDSBL_CONTACT | mujoco.mjtDisableBit.mjDSBL_LIMIT
    spec.option.timestep, spec.option.integrator = STEP, mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    for name in names:
        motor = spec.add_actuator(name=name, target=name, trntype=mujoco.mjtTrn.mjTRN_JOINT)
        motor.set_to_motor()
        motor.biastype = mujoco.mjtBias.mjBIAS_AFFINE
        kind = mujoco.mjtSensor.mjSENS_JOINTPOS
        spec.add_sensor(name=f"{name}_pos", type=kind, objtype=mujoco.mjtObj.mjOBJ_JOINT, objname=name)
    model = spec.compile()

    params = sysid.ParameterDict()

    def drive(part: str, name: str, kind: str, first: float, low: float, high: float) -> None:
        def modify(spec: mujoco.MjSpec, parameter: sysid.Parameter) -> None:
            target = getattr(spec, part)(name)
            if np.ndim(getattr(target, kind)):
                getattr(target, kind)[0] = parameter.value[0]
            else:
                setattr(target, kind, parameter.value[0])

        params.add(sysid.Parameter(f"{kind}_{name}", first, low, high, modifier=modify))

    def inertia(spec: mujoco.MjSpec, parameter: sysid.Parameter) -> None:
        body = parameter.name.removesuffix("_inertia")
        sysid.apply_body_inertia(spec, body, parameter)
        spec.body(body).iquat = [1.0, 0.0, 0.0, 0.0]  # left as nan, MuJoCo 4.0.0 finds no inertia

    single = len(names) == 1  # a mass alone, as only it is identifiable
    for body in names:
        if single:
            drive("body", body, "mass", 10.0, 0.1, 1000.0)
        else:
            pseudo = sysid.InertiaType.Pseudo
            params.add(sysid.body_inertia_param(spec, model, body, inertia_type=pseudo, modifier=inertia))

    size = np.sqrt(np.mean(tau**2, axis=0))
    for name, most in zip(names, size, strict=True):
        if not single:
            drive("joint", name, "armature", 0.1, 0.0, 100.0)
        drive("joint", name, "damping", 1.0, 0.0, 1000.0)
        drive("joint", name, "frictionloss", 0.1 * most, 0.0, 3 * most)
        drive("actuator", name, "biasprm", 0.0, -3 * most, 3 * most)

    length = int(WINDOW / (time[1] - time[0]))
    starts = np.unique(np.linspace(0, len(time) - length - 1, WINDOWS).astype(int))
    windows = [slice(start, start + length) for start in starts]
    sequences = sysid.ModelSequences(
        name="arm",
        spec=spec,
        sequence_name=[f"window_{k}" for k in range(len(windows))],
        initial_state=[sysid.create_initial_state(model, q[each.start], qd[each.start]) for each in windows],
        control=[
            sysid.TimeSeries.from_control_names(time[each] - time[each.start], tau[each], model) for each in windows
        ],
        sensordata=[sysid.TimeSeries.from_names(time[each] - time[each.start], q[each], model) for each in windows],
    )
    residuals = sysid.build_residual_fn(models_sequences=[sequences], n_threads=1)
    with redirect_stdout(sys.stderr):
        found, outcome = sysid.optimize(params, residuals, max_iters=ITERATIONS, verbose=False, x_scale="jac")
    left = residuals(outcome.x, found)[0]
    halves = sysid.calculate_intervals([each.ravel() for each in left], outcome.jac)[1]
    identified = sysid.apply_param_modifiers(found, spec)
    data = mujoco.MjData(identified)

    def predict(q: np.ndarray, qd: np.ndarray, qdd: np.ndarray) -> np.ndarray:
        torques = np.empty_like(q)
        for k, (data.qpos[:], data.qvel[:], data.qacc[:]) in enumerate(zip(q, qd, qdd, strict=True)):
            mujoco.mj_inverse(identified, data)
            torques[k] = data.qfrc_inverse
        return torques - identified.actuator_biasprm[:, 0]

    values = {name: parameter.value for name, parameter in found.parameters.items()}
    ends = np.cumsum([value.size for value in values.values()])[:-1]
    return RolloutFit(values, dict(zip(values, np.split(halves, ends), strict=True)), predict)
