"""The exported controller under bad inputs, fuzzed with the sanitizers of addresses and of undefined behaviour."""

from __future__ import annotations

import subprocess
from pathlib import Path

import numpy as np
import pytest
from c_code import FLAGS, SANITIZERS, sanitizing
from models_to_export import model_of, torques
from robots_for_tests import ROBOTS, home

from gtau.export.generated import export_c as export
from gtau.uses.identified import identified

DRIVER = Path(__file__).with_name("controller_fuzz.c")


@pytest.fixture(scope="module")
def sanitized(tmp_path_factory: pytest.TempPathFactory) -> str:
    """A compiler with sanitizers."""
    return sanitizing(tmp_path_factory.mktemp("sanitizers"))


def smooth(parameters: np.ndarray, names: list[str]) -> np.ndarray:
    """The parameters without dry friction, so that a simulated robot can be integrated by small steps."""
    return np.where([name.startswith(("fs", "fl")) for name in names], 0.0, parameters)


@pytest.mark.parametrize("name", ["five-bar", pytest.param("ur10e", marks=pytest.mark.slow)])
def test_bad_inputs_have_a_status_and_safe_currents(name: str, sanitized: str, tmp_path: Path) -> None:
    robot = next(robot for robot in ROBOTS if robot.name == name)
    result = model_of(robot)
    model = identified(result)
    export(result, tmp_path)
    names = [each.name for each in model.parameters]
    values = smooth(model.values, names)
    assert (values != model.values).any()
    q = home(robot)[None, :]
    still = np.abs(torques(model, q, 0 * q, 0 * q, values) / model.gains).max()
    fields = {
        "SMOOTH_PARAMETERS": ", ".join(map(repr, values.tolist())),
        "HOME_Q": ", ".join(map(repr, home(robot).tolist())),
        "AMPLITUDE": 0.05,
        "VELOCITY": 8.0,
        "LIMIT": 5.0 * still,
        "HELD": 5,
    }
    (tmp_path / "smooth.h").write_text("".join(f"#define {key} {value}\n" for key, value in fields.items()))
    c_name = model.name
    text = DRIVER.read_text().replace("robot_", f"{c_name}_").replace("ROBOT_", f"{c_name.upper()}_")
    (tmp_path / "fuzz.c").write_text(text)
    sources = [tmp_path / f"{each}.c" for each in (c_name, f"{c_name}_controller", "fuzz")]
    subprocess.run([sanitized, *FLAGS, "-O1", *SANITIZERS, "-o", tmp_path / "fuzz", *sources, "-lm"], check=True)
    ran = subprocess.run([tmp_path / "fuzz"], capture_output=True, text=True)
    assert ran.stdout == "OK\n", ran.stdout + ran.stderr
    assert ran.returncode == 0
