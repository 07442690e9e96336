"""The report of every command: what stands in it, and how it behaves in a browser."""

from __future__ import annotations

import hashlib
import json
import re
import shutil
import subprocess
from html.parser import HTMLParser
from pathlib import Path

import pytest
from five_bar_logs import EXPERIMENT, Plant, write_experiment, write_log
from typer.testing import CliRunner

from gtau.cli.commands import app
from gtau.report.page import number as plain

LEAD = {"m": 0.8, "mx": 0.1, "my": -0.05, "zz": 0.03}
DESIGN = """
robot: five-bar
rate: 500
period: 4
harmonics: 3
runs: [{payload: none}, {payload: {name: disc, mass: 1.2}}]
prior: {gains: {left: 2.5, right: 4.0}}
"""
COMMANDS = {
    "identify": "identify experiment.yaml --out identify",
    "validate": "validate identify/model.json experiment.yaml --out validate",
    "payload": "payload identify/model.json weighing.yaml --out payload",
    "compare": "compare experiment.yaml --out compare",
    "check": "check experiment.yaml --out check",
    "fleet": "fleet one/experiment.yaml two/experiment.yaml --out fleet --jobs 1",
    "watch": "watch identify/model.json free.csv --experiment experiment.yaml --out watch",
    "excite": "excite design.yaml --out excite --starts 1",
}
SECTIONS = {
    "identify": "verdict gains notes torques payloads residuals parameters friction correlation robot "
    "logs effects provenance",
    "validate": "verdict torques gains robot logs provenance",
    "payload": "verdict controller payloads gains robot provenance",
    "compare": "verdict estimators gains provenance",
    "check": "verdict notes logs joints robot motion preparation provenance",
    "fleet": "verdict joints outliers chart gains provenance",
    "watch": "verdict quantities of-load of-left of-right provenance",
    "excite": "verdict gains motion robot parameters limits assumed provenance",
}
CHROMIUM = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome", "chrome"))), None)
PROBE = """
<script>
const problems = [];
addEventListener("error", (event) => problems.push(event.message));
addEventListener("load", async () => {
  const wait = () => new Promise((done) => setTimeout(done, 50));
  const say = { page: "NAME", charts: 0, blank: 0, synced: true };
  for (let k = 0; k < 200 && !document.documentElement.dataset.ready; k += 1) await wait();
  say.ready = document.documentElement.dataset.ready;
  document.querySelectorAll("details").forEach((each) => { each.open = true; });
  const blank = () => [...document.querySelectorAll(".chart")].some((chart) => !chart.plot);
  for (let k = 0; k < 200 && blank(); k += 1) await wait();
  for (let k = 0; k < 10; k += 1) await wait();
  for (const chart of document.querySelectorAll(".chart")) {
    say.charts += 1;
    if (!chart.plot || chart.plot.width < 100 || !chart.querySelector("canvas")) say.blank += 1;
  }
  for (const button of document.querySelectorAll("button[data-zoom=in]")) {
    button.click();
    await wait();
    const mine = (each) => JSON.parse(each.dataset.chart).group === button.dataset.group;
    const group = [...document.querySelectorAll(".chart")].filter(mine);
    const ranges = group.map((each) => [each.plot.scales.x.min, each.plot.scales.x.max].join());
    const time = group[0].plot.data[0], [low, high] = ranges[0].split(",").map(Number);
    const half = (high - low) / (time[time.length - 1] - time[0]);
    say.synced &&= new Set(ranges).size === 1 && Math.abs(half - 0.5) < 0.01;
  }
  const table = document.querySelector("#parameter-table");
  const input = document.querySelector("[data-table=parameter-table]");
  if (table) {
    const rows = () => [...table.tBodies[0].rows].filter((row) => !row.hidden);
    input.value = "fv_ right"; input.dispatchEvent(new Event("input"));
    say.found = rows().map((row) => row.cells[0].textContent);
    input.value = ""; input.dispatchEvent(new Event("input"));
    table.tHead.rows[0].cells[1].click();
    const values = rows().map((row) => Number(row.cells[1].dataset.value || Infinity));
    say.sorted = values.length > 3 && values.every((value, k) => k === 0 || values[k - 1] <= value);
  }
  const background = () => getComputedStyle(document.body).backgroundColor;
  say.themes = [background()];
  document.getElementById("theme").click();
  say.themes.push(background());
  for (const event of ["beforeprint", "afterprint"]) { dispatchEvent(new Event(event)); say.themes.push(background()); }
  const seen = (each) => each.getBoundingClientRect().right <= document.documentElement.clientWidth;
  say.verdicts = [...document.querySelectorAll("td .badge")].map(seen);
  say.wide = document.documentElement.scrollWidth - document.documentElement.clientWidth;
  say.problems = problems;
  console.log("probe" + JSON.stringify(say));
});
</script>
"""


@pytest.fixture(scope="module")
def reports(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder in which every command can write its report."""
    folder = tmp_path_factory.mktemp("reports")
    plant = Plant(delays=(1e-3, 1e-3), noise=0.01)
    write_experiment(folder, plant)
    write_log(folder / "unknown.csv", plant.run("unknown", payload=LEAD, seed=4))
    experiment = EXPERIMENT.replace("name: steel", 'name: "<b>steel & co"')
    (folder / "experiment.yaml").write_text(experiment)
    loaded = 'loaded.csv, payload: {name: "<b>steel & co", mass: 1.2}'
    assert loaded in experiment
    (folder / "weighing.yaml").write_text(experiment.replace(loaded, "unknown.csv, payload: {name: lead}"))
    (folder / "design.yaml").write_text(DESIGN)
    for robot in ("one", "two"):
        (folder / robot).mkdir()
        for name in ("free.csv", "loaded.csv", "check.csv", "experiment.yaml"):
            (folder / robot / name).symlink_to(folder / name)
    return folder


class Links(HTMLParser):
    """What a page would load, and the ids of its sections."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.loaded: list[str] = []
        self.sections: list[str] = []
        self.text = ""
        self.feed(text)

    def handle_starttag(self, tag: str, attributes: list[tuple[str, str | None]]) -> None:
        values = dict(attributes)
        if tag == "section":
            self.sections.append(values["id"] or "")
        self.loaded += [
            value
            for name, value in values.items()
            if name in ("src", "href", "srcset", "data") and value and not value.startswith(("#", "data:"))
        ]

    def handle_data(self, data: str) -> None:
        self.text += data


def text_of(reports: Path, command: str) -> str:
    """The report of a command, which runs where it has not yet; two of them read the model of the first."""
    file = reports / command / "report.html"
    if command in ("validate", "payload", "watch"):
        text_of(reports, "identify")
    if not file.exists():
        with pytest.MonkeyPatch.context() as patch:
            patch.chdir(reports)
            patch.setattr("gtau.estimation.identify.NAMES", ("ml", "wls"))
            patch.setattr("sys.argv", ["gtau", *COMMANDS[command].split()])
            done = CliRunner().invoke(app, COMMANDS[command].split())
        assert done.exit_code == 0, done.stderr
        assert f"written: {command}/report.html" in done.stdout
    return file.read_text(encoding="utf-8")


@pytest.mark.parametrize("command", COMMANDS)
def test_a_report_is_one_file_with_its_sections(reports: Path, command: str) -> None:
    text = text_of(reports, command)
    page = Links(text)
    assert page.loaded == []
    assert "@import" not in text
    assert not re.search(r"url\(\s*['\"]?http", text)
    assert page.sections == SECTIONS[command].split()
    assert len(text) < 5e6
    assert COMMANDS[command] in page.text  # the command that reproduces it
    assert "<b>steel" not in text  # names are text, not markup


def test_the_page_on_reports_lists_every_section(reports: Path) -> None:
    page = (Path(__file__).parents[2] / "docs" / "do" / "identify.md").read_text(encoding="utf-8")
    titles = re.findall(r"<h2>(.*?)</h2>", text_of(reports, "identify"))
    assert len(titles) == len(SECTIONS["identify"].split())
    assert set(titles) <= set(re.findall(r"[\s(]\*\[?(\w[^]*]+)", page.split("## Read the report")[1]))


def test_the_report_shows_the_numbers_of_the_model(reports: Path) -> None:
    text = text_of(reports, "identify")
    for words in ("largest torque residual of the rows used", "Torque errors of every run", "at all samples"):
        assert words in text
    page = Links(text_of(reports, "identify"))
    model = json.loads((reports / "identify" / "model.json").read_text())
    for gain in model["drive_gains"]:
        assert plain(gain["value"]) in page.text
    for each in model["parameters"]:
        assert each["name"] in page.text
    for log in ("experiment.yaml", "free.csv", "loaded.csv", "check.csv"):
        assert hashlib.sha256((reports / log).read_bytes()).hexdigest() in page.text
    assert re.search("Both drive gains|[12] of 2 drive gains", page.text)
    assert "payload '<b>steel & co' of 1.2 kg" in page.text


@pytest.fixture(scope="module")
def probed(reports: Path) -> dict[str, dict]:
    """What every page says of itself in headless Chromium, all in one window and without a network."""
    if CHROMIUM is None:
        pytest.skip("no Chromium is installed (Debian: apt install chromium)")
    frames = []
    for name in COMMANDS:
        copy = reports / name / "probed.html"
        text = text_of(reports, name).replace("<head>", "<head>" + PROBE.replace("NAME", name), 1)
        copy.write_text(re.sub(r'<meta http-equiv="Content-Security-Policy"[^>]*>', "", text))
        frames.append(f'<iframe src="{name}/probed.html" style="width:375px;height:700px"></iframe>')
    (reports / "frames.html").write_text("".join(frames))
    options = "--headless=new --no-sandbox --disable-gpu --enable-logging=stderr --virtual-time-budget=30000"
    offline = "--host-resolver-rules=MAP * ~NOTFOUND"
    window = ["--window-size=3000,900", "--dump-dom", (reports / "frames.html").as_uri()]
    done = subprocess.run([CHROMIUM, *options.split(), offline, *window], capture_output=True, text=True, timeout=120)
    console = [line for line in done.stderr.splitlines() if "CONSOLE" in line]
    said = [json.loads(found[1]) for found in map(PROBED.search, console) if found]
    assert [line for line in console if not PROBED.search(line)] == []
    return {each["page"]: each for each in said}


PROBED = re.compile(r'"probe(\{.*\})", source')


@pytest.mark.parametrize("command", COMMANDS)
def test_a_report_in_a_browser(probed: dict[str, dict], command: str) -> None:
    said = probed[command]
    assert said["ready"] == "yes"
    assert said["problems"] == []
    assert said["blank"] == 0
    assert (said["charts"] > 0) == (command in ("identify", "validate", "check", "excite"))
    assert said["synced"]
    light, dark, paper, after = said["themes"]
    assert (paper, after) == (light, dark)
    assert light != dark
    assert said["wide"] <= 0  # nothing sticks out at the width of a phone
    assert all(said["verdicts"])  # and no verdict is out of sight
    assert said["verdicts"] or command not in ("identify", "compare", "fleet")


def test_the_table_of_parameters_searches_and_sorts(probed: dict[str, dict]) -> None:
    said = probed["identify"]
    assert said["found"] == ["fv_right", "fv_right_forearm"]
    assert said["sorted"]
