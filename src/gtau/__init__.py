"""gtau: drive gains and dynamic parameters of robots, serial and parallel, from their logs."""

from __future__ import annotations

from importlib import import_module

from gtau import display

TYPE_CHECKING = False  # typing's own takes 5 ms to import, more than all else here
if TYPE_CHECKING:
    from typing import Any

    from gtau.errors import GtauError
    from gtau.estimation.compare import compare
    from gtau.estimation.identify import identify
    from gtau.estimation.results.estimate import Estimate
    from gtau.estimation.results.result import Result
    from gtau.estimation.weigh import weigh
    from gtau.excitation.design import design as excite
    from gtau.excitation.design_file import read_design
    from gtau.export.registry import export_model
    from gtau.model.base_parameters import BaseParameters, base_parameters
    from gtau.model.home import load_robot
    from gtau.model.inverse_dynamics import InverseDynamics
    from gtau.robots.robot import Robot
    from gtau.signals.experiment import Prior
    from gtau.signals.run import Run, read_run
    from gtau.simulation.experiment_files import simulate_experiment as simulate

__version__ = "0.1.0"
__all__ = [
    "BaseParameters",
    "Estimate",
    "GtauError",
    "InverseDynamics",
    "Prior",
    "Result",
    "Robot",
    "Run",
    "base_parameters",
    "compare",
    "excite",
    "export_model",
    "identify",
    "load_robot",
    "read_design",
    "read_run",
    "simulate",
    "weigh",
]

_HOMES = {
    "BaseParameters": "model.base_parameters",
    "Estimate": "estimation.results.estimate",
    "GtauError": "errors",
    "InverseDynamics": "model.inverse_dynamics",
    "Prior": "signals.experiment",
    "Result": "estimation.results.result",
    "Robot": "robots.robot",
    "Run": "signals.run",
    "base_parameters": "model.base_parameters",
    "compare": "estimation.compare",
    "excite": "excitation.design",
    "export_model": "export.registry",
    "identify": "estimation.identify",
    "load_robot": "model.home",
    "read_design": "excitation.design_file",
    "read_run": "signals.run",
    "simulate": "simulation.experiment_files",
    "weigh": "estimation.weigh",
}
_NAMES_AT_HOME = {"excite": "design", "simulate": "simulate_experiment"}  # the others are called the same there


display.register(lambda: import_module("gtau.report.notebook"))


def __getattr__(name: str) -> Any:
    """Import a name when it is first used (PEP 562), so that ``import gtau`` itself stays light."""
    if name not in _HOMES:
        raise AttributeError(f"module 'gtau' has no attribute '{name}'")
    return getattr(import_module(f"gtau.{_HOMES[name]}"), _NAMES_AT_HOME.get(name, name))


def __dir__() -> list[str]:
    return __all__
