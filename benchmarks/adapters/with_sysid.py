"""mujoco.sysid by rollouts of windows from measured states: bodies by pseudo-inertias, and the drives of each joint.

The drives' parameters are armature, damping, friction, offset and, where gains are asked for, torque per command. A run
with a payload shares them in a second spec, whose tool carries the known mass at a place to be found, as its README
says of a known payload. Bodies start at the file's, or at 1 kg.
"""

from contextlib import redirect_stdout
from functools import partial

import mujoco
import numpy as np
from exchange import Task, filtered
from mujoco import sysid

STEP = 2e-3  # s
UPRIGHT = [1.0, 0.0, 0.0, 0.0]
WINDOW, WINDOWS = 0.2, 12  # s, and their number in a run
ITERATIONS = 20
task = Task()
if task.masses and task.masses.endswith(".xml"):
    task.refuse("not tried: a floating base")
path = task.masses or task.geometry
n = len(task.joints)
if n > 3:
    task.refuse("not tried: more than three joints")


def spec_of(mass):
    spec = mujoco.MjSpec.from_file(path)
    spec.compiler.fusestatic = False  # else a payload is part of its link
    spec.option.disableflags = mujoco.mjtDisableBit.mjDSBL_CONTACT | mujoco.mjtDisableBit.mjDSBL_LIMIT
    spec.option.timestep, spec.option.integrator = STEP, mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    tool = bodies(spec.compile())[-1]
    for name in task.joints:
        motor = spec.add_actuator(name=f"{name}_motor", target=name, trntype=mujoco.mjtTrn.mjTRN_JOINT)
        motor.set_to_motor()
        motor.biastype = mujoco.mjtBias.mjBIAS_AFFINE
        spec.add_sensor(
            name=f"{name}_pos",
            type=mujoco.mjtSensor.mjSENS_JOINTPOS,
            objtype=mujoco.mjtObj.mjOBJ_JOINT,
            objname=name,
        )
    if mass:
        payload = spec.body(tool).add_body(name="payload", mass=mass, ipos=[0.0] * 3, iquat=UPRIGHT, inertia=[1e-2] * 3)
        payload.explicitinertial = True
    return spec


def bodies(model):
    return [model.body(model.jnt_bodyid[model.joint(name).id]).name for name in task.joints]


fit = [(log, mass) for log, mass in zip(task.fit, task.payload, strict=True) if mass is None or task.gains]
specs = [spec_of(mass) for _, mass in fit]
models = [spec.compile() for spec in specs]
params = sysid.ParameterDict()


def add(name, first, low, high, target, kind, index):
    """A number of what ``target(spec)`` gives, where the spec has it."""

    def modify(spec, parameter):
        element = target(spec)
        if element is not None and np.ndim(getattr(element, kind)):
            getattr(element, kind)[index] = parameter.value[0]
        elif element is not None:
            setattr(element, kind, parameter.value[0])

    params.add(sysid.Parameter(name, first, low, high, modifier=modify))


def inertia(spec, parameter):
    body = parameter.name.removesuffix("_inertia")
    sysid.apply_body_inertia(spec, body, parameter)
    spec.body(body).iquat = UPRIGHT  # left as nan, MuJoCo 4.0.0 finds no inertia


pseudo = sysid.InertiaType.Pseudo
for body in bodies(models[0]):
    params.add(sysid.body_inertia_param(specs[0], models[0], body, inertia_type=pseudo, modifier=inertia))
log = task.fit[0]
size = np.sqrt(np.mean(log["tau"] ** 2, axis=0))
speed = np.sqrt(np.mean(np.gradient(log["q"], 1 / task.rate, axis=0) ** 2, axis=0))
for name, most, slow in zip(task.joints, size, speed, strict=True):
    joint = partial(lambda name, spec: spec.joint(name), name)
    motor = partial(lambda name, spec: spec.actuator(f"{name}_motor"), name)
    add(f"armature_{name}", 0.02 * most / slow, 0.0, 10 * most / slow, joint, "armature", 0)
    add(f"damping_{name}", 0.1 * most / slow, 0.0, 3 * most / slow, joint, "damping", 0)
    add(f"friction_{name}", 0.1 * most, 0.0, 3 * most, joint, "frictionloss", 0)
    add(f"offset_{name}", 0.0, -3 * most, 3 * most, motor, "biasprm", 0)
    if task.gains:
        add(f"gain_{name}", 1.0, 0.5, 2.0, motor, "gainprm", 0)
if any(mass for _, mass in fit):
    for axis in range(3):
        add(f"payload_{'xyz'[axis]}", 0.0, -0.3, 0.3, lambda spec: spec.body("payload"), "ipos", axis)

sequences = []
every = max(1, round(STEP * task.rate))
for (log, _), spec, model in zip(fit, specs, models, strict=True):
    q, qd, _ = filtered(log, task.cutoff, task.rate)
    t, q, qd, tau = (values[::every] for values in (log["t"], q, qd, log["tau"]))
    length = int(WINDOW / (t[1] - t[0]))
    starts = np.unique(np.linspace(0, len(t) - length - 1, WINDOWS).astype(int))
    windows = [slice(start, start + length) for start in starts]
    sequences.append(
        sysid.ModelSequences(
            name=f"run_{len(sequences)}",
            spec=spec,
            sequence_name=[f"run_{len(sequences)}_{k}" for k in range(len(windows))],
            initial_state=[sysid.create_initial_state(model, q[w.start], qd[w.start]) for w in windows],
            control=[sysid.TimeSeries.from_control_names(t[w] - t[w.start], tau[w], model) for w in windows],
            sensordata=[sysid.TimeSeries.from_names(t[w] - t[w.start], q[w], model) for w in windows],
        )
    )
residuals = sysid.build_residual_fn(models_sequences=sequences, n_threads=1)
with redirect_stdout(None):
    found, outcome = sysid.optimize(params, residuals, max_iters=ITERATIONS, verbose=False, x_scale="jac")
halves = sysid.calculate_intervals([left.ravel() for left in residuals(outcome.x, found)[0]], outcome.jac)[1]
identified = sysid.apply_param_modifiers(found, specs[0])
data = mujoco.MjData(identified)
names = list(found.parameters)
ends = np.cumsum([found[name].value.size for name in names])[:-1]
half = {name: each[0] for name, each in zip(names, np.split(halves, ends), strict=True)}
value = {name: float(found[name].value[0]) for name in names}
gain = np.array([value.get(f"gain_{name}", 1.0) for name in task.joints])
offset = np.array([value[f"offset_{name}"] for name in task.joints])


def predict(log):
    """Its model's inverse dynamics, as commands."""
    torques = np.empty_like(log["q"])
    states = filtered(log, task.cutoff, task.rate)
    for k, (data.qpos[:], data.qvel[:], data.qacc[:]) in enumerate(zip(*states, strict=True)):
        mujoco.mj_inverse(identified, data)
        torques[k] = data.qfrc_inverse
    return (torques - offset) / gain


more = {}
if task.gains:
    more["scales"] = [(value[f"gain_{name}"], float(half[f"gain_{name}"])) for name in task.joints]
elif task.truth:
    kinds = {"armature": "ia", "damping": "fv", "friction": "fs", "offset": "off"}
    pairs = [
        (f"{kind}_{name}", task.truth.get(f"{short}_{name}", 0.0))
        for kind, short in kinds.items()
        for name in task.joints
    ]
    more["held"] = [sum(abs(value[key] - true) <= half[key] for key, true in pairs), len(pairs)]
    more["held"] = [int(count) for count in more["held"]]
task.answer(predict, **more)
