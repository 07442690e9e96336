"""gtau: identify drive gains and dynamic parameters of serial and parallel robots from logs."""

import sys
from typing import Any

import lazy_loader

__version__ = "0.1.0"
# imports a name of __init__.pyi when it is first used, so that ``import gtau`` stays light
_first_used, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
_CALLS = dict.fromkeys(("load_urdf", "buildModelFromUrdf"), "gtau.load_robot('arm.urdf')") | {
    "rnea": "gtau.InverseDynamics(robot).torques(q, qd, qdd, parameters)",
    "computeJointTorqueRegressor": "gtau.InverseDynamics(robot).regressor(q, qd, qdd)",
    "read_log": "gtau.read_run(log, signals)",
    "predict": "result.predict(run)",
    "validate": "result.validate(run)",
    "payload": "gtau.weigh(result, robot, runs)",
}


def __getattr__(name: str) -> object:
    if name not in __all__:
        from gtau.errors import OtherSpelling, meant

        if hint := f"did you mean {_CALLS[name]}?" if name in _CALLS else meant(name, __all__):
            raise OtherSpelling(f"gtau has no '{name}'; {hint}")
    return _first_used(name)


_SHOWN = {
    "Named": "gtau.estimation.results.estimate",
    "PayloadEstimate": "gtau.estimation.results.payload_body",
    "Prediction": "gtau.uses.prediction",
    "EstimatorComparison": "gtau.estimation.identify",
    "CheckedExperiment": "gtau.estimation.check_logs",
}
"""Classes that have a page in :mod:`gtau.report.plots`, with their modules."""


def _html(shown: object) -> str:
    from gtau.report import plots

    return plots.html(shown)


def _register(shell: Any) -> None:
    """Let an IPython shell show these classes as pages, without importing them."""
    for name, module in _SHOWN.items():
        shell.display_formatter.formatters["text/html"].for_type_by_name(module, name, _html)


if (_ipython := sys.modules.get("IPython")) and (_shell := _ipython.get_ipython()):
    _register(_shell)
