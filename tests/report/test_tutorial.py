"""The tutorial: its logs are those of its simulation file, and its commands end in the gains that were put in."""

from __future__ import annotations

import json
import re
import subprocess
from importlib.resources import files
from pathlib import Path

import numpy as np
import pytest
from c_code import GCC
from typer.testing import CliRunner

from gtau.cli.commands import app
from gtau.demo import write_tutorial
from gtau.errors import GtauError
from gtau.signals.reading.logs import read_log
from gtau.simulation.simulate import read_simulation

SOURCE = Path(str(files("gtau.demo") / "tutorial_logs"))
DOCS = Path(__file__).parents[2] / "docs"
PAGE = DOCS / "start" / "tutorial.md"


def gtau(*arguments: str) -> str:
    done = CliRunner().invoke(app, list(arguments))
    assert done.exit_code == 0, done.output
    return done.output


@pytest.mark.slow
def test_the_logs_are_small_and_made_by_the_simulator(tmp_path: Path) -> None:
    """Other processors round a position to the next quantum of the encoder at times, to which the controller reacts."""
    gtau("simulate", str(SOURCE / "simulation.yaml"), "--out", str(tmp_path))
    logs = sorted(SOURCE.glob("*.csv"))
    assert sum(each.stat().st_size for each in logs) < 400_000
    names = ("t", "qleft", "qright", "vleft", "vright")
    assert [each.name for each in logs] == sorted(each.name for each in tmp_path.glob("*.csv"))
    for each in logs:
        ours, made = read_log(each, names).arrays(), read_log(tmp_path / each.name, names).arrays()
        for name in names[:3]:
            np.testing.assert_allclose(ours[name], made[name], rtol=0, atol=3e-5)
        for name in names[3:]:  # 0.4 % from one processor to another
            assert np.std(np.subtract(ours[name], made[name])) < 0.01 * np.std(ours[name])


@pytest.fixture
def page() -> str:
    return PAGE.read_text()


def test_the_page_followed_literally(tmp_path: Path, page: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Every command and every file of the page in its order; gains and mass come out within three deviations."""
    monkeypatch.chdir(tmp_path)
    blocks = re.findall(r"```(\w+)(?: ([\w.]+))?\n(.*?)```", page, re.DOTALL)
    ran = 0
    for kind, name, content in blocks:
        if kind == "yaml" and name:
            Path(name).write_text(content)
        if kind != "console":
            continue
        for line in re.findall(r"^\$ (.*)$", content, re.MULTILINE):
            if line.startswith("cd "):
                monkeypatch.chdir(line.removeprefix("cd "))
            if line.startswith("gtau "):
                arguments = [
                    found
                    for each in line.split()[1:]
                    for found in (sorted(path.name for path in Path().glob(each)) if "*" in each else [each])
                ]
                printed_as_shown(gtau(*arguments), page)
                ran += 1
    assert ran >= 6
    truth = {joint: drive.gain for joint, drive in read_simulation(SOURCE / "simulation.yaml").drives.items()}
    model = json.loads(Path("result/model.json").read_text())
    for gain in model["drive_gains"]:
        assert abs(gain["value"] - truth[gain["joint"]]) < 3 * gain["std"]
        printed = re.search(rf"`{gain['joint']}` (?:is )?([\d.]+) ± ([\d.]+) N m/A", page)
        assert printed is not None
        assert float(printed[1]) == pytest.approx(gain["value"], abs=gain["std"])
        assert float(printed[1]) == pytest.approx(truth[gain["joint"]], abs=float(printed[2]))
    assert Path("result/report.html").stat().st_size > 10_000
    thresholds_as_shown()
    if GCC:
        compensation_in_c_as_shown()


def printed_as_shown(output: str, page: str) -> None:
    """Numbers of lines of the page that the command prints, by the words before them: to 3 % or two last digits."""
    numbers = re.compile(r"-?\d+(?:\.\d+)?")

    def words(line: str) -> str:
        return " ".join(numbers.sub("#", line).split())

    def values(line: str) -> list[float]:
        return [float(number) for number in numbers.findall(line)]

    for line in re.findall(r"^    (\S.*\d.*)$", page, re.MULTILINE):
        alike = [values(other) for other in output.splitlines() if words(other) == words(line)]
        rounding = [2.1 * 0.1 ** len(number.partition(".")[2]) for number in numbers.findall(line)]
        near = [np.abs(np.subtract(values(line), each)) <= np.fmax(0.03 * np.abs(each), rounding) for each in alike]
        assert any(map(np.all, near)) or not near, (line, alike)


def thresholds_as_shown() -> None:
    """The command of the section on collisions, with its validation runs in the place of the tutorial's."""
    text = (DOCS / "do" / "external-wrench.md").read_text(encoding="utf-8").split("## Collision thresholds")[1]
    (runs,) = re.findall(r"^```yaml\n(.*?)^```$", text, re.DOTALL | re.MULTILINE)
    for shown, name in {"free_1": "empty_2", "free_2": "check_1200g", "disc": "load_1200g", "2.5": "1.2"}.items():
        runs = runs.replace(shown, name)
    drafted = Path("experiment.yaml").read_text()
    Path("experiment.yaml").write_text(drafted.replace("  - log: empty_2.csv\n", "") + runs)
    (command,) = re.findall(r"^\$ gtau (export .*)$", text, re.MULTILINE)
    gtau(*command.split())
    assert len(json.loads(Path("thresholds/thresholds.json").read_text())["thresholds"]) == 2 * 3


def compensation_in_c_as_shown() -> None:
    """The whole program of the page on exports, for the tutorial's model."""
    text = (DOCS / "do" / "export-model.md").read_text(encoding="utf-8")
    program = next(
        block for block in re.findall(r"^```c\n(.*?)^```$", text, re.DOTALL | re.MULTILINE) if "main" in block
    )
    gtau("export", "result/model.json", "--to", "c", "--out", "model_c")
    Path("model_c/compensate.c").write_text(program)
    command = [GCC, "-std=c99", "-Wall", "-Wextra", "-Werror", "-O2", "compensate.c", "five_bar.c", "-lm", "-o", "made"]
    subprocess.run(command, cwd="model_c", check=True)
    printed = subprocess.run(["./made"], cwd="model_c", check=True, capture_output=True, text=True).stdout.strip()
    shown = re.search(r"/\* (-?[\d.]+ A, -?[\d.]+ A) \*/", program)
    assert shown is not None
    assert printed == shown[1]


def test_other_numbers_than_those_shown_are_found() -> None:
    printed_as_shown("scale 2.61 of 3", "text\n    scale 2.613 of 3\n")
    with pytest.raises(AssertionError, match=r"scale 2\.9"):
        printed_as_shown("scale 2.61 of 3", "text\n    scale 2.9 of 3\n")


def test_no_log_of_another_content_is_replaced(tmp_path: Path) -> None:
    first = write_tutorial(tmp_path)
    assert write_tutorial(tmp_path) == first
    first[-1].write_text("mine")
    with pytest.raises(GtauError, match=r"unknown\.csv exists already, with other content"):
        write_tutorial(tmp_path)
    assert first[-1].read_text() == "mine"
