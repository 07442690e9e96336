"""gtau: identify drive gains and dynamic parameters of serial and parallel robots from logs."""

from __future__ import annotations

from importlib import import_module

TYPE_CHECKING: bool = False  # typing's takes 5 ms to import; editors take a False without a type at its word
if TYPE_CHECKING:
    from typing import Any

    from gtau.campaigns.campaign import CampaignState, campaign
    from gtau.errors import GtauError
    from gtau.estimation.check_logs import ExperimentCheck
    from gtau.estimation.check_logs import check_logs as check
    from gtau.estimation.compare import EstimatorComparison, compare
    from gtau.estimation.identify import identify
    from gtau.estimation.results.estimate import Estimate, TorqueError
    from gtau.estimation.results.groups import PayloadBody, PayloadEstimate
    from gtau.estimation.results.predicted import Prediction
    from gtau.estimation.results.result import Result
    from gtau.excitation.design import Design
    from gtau.excitation.design import design as excite
    from gtau.excitation.design_file import read_design
    from gtau.excitation.task import DesignProblem
    from gtau.export.exported import Exported, export_model
    from gtau.export.payload import export_payload
    from gtau.model.base_parameters import BaseParameters, base_parameters
    from gtau.model.home import load_robot
    from gtau.model.inverse_dynamics import InverseDynamics
    from gtau.robots.readers.source import RobotSource
    from gtau.robots.robot import Robot
    from gtau.signals.reading.columns import Signals
    from gtau.signals.reading.experiment import Experiment, read_experiment
    from gtau.signals.reading.samples import Part
    from gtau.signals.reading.statements import Payload, PreparationSettings, Prior
    from gtau.signals.reading.units import Units
    from gtau.signals.run import Run, read_run
    from gtau.simulation.experiment_files import simulate_experiment as simulate
    from gtau.simulation.simulation_file import Simulation
    from gtau.uses.external_torques import momentum_observer
    from gtau.uses.weigh import weigh
    from gtau.watch.watch import Watch

__version__ = "0.1.0"
__all__ = [
    "BaseParameters",
    "CampaignState",
    "Design",
    "DesignProblem",
    "Estimate",
    "EstimatorComparison",
    "Experiment",
    "ExperimentCheck",
    "Exported",
    "GtauError",
    "InverseDynamics",
    "Part",
    "Payload",
    "PayloadBody",
    "PayloadEstimate",
    "Prediction",
    "PreparationSettings",
    "Prior",
    "Result",
    "Robot",
    "RobotSource",
    "Run",
    "Signals",
    "Simulation",
    "TorqueError",
    "Units",
    "Watch",
    "base_parameters",
    "campaign",
    "check",
    "compare",
    "excite",
    "export_model",
    "export_payload",
    "identify",
    "load_robot",
    "momentum_observer",
    "read_design",
    "read_experiment",
    "read_run",
    "simulate",
    "weigh",
]

_HOMES = {
    "BaseParameters": "model.base_parameters",
    "CampaignState": "campaigns.campaign",
    "Design": "excitation.design",
    "DesignProblem": "excitation.task",
    "Estimate": "estimation.results.estimate",
    "EstimatorComparison": "estimation.compare",
    "Experiment": "signals.reading.experiment",
    "ExperimentCheck": "estimation.check_logs",
    "Exported": "export.exported",
    "GtauError": "errors",
    "InverseDynamics": "model.inverse_dynamics",
    "Part": "signals.reading.samples",
    "Payload": "signals.reading.statements",
    "PayloadBody": "estimation.results.groups",
    "PayloadEstimate": "estimation.results.groups",
    "Prediction": "estimation.results.predicted",
    "PreparationSettings": "signals.reading.statements",
    "Prior": "signals.reading.statements",
    "Result": "estimation.results.result",
    "Robot": "robots.robot",
    "RobotSource": "robots.readers.source",
    "Run": "signals.run",
    "Signals": "signals.reading.columns",
    "Simulation": "simulation.simulation_file",
    "TorqueError": "estimation.results.estimate",
    "Units": "signals.reading.units",
    "Watch": "watch.watch",
    "base_parameters": "model.base_parameters",
    "campaign": "campaigns.campaign",
    "check": "estimation.check_logs",
    "compare": "estimation.compare",
    "excite": "excitation.design",
    "export_model": "export.exported",
    "export_payload": "export.payload",
    "identify": "estimation.identify",
    "load_robot": "model.home",
    "momentum_observer": "uses.external_torques",
    "read_design": "excitation.design_file",
    "read_experiment": "signals.reading.experiment",
    "read_run": "signals.run",
    "simulate": "simulation.experiment_files",
    "weigh": "uses.weigh",
}
_NAMES_AT_HOME = {
    "check": "check_logs",
    "excite": "design",
    "simulate": "simulate_experiment",
}  # the others are called the same there


def __getattr__(name: str) -> Any:
    """Import a name when it is first used (PEP 562), so that ``import gtau`` itself stays light."""
    if name not in _HOMES:
        raise AttributeError(f"module 'gtau' has no attribute '{name}'")
    return getattr(import_module(f"gtau.{_HOMES[name]}"), _NAMES_AT_HOME.get(name, name))


def __dir__() -> list[str]:
    return __all__
