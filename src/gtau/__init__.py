"""gtau: identify drive gains and dynamic parameters of serial and parallel robots from logs."""

import sys

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


if (_ipython := sys.modules.get("IPython")) and (_shell := _ipython.get_ipython()):
    from gtau.ipython import register as _register

    _register(_shell)
