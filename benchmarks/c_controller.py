"""Computed torque control of a simulated Orthoglide in MuJoCo, by the exported C code and by Python.

    python benchmarks/c_controller.py [FIGURE.png]

The robot, its drives and sensors, the payload and the trajectories are those of the case study; the model is identified
from its logs. Both controllers run at 1 kHz and give currents. Needs gcc; prints tracking errors, how far the two
currents are apart, and what a call of the C functions takes.
"""

from __future__ import annotations

import ctypes
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

import gtau
from gtau.demo import make_experiment
from gtau.findings import silent
from gtau.model.inverse_dynamics import InverseDynamics
from gtau.signals.reading.statements import Payload
from gtau.simulation.closed_loop import (
    Controller,
    Engine,
    Hardware,
    Reference,
    close_loop,
    rounded,
    sample,
)
from gtau.simulation.simulate import apparatus, read_simulation
from gtau.simulation.trajectories import make_trajectory

sys.path.append(str(Path(__file__).parents[1] / "examples"))
from control_comparison import computed_torque

DURATION = 8.0  # s, of each log that the model is identified from
NAME = "orthoglide"
TIMING = r"""
#define _POSIX_C_SOURCE 199309L
#include <math.h>
#include <stdio.h>
#include <time.h>
#include "orthoglide_controller.h"
enum { N = ORTHOGLIDE_JOINTS, CALLS = 100000 };
static double now(void) { struct timespec t; clock_gettime(CLOCK_MONOTONIC, &t); return t.tv_sec + 1e-9 * t.tv_nsec; }
int main(void) {
  orthoglide_pose pose;
  double q[N] = {0}, qd[N] = {0.3, -0.2, 0.1}, qdd[N] = {1, 2, 3}, out[N * ORTHOGLIDE_PARAMETERS], sum = 0;
  if (orthoglide_start(&pose, q)) return 1;
  double from = now();
  for (int i = 0; i < CALLS; ++i) {
    for (int k = 0; k < N; ++k) q[k] = 0.05 * sin(1e-3 * i + k) - 0.05 * sin(k);
    if (orthoglide_move(&pose, q)) return 2;
  }
  printf("move %.2f\n", (now() - from) / CALLS * 1e6);
#define TIME(name, call) from = now(); \
  for (int i = 0; i < CALLS; ++i) { qd[0] += 1e-9; pose.c[1] += 1e-12; call; sum += out[0]; } \
  printf(name " %.2f\n", (now() - from) / CALLS * 1e6);
  TIME("currents", orthoglide_currents(&pose, qd, qdd, orthoglide_parameters, out))
  TIME("gravity", orthoglide_gravity(&pose, orthoglide_parameters, out))
  TIME("inertia", orthoglide_inertia(&pose, orthoglide_parameters, out))
  TIME("regressor", orthoglide_regressor(&pose, qd, qdd, orthoglide_parameters, out))
  orthoglide_configuration set = {.period = 1e-3, .bandwidth = 100};
  for (int k = 0; k < N; ++k) set.limit[k] = set.velocity[k] = set.following[k] = 1e3;
  orthoglide_controller controller;
  for (int k = 0; k < N; ++k) q[k] = 0;
  if (orthoglide_controller_start(&controller, &set, q)) return 3;
  TIME("cycle", if (orthoglide_controller_cycle(&controller, 1e-3, q, qd, qdd, q, orthoglide_parameters, out)) return 4)
  return sum == 0.5;
}
"""


def main(figure: Path | None) -> None:
    with TemporaryDirectory() as name:
        folder = Path(name)
        make_experiment(folder, DURATION, silent)
        result = gtau.identify(folder / "experiment.yaml")
        gtau.export_model(result, "c", folder / "c")
        simulation = read_simulation(folder / "simulation.yaml").model_copy(update={"engine": "mujoco"})
        model = InverseDynamics(result.robot)
        library = compiled(folder / "c")
        shown = {}
        print(f"{'':<14}{'':<10}{'largest error, um':>30}{'rms, um':>30}")
        for described in simulation.control:
            motion, duration = make_trajectory(described.trajectory, model.robot, described.name)
            reference = sample(motion, duration, simulation.rate)
            engine, _, parts = apparatus(simulation, model, described.payload)
            law = computed_torque(reference, result, described.payload, simulation.bandwidth)
            none = np.zeros(len(model.actuated))
            parts = replace(parts, current_noise=none, current_quantum=none)  # of what is logged, to compare currents
            rng = np.random.default_rng(1)
            made = close_loop(described.name, engine, law, parts, rng, model.actuated)
            parameters = loaded_parameters(library, described.payload)
            error, current = run_c(library, engine, law, parts, parameters, np.random.default_rng(1))
            for who, each in (("Python", made.error), ("C", error)):
                largest, rms = 1e6 * np.abs(each).max(axis=0), 1e6 * np.sqrt(np.mean(each**2, axis=0))
                print(f"{described.name:<14}{who:<10}" + "".join(f"{value:>10.2f}" for value in (*largest, *rms)))
            apart = np.abs(current - made.run.command).max()
            print(f"{'':<14}currents apart by at most {apart:.2g} A of {np.abs(current).max():.2g} A")
            shown[described.name] = (reference, made.error, error)
        print("microseconds a call, gcc -O2:", ", ".join(timing(folder / "c").split("\n")[:-1]))
        if figure is not None:
            draw(shown, model.actuated, figure)


def compiled(folder: Path) -> ctypes.CDLL:
    sources = [str(folder / f"{NAME}.c"), str(folder / f"{NAME}_controller.c")]
    library = folder / f"lib{NAME}.so"
    flags = ("-std=c99", "-Wall", "-Wextra", "-Werror", "-O2", "-shared", "-fPIC")
    subprocess.run(["gcc", *flags, "-o", library, *sources, "-lm"], check=True)
    return ctypes.CDLL(str(library))


def timing(folder: Path) -> str:
    (folder / "timing.c").write_text(TIMING)
    program = folder / "timing"
    sources = [folder / f"{each}.c" for each in ("timing", NAME, f"{NAME}_controller")]
    subprocess.run(["gcc", "-std=c99", "-O2", "-o", program, *sources, "-lm"], check=True)
    return subprocess.check_output([program], text=True)


def loaded_parameters(library: ctypes.CDLL, payload: Payload | None) -> ctypes.Array[ctypes.c_double]:
    """The array of the code that holds the parameters with a payload."""
    size = len(library_parameters(library))
    name = f"{NAME}_parameters" + (f"_with_{payload.name}" if payload is not None else "")
    return (ctypes.c_double * size).in_dll(library, name)


def library_parameters(library: ctypes.CDLL) -> range:
    """As many as the header says."""
    text = Path(library._name).with_name(f"{NAME}.h").read_text()
    (line,) = (line for line in text.splitlines() if line.startswith(f"#define {NAME.upper()}_PARAMETERS"))
    return range(int(line.split()[2]))


def run_c(
    library: ctypes.CDLL,
    engine: Engine,
    law: Controller,
    parts: Hardware,
    parameters: ctypes.Array[ctypes.c_double],
    rng: np.random.Generator,
) -> tuple[np.ndarray, np.ndarray]:
    """Tracking errors (N, n) and currents (N, n) of the C controller, cycle by cycle."""
    reference: Reference = law.reference
    assert not parts.keys["delay"].any()
    period, n = float(reference.time[1] - reference.time[0]), reference.q.shape[1]
    memory = ctypes.create_string_buffer(1 << 12)  # a controller is smaller
    state = engine.start(reference.q[0])
    phase = rng.uniform(0.0, 2 * np.pi, (1, n))[0]
    cycle: Callable[..., int] = library.orthoglide_controller_cycle

    def at(values: np.ndarray) -> ctypes.Array[ctypes.c_double]:
        return (ctypes.c_double * n)(*values)

    class Configuration(ctypes.Structure):
        _fields_ = (
            ("period", ctypes.c_double),
            ("bandwidth", ctypes.c_double),
            ("limit", ctypes.c_double * n),
            ("velocity", ctypes.c_double * n),
            ("following", ctypes.c_double * n),
            ("hold", ctypes.c_int),
        )

    velocity = 10 * np.abs(reference.qd).max(axis=0)  # a margin for the resolution of the encoders
    limits = at(parts.keys["current_limit"]), at(velocity), at(3 / law.bandwidth * velocity)
    configuration = Configuration(period, law.bandwidth, *limits, 0)
    assert library.orthoglide_controller_start(memory, ctypes.byref(configuration), at(reference.q[0])) == 0
    error, current, out = np.empty_like(reference.q), np.empty_like(reference.q), at(np.zeros(n))
    for k in range(len(reference.time)):
        seen = rounded(state.q, parts.keys["position_quantum"])
        references = (at(reference.q[k]), at(reference.qd[k]), at(reference.qdd[k]))
        assert cycle(memory, ctypes.c_double(period), *references, at(seen), parameters, out) == 0
        current[k], error[k] = out, reference.q[k] - state.q
        state = engine.advance(state, parts.force(current[k], state.q, phase), period)
    return error, current


def draw(shown: dict[str, tuple[Reference, np.ndarray, np.ndarray]], joints: tuple[str, ...], path: Path) -> None:
    from matplotlib.figure import Figure

    from gtau.report.charts import save_figure

    figure = Figure(figsize=(9.0, 6.0), layout="constrained")
    axes = figure.subplots(len(joints), len(shown), sharex="col", sharey="row")
    for column, (name, (reference, python, c)) in enumerate(shown.items()):
        for row, joint in enumerate(joints):
            axis = axes[row, column]
            axis.plot(reference.time, 1e6 * python[:, row], color="0.6", lw=2.5, label="Python")
            axis.plot(reference.time, 1e6 * c[:, row], color="tab:blue", lw=0.8, label="C")
            axis.grid(alpha=0.3)
            if not column:
                axis.set_ylabel(f"joint {joint}, µm")
        axes[0, column].set_title(name.replace("_", " "))
        axes[-1, column].set_xlabel("time, s")
    figure.legend(*axes[0, 0].get_legend_handles_labels(), loc="outside lower center", ncols=2)
    figure.suptitle("Tracking errors of computed torque control at 1 kHz, simulated in MuJoCo")
    save_figure(figure, path)


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else None)
