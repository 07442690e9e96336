"""What a person meets first in Python and on the page: names, short representations, sentences, links, tables."""

from __future__ import annotations

import io
import re
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from five_bar_logs import EXPERIMENT, STEEL, Plant, write_log
from programs import wait_until

import gtau
from gtau.cli.console import progress_lines
from gtau.estimation.identify import EstimatorComparison, MethodRow
from gtau.findings import Grade
from gtau.report.gains import comparison_page
from gtau.report.terminal import plain

ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def result(tmp_path_factory: pytest.TempPathFactory) -> gtau.Result:
    folder, plant = tmp_path_factory.mktemp("face"), Plant(noise=0.01)
    write_log(folder / "free.csv", plant.run("free", seed=1))
    write_log(folder / "loaded.csv", plant.run("loaded", payload=STEEL, seed=2))
    write_log(folder / "check.csv", plant.run("check", payload=STEEL, seed=3))
    (folder / "experiment.yaml").write_text(EXPERIMENT)
    return gtau.identify(folder / "experiment.yaml")


def test_the_package_shows_its_names_and_nothing_else() -> None:
    assert dir(gtau) == sorted(gtau.__all__)
    for name in gtau.__all__:
        assert getattr(gtau, name).__doc__, name
    with pytest.raises(AttributeError, match="No gtau attribute nonsense"):
        gtau.nonsense  # noqa: B018
    with pytest.raises(AttributeError, match="gtau has no 'identfy'; did you mean 'identify'"):
        gtau.identfy  # noqa: B018
    loaded = "import sys, gtau; print(sorted({'casadi', 'numpy', 'polars', 'numba'} & set(sys.modules)))"
    environment = {"PYTHONPATH": str(ROOT / "src")}
    assert subprocess.check_output([sys.executable, "-c", loaded], env=environment, text=True) == "[]\n"


def test_representations_are_short_and_say_something(result: gtau.Result) -> None:
    robot = gtau.load_robot("orthoglide")
    model = gtau.InverseDynamics(robot)
    run = Plant().run("free")
    for each in (robot, model, run, result, result.drive_gains["left"]):
        assert len(repr(each)) < 400
    assert "'orthoglide', 15 joints" in repr(robot)
    assert "220 standard parameters" in repr(model)
    assert "'free'" in repr(run)
    assert str(result.drive_gains["left"]) in repr(result)
    assert re.fullmatch(r"2\.\d+ \+- 0\.\d+ N m/A", str(result.drive_gains["left"]))
    assert str(replace(result.drive_gains["left"], value=None)) == "not identifiable"


def test_a_name_that_is_not_there_is_answered_with_those_that_are(result: gtau.Result) -> None:
    for estimates in (result.drive_gains, result.parameters, result.essential):
        with pytest.raises(gtau.GtauError, match=r"there is no 'middle' here; choose from .*left"):
            estimates["middle"]
        assert estimates.get("middle") is None
    model = gtau.InverseDynamics(gtau.load_robot("orthoglide"))
    with pytest.raises(gtau.GtauError, match=r"no standard parameter 'm_p'; did you mean 'm_P'\?"):
        model.torques(*np.zeros((3, 1, 3)), {"m_p": 1.0})
    with pytest.raises(gtau.GtauError, match="robot 'orthoglide' has no joint '99'; choose from 11, "):
        model.robot.joint("99")
    for other, meant in (("drive_gain", "'drive_gains'"), ("to_dict", "result.to_frame()")):
        with pytest.raises(AttributeError, match=re.escape(f"a Result has no '{other}'; did you mean {meant}")):
            getattr(result, other)
    with pytest.raises(gtau.GtauError, match="write 'all' or 'inertial'"):
        gtau.InverseDynamics(gtau.load_robot("five-bar"), "some")


def test_what_is_known_only_in_sums_has_its_deviation_in_per_cent(result: gtau.Result) -> None:
    lost = replace(next(iter(result.essential.values())), value=0.1, std=0.2)

    def summary(name: str, std: float) -> str:
        return result.replaced(parameters={**others, name: replace(lost, std=std)}).summary()

    others = {name: replace(each, essential=False) for name, each in result.parameters.items()}
    assert re.search(rf"{lost.name} .* 200\.00 +kg m2", summary(lost.name, 0.2))
    assert re.search(rf"{lost.name} .* > 1000 +kg m2", summary(lost.name, 2.0))


def test_the_price_of_the_reduction(result: gtau.Result) -> None:
    text = result.replaced(statistics={**result.statistics, "reduction_loss": 1.25}).summary()
    assert "changes the torque residual of the worst joint by 1.2 %." in " ".join(text.split())


def test_a_comparison_is_data() -> None:
    gains, std = np.array([20009.0, 149920.0, 1.5]), np.array([7.0, 165.0, 0.1])
    rows = (
        MethodRow("ml", gains, std, np.ones(3), 1.0, Grade.GOOD, half_widths=2 * std),
        MethodRow("wls", gains, None, np.ones(3), 1.0),
        MethodRow("iv", refusal="no motion can be simulated"),
    )
    names = ("a", "a_joint_with_a_long_name", "c")
    page = comparison_page(EstimatorComparison(names, rows, ("N per A",) * 3, "arm"))
    found = page.sections[1].items[0]
    assert [column.title for column in found.columns[4:]] == [
        "joint a, N per A",
        "a_joint_with_a_long_name, N per A",
        "joint c, N per A",
    ]
    assert [row[:2] for row in found.rows] == [("ml", "good"), ("wls", "given"), ("iv", "refused")]
    assert found.rows[0][4:] == ((20009.0, 14.0), (149920.0, 330.0), (1.5, 0.2))
    assert [column.text(cell) for column, cell in zip(found.columns[4:], found.rows[0][4:], strict=True)] == [
        "20009 ± 14", "149920 ± 330", "1.50 ± 0.20",
    ]  # fmt: skip
    text = plain(page)
    assert max(map(len, text.splitlines())) <= 80
    assert "iv: no motion can be simulated" in text


def test_the_summary_fits_a_terminal(result: gtau.Result) -> None:
    for verbose in (False, True):
        assert max(map(len, result.summary(verbose).splitlines())) <= 80
    assert len(result.summary(verbose=False).splitlines()) <= 24


def test_without_a_terminal_a_line_a_minute_says_where_the_work_stands(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "stderr", said := io.StringIO())
    begun, every = time.monotonic(), 0.05
    with progress_lines("starting", every) as progress:
        wait_until(lambda: "starting" in said.getvalue())
        progress("simulating", 1, 4)
        wait_until(lambda: "simulating" in said.getvalue())
    lines = re.sub(r"\d+ s$", "T", said.getvalue(), flags=re.MULTILINE).splitlines()
    assert len(lines) <= (time.monotonic() - begun) / every
    assert list(dict.fromkeys(lines)) == ["gtau: starting, T", "gtau: simulating, 25 %, T"]
    monkeypatch.setattr(sys, "stderr", said := io.StringIO())
    with progress_lines("starting", every) as progress:
        progress("deriving", 0, 1)  # of which nobody knows the share
        wait_until(lambda: "deriving" in said.getvalue())
    assert "%" not in said.getvalue()
    monkeypatch.setattr(sys, "stderr", said := io.StringIO())
    with progress_lines("starting", every=60.0) as progress:
        progress("simulating", 1, 4)
    assert said.getvalue() == ""


def test_the_pages_link_to_what_is_there() -> None:
    pages = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *(ROOT / "docs").rglob("*.md")]
    for page in pages:
        text = page.read_text(encoding="utf-8")
        for target in re.findall(r"\]\(([^)\s]+)\)", text):
            path, _, anchor = target.partition("#")
            if "://" in path:
                continue
            other = page if not path else page.parent / path
            assert other.exists(), f"{page.name}: {target}"
            if anchor:
                headings = re.findall(r"^#+ (.+)$", other.read_text(encoding="utf-8"), re.MULTILINE)
                anchors = {re.sub(r"[^\w -]", "", heading.lower()).replace(" ", "-") for heading in headings}
                assert anchor in anchors, f"{page.name}: {target}"
