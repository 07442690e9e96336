"""The page, driven in Chromium as users drive it, and its door, tried without a token."""

import json
import os
import re
import shutil
import signal
import subprocess
import sys
import time
from functools import partial
from urllib.error import HTTPError
from urllib.request import Request, urlopen

import numpy as np
import pytest

from gtau.doors.project import Project
from gtau.errors import GtauError

pytest.importorskip("nicegui", reason="the page needs gtau[app]")

LOGS = ("empty_1.csv", "empty_2.csv", "loaded_1200g.csv")
OPTIONS = (
    "--headless=new --no-sandbox --disable-gpu --disable-quic --no-first-run --disable-background-networking "
    "--disable-component-update --disable-sync --window-size=1280,1200"
)


@pytest.fixture(scope="module")
def tutorial(tmp_path_factory):
    folder = tmp_path_factory.mktemp("tutorial")
    subprocess.run([sys.executable, "-m", "gtau", "tutorial", str(folder)], check=True, capture_output=True)
    return folder


class Server:
    """The page of a folder."""

    def __init__(self, folder):
        arguments = [sys.executable, "-m", "gtau", "app", str(folder), "--no-browser"]
        environment = {name: value for name, value in os.environ.items() if not name.startswith("PYTEST")}
        pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
        heed = partial(signal.signal, signal.SIGINT, signal.SIG_DFL)  # what jobs in the background start ignores it
        self.process = subprocess.Popen(  # NiceGUI serves no test
            arguments, env=environment, text=True, preexec_fn=heed, **pipes
        )
        self.address = re.search(r"http://\S+", self.process.stdout.readline())[0]
        self.origin, self.token = self.address.split("/?token=")
        for _ in range(100):
            try:
                self.get(f"/?token={self.token}")
                return
            except OSError:
                time.sleep(0.2)

    def get(self, path, **headers):
        """Fetch a path: its status and text."""
        try:
            with urlopen(Request(self.origin + path, headers=headers), timeout=10) as answer:
                return answer.status, answer.read().decode()
        except HTTPError as error:
            return error.code, error.read().decode()

    def end(self):
        """End the page as Ctrl-C does, and return what it said."""
        self.process.send_signal(2)
        return self.process.communicate(timeout=20)[1]


@pytest.fixture
def project(tmp_path):
    (tmp_path / "project").mkdir()
    server = Server(tmp_path / "project")
    server.folder = tmp_path / "project"
    yield server
    if server.process.poll() is None:
        server.end()


def test_the_door_opens_to_the_token_alone(project):
    (project.folder.parent / "secret.txt").write_text("secret")
    (project.folder / "link.txt").symlink_to(project.folder.parent / "secret.txt")
    (project.folder / "mine.txt").write_text("mine")
    held = {"Cookie": f"gtau_{project.origin.rpartition(':')[2]}={project.token}"}

    assert project.get("/")[0] == 403
    assert "gtau app" in project.get("/?token=wrong")[1]
    assert project.get("/files/mine.txt") == (403, project.get("/")[1])
    assert project.get("/files/mine.txt", **held) == (200, "mine")
    for outside in ("/files/../secret.txt", "/files/..%2Fsecret.txt", "/files/link.txt", "/files//etc/hostname"):
        status, text = project.get(outside, **held)
        assert status in (403, 404)
        assert "secret" not in text or "outside" in text
    assert project.get("/files/mine.txt", Host="attacker.example", **held)[0] == 403
    assert project.get("/files/mine.txt", Origin="http://attacker.example", **held)[0] == 403

    said = project.end()
    assert "the page is closed" in said
    assert "Traceback" not in said


@pytest.fixture(scope="module")
def chromium():
    webdriver = pytest.importorskip("selenium.webdriver", reason="the page is driven by selenium")
    browser, driver = (shutil.which(name) for name in ("chromium", "chromedriver"))
    if browser is None or driver is None:
        pytest.skip("no Chromium with its driver is installed (Debian: apt install chromium chromium-driver)")
    options = webdriver.ChromeOptions()
    options.binary_location = browser
    for option in OPTIONS.split():
        options.add_argument(option)
    chromium = webdriver.Chrome(options=options, service=webdriver.ChromeService(driver))
    yield chromium
    chromium.quit()


class Hand:
    """What a user does with the page."""

    def __init__(self, chromium, address):
        self.browser = chromium
        chromium.get(address)
        self.until(lambda: self.browser.find_elements("css selector", "input[type=file]"))

    @property
    def text(self):
        """All words of the page."""
        return self.browser.find_element("css selector", "body").text

    def until(self, true, seconds=60):
        """Wait until something is true; elements that vanish meanwhile are looked for again."""
        from selenium.common.exceptions import WebDriverException

        end = time.monotonic() + seconds
        while time.monotonic() < end:
            try:
                if (value := true()) is not None and value is not False and value != []:
                    return value
            except WebDriverException:
                pass
            time.sleep(0.2)
        raise AssertionError(f"the page never came there; it says: {self.text}")

    def press(self, selector, words=""):
        """Press the first element of a selector whose text begins with some words."""

        def pressed():
            for element in self.browser.find_elements("css selector", selector):
                if element.text.strip().startswith(words):
                    self.browser.execute_script("arguments[0].scrollIntoView({block: 'center'})", element)
                    element.click()
                    return True
            return False

        self.until(pressed)

    def choose(self, label, option):
        """Choose an option of a drop-down by the keyboard."""
        backspace, down, enter = "\ue003", "\ue015", "\ue007"

        def first():
            items = self.browser.find_elements("css selector", ".q-menu .q-item")
            return items[0].text if items else ""

        def chosen():
            field = self.browser.find_element("css selector", f'input[aria-label="{label}"]')
            self.browser.execute_script("arguments[0].scrollIntoView({block: 'center'})", field)
            field.click()
            field.send_keys(backspace * 40 + option)
            self.until(lambda: first() == option, 10)
            field.send_keys(down + enter)
            return True

        self.until(chosen)

    def drop(self, place, *files):
        """Drop files."""
        self.browser.find_elements("css selector", "input[type=file]")[place].send_keys("\n".join(map(str, files)))

    def sees(self, words, seconds=60):
        """Wait for words."""
        self.until(lambda: words in self.text, seconds)


@pytest.mark.slow
def test_a_wrong_column_is_corrected_beside_its_plot(project, chromium, tutorial):
    hand = Hand(chromium, project.address)
    hand.drop(1, *(tutorial / log for log in LOGS))
    hand.sees("Logs: ")
    hand.press("button", "Draft")
    hand.sees("no robot is chosen")
    hand.choose("Robot", "five-bar")
    hand.sees("2 driven joints")
    hand.press("button", "Draft")
    hand.sees("Check the logs")

    hand.press(".q-expansion-item .q-item", "")
    hand.choose("vleft", "current right")
    hand.until(lambda: "{right: vleft}" in (project.folder / "experiment.yaml").read_text())
    hand.press("button", "Identify")
    hand.sees("joint 'left' has a position but no current")
    hand.choose("vleft", "current left")
    hand.until(lambda: "left: vleft" in (project.folder / "experiment.yaml").read_text())
    hand.choose("vright", "current right")
    hand.until(lambda: "right: vright" in (project.folder / "experiment.yaml").read_text())
    assert "Traceback" not in (said := project.end()), said


@pytest.mark.slow
def test_from_an_empty_page_to_a_weighed_payload(project, chromium, tutorial):
    hand = Hand(chromium, project.address)
    hand.choose("Robot", "five-bar")
    hand.sees("2 driven joints")
    hand.drop(1, *(tutorial / log for log in LOGS))
    hand.press("button", "Draft")
    hand.press("button", "Check the logs")
    hand.sees("The logs were checked, without findings.")
    hand.press("button", "Identify")
    hand.sees("Weigh it")
    gains = json.loads((project.folder / "result" / "model.json").read_text())["drive_gains"]
    assert len(gains) == 2

    hand.drop(1, tutorial / "unknown.csv")
    hand.press("button", "Weigh its load")
    hand.sees("unknown: ")
    mass = float(re.search(r"unknown: (\S+) kg", hand.text)[1])
    assert mass == pytest.approx(0.74, abs=0.01)
    assert "Traceback" not in (said := project.end()), said


@pytest.mark.slow
def test_a_refused_log_cancel_and_a_reload_in_mid_run(project, chromium, tutorial):
    size = {"width": 375, "height": 800, "deviceScaleFactor": 1, "mobile": False}
    nonsense = project.folder.parent / "nonsense.csv"
    nonsense.write_text("a,b\n1,2\n")
    hand = Hand(chromium, project.address)
    hand.choose("Robot", "five-bar")
    hand.sees("2 driven joints")
    hand.drop(1, nonsense)
    hand.sees("Logs: nonsense.csv")
    binary = project.folder / "binary.csv"
    binary.write_bytes(b"a,b\n\xff\xfe\x00,3\n")
    hand.sees("binary.csv, nonsense.csv")
    hand.press("button", "Draft")
    hand.sees("binary.csv is a binary file")
    binary.unlink()
    hand.until(lambda: "binary.csv, " not in hand.text)
    hand.press("button", "Draft")
    hand.sees("nonsense.csv has 1 sample")
    hand.drop(1, *(tutorial / log for log in LOGS))
    strange = project.folder / "a_strange.csv"  # then the file is drafted without columns
    strange.write_text((tutorial / LOGS[0]).read_text().replace("t,qleft,qright,vleft,vright", "t,a,b,c,d"))
    hand.press("button", "Draft without nonsense.csv")
    hand.sees("a_strange.csv: no columns of positions are recognised")
    hand.press("button", "Draft without a_strange.csv")
    hand.until(lambda: [run.log for run in Project(project.folder).runs()] == list(LOGS))
    hand.sees("Check the logs")
    chromium.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", size)
    hand.until(lambda: chromium.execute_script("return window.innerWidth") == 375)
    wide = "return document.scrollingElement.scrollWidth - document.scrollingElement.clientWidth"
    hand.until(lambda: chromium.execute_script(wide) == 0)
    (scene,) = chromium.find_elements("css selector", ".nicegui-scene canvas")
    hand.until(lambda: scene.rect["x"] + scene.rect["width"] <= 360)
    chromium.execute_cdp_cmd("Emulation.clearDeviceMetricsOverride", {})
    hand.press("button", "They are torques")
    hand.sees("Unit of torque")
    hand.press("button", "Identify")
    hand.until(
        lambda: chromium.find_elements("xpath", "//button[.//text()='Cancel' and not(contains(@style, 'none'))]")
    )
    hand = Hand(chromium, project.address)  # reloaded, it still runs
    hand.press("button", "Cancel")
    hand.sees("interrupted; unfinished files were not written")
    assert not (project.folder / "result" / "model.json").exists()
    hand.press("button", "Identify")
    hand.sees("Weigh it")


@pytest.mark.slow
def test_a_log_of_300_mb_and_the_same_name_twice(project, chromium):
    large = project.folder.parent / "large.csv"
    rows = "".join(f"{row}\n" for row in np.random.default_rng(0).normal(size=(20_000, 1)).ravel().round(9))
    with large.open("w") as file:
        file.write("q\n")
        while file.tell() < 300e6:
            file.write(rows)
    hand = Hand(chromium, project.address)
    hand.drop(1, large)
    hand.sees("Logs: large.csv", 180)
    assert (project.folder / "large.csv").stat().st_size == large.stat().st_size
    hand.drop(1, large)
    hand.sees("is in the folder already", 180)


@pytest.mark.parametrize(
    "content",
    [
        *(b"- a", b"words", b"runs: 3", b"runs: [a]", b"runs:\n  -\n", b"runs: [1", b"robot: \xff", b"signals: 3"),
        *(b"runs: [{log: a, payload: 3}]", b"runs: [{log: a, payload: {mass: heavy}}]", b"units: [deg]"),
        b"units: {position: 3}",
    ],
)
def test_an_experiment_file_that_a_hand_has_broken_is_refused(tmp_path, content):
    (tmp_path / "experiment.yaml").write_bytes(content)
    project = Project(tmp_path)
    assert project.version
    with pytest.raises(GtauError, match=r"experiment\.yaml"):
        project.runs()


def test_keys_without_values_are_none(tmp_path):
    (tmp_path / "experiment.yaml").write_text("robot: [a]\nsignals:\nunits:\nruns:\n")
    project = Project(tmp_path)
    project.set_unit("position", "deg")
    project.set_role("q1", "position left")
    project.add_run("a.csv")
    with pytest.raises(GtauError, match="is no unit"):
        project.set_unit("position", "{left: deg")
    assert project.robot() == "['a']"
    assert project.unit("position") == "deg"
    assert [run.log for run in project.runs()] == ["a.csv"]


@pytest.mark.parametrize(("was", "now"), [("current", "torque"), ("torque", "current")])
def test_currents_become_torques_and_comments_stay(tmp_path, was, now):
    text = "signals:\n  {0}: {{left: a}}{1}\n\n# units\nunits:\n  position: deg\n"
    point = "# CHECK: confirm whether"
    (tmp_path / "experiment.yaml").write_text(text.format(was, f"  {point}") + f"  {was}: mA\n")
    project = Project(tmp_path)
    project.exchange(*project.points())
    assert project.text == text.format(now, "")


def test_without_the_extra_one_sentence_says_what_to_install(tmp_path):
    program = "import sys; sys.modules['nicegui'] = None; from gtau.cli import main; main()"
    run = subprocess.run([sys.executable, "-c", program, "app", str(tmp_path)], capture_output=True, text=True)
    assert run.returncode == 2
    assert "gtau[app]" in run.stderr


def test_a_file_in_the_place_of_the_folder_is_refused(tmp_path):
    (tmp_path / "no").write_text("a file")
    run = subprocess.run([sys.executable, "-m", "gtau", "app", str(tmp_path / "no")], capture_output=True, text=True)
    assert run.returncode == 2
    assert "cannot be made (File exists)" in run.stderr
