"""Arguments of a wrong type, the types that people import, and the page on Python."""

from __future__ import annotations

import contextlib
import inspect
import pickle
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from five_bar_logs import DESIGN, Plant, write_experiment

import gtau
from gtau.demo import write_tutorial

ROOT = Path(__file__).parents[2]
WRONG = [3, 2.5, b"x", [1], {"a": object()}, {1: "x"}, object(), np.zeros(3), gtau, True, "nonsense", Path("nowhere")]
LOG = {"t": np.arange(100) / 100, "a": np.zeros(100), "b": np.zeros(100)}
OF_LOG = {"time": "t", "position": {"left": "a"}, "current": {"left": "b"}}


class _Reached(Exception):
    """The arguments have been accepted."""


def _reached(*_: Any, **__: Any) -> None:
    raise _Reached


def calls() -> list[tuple[Callable, dict[str, Any], str]]:
    robot = gtau.load_robot("five-bar")
    runs = [Plant().run("free", seconds=1.0)]
    of_robot, model = {"source": robot, "runs": runs}, gtau.InverseDynamics(robot)
    good: dict[str, dict[str, Any]] = {
        "identify": of_robot,
        "compare": of_robot,
        "check": of_robot,
        "weigh": {"model": None, "source": robot, "runs": runs},
        "simulate": {"source": "nowhere.yaml", "out": "out"},
        "read_run": {"log": LOG, "signals": OF_LOG},
        "read_experiment": {"path": "nowhere.yaml"},
        "read_design": {"path": "nowhere.yaml"},
        "excite": {"task": None},
        "campaign": {"folder": "nowhere"},
        "fleet": {"experiments": ["nowhere.yaml"]},
        "draft": {"logs": ["nowhere.csv"]},
        "load": {"path": "nowhere.json"},
        "plot": {"shown": robot},
        "load_robot": {"source": "five-bar"},
        "base_parameters": {"idm": model},
        "InverseDynamics": {"robot": robot},
        "export_model": {"model": "nowhere.json", "kind": "csv", "out": "out"},
        "momentum_observer": {"result": None, "run": runs[0], "bandwidth": 5.0},
        "export_payload": {"payload": None, "kind": "ur", "out": "out"},
    }
    functions = {name for name in gtau.__all__ if inspect.isfunction(getattr(gtau, name))}
    assert functions == set(good) - {"InverseDynamics"}
    return [
        (getattr(gtau, name), {key: each for key, each in arguments.items() if key != wrong}, wrong)
        for name, arguments in good.items()
        for wrong in inspect.signature(getattr(gtau, name)).parameters
    ]


def test_every_wrong_type_is_refused_in_a_sentence(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("gtau.estimation.preconditions.reduce_runs", _reached)
    refused = 0
    for function, arguments, name in calls():
        for wrong in WRONG:
            with contextlib.suppress(_Reached):  # True for a choice, a text for a path, and the like
                try:
                    function(**arguments, **{name: wrong})
                except gtau.GtauError:
                    refused += 1
    assert refused > 400


def test_numbers_out_of_range_are_refused() -> None:
    for options, sentence in (
        ({"accuracy": 3.0}, r"write 0\.03 for 3 %"),
        ({"ratio": 0.5}, "10 to 30"),
        ({"prior_gains": {"left": 0.0, "right": 1.0}}, "the prior gain of joint 'left' is 0"),
        ({"method": 3}, r"'method' of identify\(\) cannot be of type int; give a text"),
    ):
        with pytest.raises(gtau.GtauError, match=sentence):
            gtau.identify("nowhere.yaml", **options)  # type: ignore[arg-type]


def test_a_refusal_is_the_built_in_error_that_it_is(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    robot = gtau.load_robot("five-bar")
    for call, kind in (
        (lambda: gtau.identify("nowhere.yaml"), FileNotFoundError),
        (lambda: gtau.load("nowhere.json"), FileNotFoundError),
        (lambda: gtau.load_robot("nowhere.urdf"), FileNotFoundError),
        (lambda: gtau.load_robot("nowhere.csv"), FileNotFoundError),
        (lambda: gtau.read_run("nowhere.csv", OF_LOG), FileNotFoundError),
        (lambda: robot.joint("99"), KeyError),
        (lambda: gtau.InverseDynamics(robot).torques(*np.zeros((3, 2)), {"m_99": 1.0}), KeyError),
    ):
        with pytest.raises(kind) as refusal:
            call()
        assert isinstance(refusal.value, gtau.GtauError)
        assert isinstance(refusal.value, ValueError)
        assert str(refusal.value) == refusal.value.args[0]
        assert str(pickle.loads(pickle.dumps(refusal.value))) == str(refusal.value)
        blank = type(refusal.value).__new__(type(refusal.value), *refusal.value.args)  # as tblib, Dask's, does
        assert isinstance(blank, gtau.GtauError)


def test_a_type_error_names_the_function() -> None:
    for function in (gtau.identify, gtau.check, gtau.load_robot, gtau.InverseDynamics):
        for arguments in ({}, {"nonsense": 1}):
            with pytest.raises(TypeError, match=rf"{function.__qualname__}\S*\(\) (missing|got)"):
                function(**arguments)


def test_types_of_public_signatures_can_be_imported_from_the_package() -> None:
    builtin = {"Any", "Callable", "Literal", "Mapping", "None", "Path", "Progress", "Sequence", "bool", "float", "int"}
    builtin |= {"np", "ndarray", "Figure"}
    for name in gtau.__all__:
        function = getattr(gtau, name)
        if inspect.isfunction(function):
            signature = inspect.signature(function)
            written = [each.annotation for each in signature.parameters.values()] + [signature.return_annotation]
            named = {found for each in written for found in re.findall(r"[A-Za-z]\w*", str(each))}
            assert named <= {*gtau.__all__, *builtin, "str", "dict", "tuple"}, name


def test_their_representations_are_short(tmp_path: Path) -> None:
    file = write_experiment(tmp_path, Plant(noise=0.01))
    (tmp_path / "design.yaml").write_text(DESIGN)
    experiment = gtau.read_experiment(file)
    checked = gtau.check(file)
    task, _ = gtau.read_design(tmp_path / "design.yaml")
    base = gtau.base_parameters(gtau.InverseDynamics(gtau.load_robot("five-bar")))
    described = (experiment, experiment.signals, experiment.units, experiment.runs[1].payload, task, base)
    made = (gtau.Prior(value=1, std=2), gtau.Part(), gtau.PreparationSettings())
    for each in (*described, *made, checked, checked.logs[0], checked.logs[0].run):
        assert len(repr(each)) < 200


def test_the_blocks_of_the_page_on_python_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write_tutorial(tmp_path)
    monkeypatch.chdir(tmp_path)
    page = (ROOT / "docs" / "do" / "python.md").read_text(encoding="utf-8")
    blocks = re.findall(r"```python\n(.*?)```", page, re.DOTALL)
    place: dict[str, Any] = {}
    for block in blocks:
        assert block.count("\n") <= 20  # short
        exec(block, place)
    result, load = place["result"], place["load"]
    for joint, true in {"left": 2.62, "right": 3.95}.items():
        low, high = result.drive_gains[joint].interval(0.999)
        assert low < true < high
        assert place["given"].drive_gains[joint].verdict.outcome == "given"
    assert load.parameters["m"].value == pytest.approx(0.74, rel=0.02)
    assert len(place["experiment"].runs) == 1
