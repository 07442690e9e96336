"""Results in notebooks: their own views, figures in one call, tables."""

from __future__ import annotations

import subprocess
import sys
from html.parser import HTMLParser
from importlib import import_module
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from five_bar_logs import JOINTS, Plant, write_experiment

import gtau
from gtau import _SHOWN, _html as html, _register as register
from gtau.errors import GtauError
from gtau.estimation.identify import EstimatorComparison, MethodRow
from gtau.findings import Grade
from gtau.report.page import number as plain
from gtau.report.robot import distances_panels
from gtau.result import check

PRIOR = {"left": 2.4, "right": 4.1}


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_experiment(tmp_path_factory.mktemp("notebook"), Plant(noise=0.01)).parent


@pytest.fixture(scope="module")
def result(folder: Path) -> gtau.Result:
    return gtau.identify(folder / "experiment.yaml")


class Frame(HTMLParser):
    """The page in a frame."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.page = ""
        self.feed(text)

    def handle_starttag(self, tag: str, attributes: list[tuple[str, str | None]]) -> None:
        assert tag == "iframe"
        self.page = dict(attributes)["srcdoc"] or ""


def test_results_show_themselves(result: gtau.Result, folder: Path) -> None:
    page = Frame(result._repr_html_()).page
    assert plain(result.drive_gains["left"].value or 0.0) in page
    assert "Payload &#39;steel&#39;" in page
    assert "uPlot=" not in page  # no chart, no script for charts
    gains = Frame(html(result.drive_gains)).page
    assert gains.count("<tr>") == 3
    prediction = Frame(html(result.predict(result.data[0]))).page
    assert prediction.count('class="chart"') == 4  # torques and residuals
    assert "uPlot=" in prediction
    assert """new Intl.NumberFormat(_?"en-US":"en-US")""" in prediction  # whatever the browser's language is called
    assert "9.9" in Frame(html(check(folder / "experiment.yaml"))).page  # s of every log
    payload = Frame(html(result.payloads[0])).page
    assert "Payload &#39;steel&#39;" in payload


def test_ipython_shows_what_has_a_page() -> None:
    shown: dict[tuple[str, str], object] = {}
    formatter = SimpleNamespace(for_type_by_name=lambda module, name, show: shown.update({(module, name): show}))
    register(SimpleNamespace(display_formatter=SimpleNamespace(formatters={"text/html": formatter})))
    assert set(shown.values()) == {html}
    for module, name in shown:
        assert isinstance(getattr(import_module(module), name), type)
    assert len(shown) == len(_SHOWN)


def test_a_comparison_shows_itself_and_is_a_table() -> None:
    gains, std, residuals = np.array([2.5, 4.0]), np.array([0.01, 0.02]), np.array([1.0, 2.0])
    found = EstimatorComparison(
        JOINTS,
        (
            MethodRow("ml", gains, std, residuals, 0.1, Grade.GOOD, half_widths=2 * std),
            MethodRow("iv", refusal="no motion can be simulated"),
        ),
    )
    page = Frame(html(found)).page
    assert "2.500 ± 0.020" in page
    assert "refused" in page
    frame = found.to_frame()
    assert frame["gain"].to_list() == [2.5, 4.0, None, None]
    assert frame["refusal"].to_list() == [None, None, *["no motion can be simulated"] * 2]
    assert frame["verdict"].to_list() == ["good", "good", None, None]


def test_estimates_as_a_table(result: gtau.Result) -> None:
    frame = result.to_frame()
    gains = frame.filter(frame["group"] == "drive gain")
    assert gains["name"].to_list() == list(JOINTS)
    assert gains["value"].to_list() == [gain.value for gain in result.drive_gains.values()]
    assert [gains["low"][0], gains["high"][0]] == list(result.drive_gains["left"].interval() or ())
    parameters = frame.filter(frame["essential"].is_not_null())
    assert sorted(parameters["name"]) == sorted(result.parameters)
    for name, value, std, kept in parameters.select("name", "value", "std", "essential").iter_rows():
        each = result.parameters[name]
        assert (value, std, kept) == (each.value, each.std, name in result.essential)
    assert "payload steel of loaded" in frame["group"].to_list()
    columns = frame.to_dict(as_series=False)  # which pandas takes without pyarrow
    assert {type(value) for column in columns.values() for value in column} == {str, float, bool, type(None)}


def test_a_prediction_as_a_table(result: gtau.Result) -> None:
    prediction = result.predict(result.data[0])
    frame = prediction.to_frame()
    np.testing.assert_array_equal(frame["motor_right"].to_numpy(), prediction.measured[:, 1])
    np.testing.assert_array_equal(frame["usable_right"].to_numpy(), prediction.keep[:, 1])
    np.testing.assert_array_equal(frame["t"].to_numpy(), prediction.time)


def test_figures_in_one_call(result: gtau.Result) -> None:
    plot = result.plot
    calls = [plot.gains(PRIOR), plot.torques("left"), plot.residuals("right"), plot.correlation()]
    calls += [plot.singular_values(), plot.distances()]
    for figure in calls:
        assert figure._repr_png_().startswith(b"\x89PNG")
    whole = plot.torques()
    assert [axes.get_title(loc="left") for axes in whole.axes[::2]] == ["free: joint left", "joint right"]
    part = plot.torques("right", run="loaded", start=2.0, stop=4.0)
    assert part.axes[0].get_title(loc="left") == "loaded, 2 to 4 s of 9.998 s: joint right"
    times = part.axes[0].get_lines()[0].get_xdata()
    assert 2.0 <= min(times) < max(times) <= 4.0
    key = [text.get_text() for text in part.legends[0].get_texts()]
    assert "current reference" not in key
    assert "not used: near reversals, gaps, repairs" in key
    assert "Blue: positive, orange: negative" in plot.correlation().get_supxlabel()


def test_distances_of_an_arm_have_one_type() -> None:
    along = {"time": np.arange(3.0), "type_1": np.full(3, 0.9)}
    (arm,) = distances_panels([("run", 0.0, along | {"type_2": np.full(3, np.nan)})])
    (linkage,) = distances_panels([("run", 0.0, along | {"type_2": np.ones(3)})])
    assert [panel.y.label for panel in (arm, linkage)] == ["type 1 (serial)", "distance"]


def test_what_cannot_be_drawn(result: gtau.Result, folder: Path, tmp_path: Path) -> None:
    with pytest.raises(GtauError, match="there is no joint '13'; choose from left, right"):
        result.plot.torques("13")
    with pytest.raises(TypeError, match="not iterable"):
        list(result)
    with pytest.raises(GtauError, match="there is no joint 'x'; choose from left, right"):
        result.plot.gains({"x": 2.4})
    with pytest.raises(GtauError, match="there is no run 'nope'; choose from free, loaded"):
        result.plot.torques("left", run="nope")
    with pytest.raises(GtauError, match=r"from 4 to 2 s is empty"):
        result.plot.torques("left", start=4.0, stop=2.0)
    result.save(tmp_path / "model.json")
    loaded = gtau.load(tmp_path / "model.json")
    for call in (lambda: loaded.plot.torques("left"), loaded.plot.singular_values, loaded.plot.distances):
        with pytest.raises(GtauError, match="loaded from a file"):
            call()
    assert loaded.plot.torques("left", run=result.data[0]).axes[0].get_title(loc="left") == "free: joint left"


def test_a_report_from_python(result: gtau.Result, tmp_path: Path) -> None:
    result.report(tmp_path / "own.html")
    text = (tmp_path / "own.html").read_text()
    assert '<section id="torques">' in text
    assert "command that reproduces" not in text  # there was none


def test_singular_values_are_those_of_the_whole_system(result: gtau.Result) -> None:
    values = np.array(result.singular_values)
    assert np.all(np.diff(values) <= 0)
    assert values.min() > 0
    columns = len(result.covariance_names) - len(JOINTS) + 1  # parameters, gains and the known payload, no delays
    assert len(values) == columns
    assert np.sum(values**2) == pytest.approx(columns)  # columns of unit length


def test_estimation_alone_imports_no_report() -> None:
    code = (
        "import sys, gtau; gtau.Result, gtau.identify; print([name for name in sys.modules if 'gtau.report' in name])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"
