"""The demo: the whole job on logs made on the spot, of an Orthoglide whose true values are known."""

from __future__ import annotations

from importlib.util import find_spec
from pathlib import Path
from typing import Any

from gtau.demo.files import DESIGN, EXPERIMENT, LOGS, RATE, SECOND_PAYLOAD, VALIDATION, simulation_text
from gtau.demo.page import DemoOutcome, document, report
from gtau.documents.files import folder_of, write_atomically
from gtau.estimation.experiment_runs import read_runs
from gtau.estimation.identify import identify
from gtau.estimation.results.prediction import torque_errors
from gtau.estimation.weigh import weigh
from gtau.model.home import load_robot
from gtau.model.inverse_dynamics import InverseDynamics
from gtau.progress import Progress
from gtau.signals.experiment import read_experiment
from gtau.simulation.closed_loop import write_log
from gtau.simulation.control_comparison import compare_control, table
from gtau.simulation.controllers import Reference, sample
from gtau.simulation.experiment_files import make_run
from gtau.simulation.motions import make_trajectory
from gtau.simulation.orthoglide_truth import DRIVE_GAINS, PRIOR_GAINS, SECOND_PAYLOAD_MASS
from gtau.simulation.simulation_file import read_simulation


def demo(out: Path, progress: Progress, duration: float = 10.0) -> tuple[dict[str, Any], str]:
    """Make logs, identify the robot from them, weigh a second payload, and write everything to ``out``.

    Parameters
    ----------
    out : Path
        An existing folder.
    progress : callable
        Called as the work goes on.
    duration : float
        Of every log, s.

    Returns
    -------
    dict
        A JSON document: what was true, what was found, and the files.
    str
        The same as text.

    Raises
    ------
    GtauError
        Where a file cannot be written.
    """
    exciting = make_experiment(out, duration, progress)
    result = identify(out / "experiment.yaml", progress=progress)
    result.save(out / "model.json")
    weighings = {}
    for case in ("prior", "identified"):
        (payload,) = weigh(result, out / "second_payload.yaml", case, progress)
        weighings[case] = payload.parameters["m"]
    experiment = read_experiment(out / "experiment.yaml")
    (run,) = read_runs(experiment, experiment.validation)
    prediction = result.predict(run)
    gains = {joint: gain.value or 0.0 for joint, gain in result.drive_gains.items()}
    comparison = compare_control(out / "simulation.yaml", out / "experiment.yaml", progress, gains)
    outcome = DemoOutcome(result, weighings, prediction, torque_errors(result, prediction), comparison)
    figures = write_figures(out, outcome, exciting, progress)
    files = [
        "README.txt",
        "simulation.yaml",
        "experiment.yaml",
        "second_payload.yaml",
        "design.yaml",
        "model.json",
        *figures,
    ]
    files += [f"logs/{name}.csv" for name, _, _ in LOGS]
    found = document(outcome, out, duration, files)
    text = report(found, table(comparison))
    write_atomically(
        out / "README.txt", f"{text}\n\n\nThe whole result, as gtau identify prints it\n\n{result.summary()}\n"
    )
    return found, text


def make_experiment(out: Path, duration: float, progress: Progress) -> Reference:
    """Simulate the robot: write the logs and the files that describe them; return the first exciting trajectory."""
    write_atomically(out / "simulation.yaml", simulation_text(duration))
    simulation = read_simulation(out / "simulation.yaml")
    model = InverseDynamics(load_robot(simulation.robot))
    folder_of(out / "logs")
    runs = (*simulation.runs, *simulation.validation)
    for k, run in enumerate(runs):
        progress("simulating", k, len(runs))
        write_log(make_run(simulation, model, run).run, out / "logs" / f"{run.name}.csv")
    progress("simulating", len(runs), len(runs))
    for name, text in (("experiment", EXPERIMENT), ("second_payload", SECOND_PAYLOAD), ("design", DESIGN)):
        write_atomically(out / f"{name}.yaml", text)
    exciting, _ = make_trajectory(simulation.runs[0].trajectory, model.robot, LOGS[0][0])
    return sample(exciting, duration, RATE)


def write_figures(out: Path, outcome: DemoOutcome, exciting: Reference, progress: Progress) -> list[str]:
    """Write the figures; return their paths in ``out``, none where matplotlib is not installed."""
    if find_spec("matplotlib") is None:
        return []
    from gtau.report.control_figures import references_figure, tracking_figure
    from gtau.report.figures import gains_figure, payload_figure, torques_figure, trajectory_figure
    from gtau.report.robot_figure import robot_figure
    from gtau.report.style import save_figure

    compared, shown = outcome.comparison, slice(None, None, 5)
    motion = (exciting.q[shown], exciting.qd[shown], exciting.qdd[shown])
    units = [each.unit for each in outcome.errors]
    made = {
        "gains": gains_figure(outcome.result.drive_gains, DRIVE_GAINS, PRIOR_GAINS),
        "payload": payload_figure(outcome.weighings["prior"], outcome.weighings["identified"], SECOND_PAYLOAD_MASS),
        "torques": torques_figure(outcome.prediction, units, 0.0, min(6.0, exciting.time[-1]), VALIDATION),
        "trajectory": trajectory_figure(exciting.time[shown], motion, outcome.prediction.joints, "m", LOGS[0][0]),
        "test_trajectories": references_figure(compared.references, compared.joints, compared.units),
        **{f"tracking_{name}": tracking_figure(compared, name) for name in compared.references},
        "robot": robot_figure(outcome.result.robot),
    }
    folder_of(out / "figures")
    for k, (name, figure) in enumerate(made.items()):
        progress("drawing", k, len(made))
        save_figure(figure, out / "figures" / f"{name}.png")
    progress("drawing", len(made), len(made))
    return [f"figures/{name}.png" for name in made]
