"""Pages as data, and what each renderer makes of them."""

from __future__ import annotations

import re
from itertools import pairwise
from xml.etree import ElementTree

import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import to_hex, to_rgb

from gtau.model.home import load_robot
from gtau.report.chart import MINUS, Axis, Chart, Panel, Rule, Series, colour, envelope, intervals
from gtau.report.charts import figure_of, palette
from gtau.report.html import arrays_for, frame, html, spec_of, words as in_html
from gtau.report.page import Column, Facts, Kind, Page, Section, Table, Text
from gtau.report.svg import svg_of
from gtau.report.terminal import plain
from gtau.report.torques import stretches

NASTY = '<b onclick="x">$steel & co</b>'
COLUMNS = (
    Column("joint"),
    Column("verdict", Kind.BADGE),
    Column("gain", Kind.NUMBER, 5),
    Column("95 % interval", Kind.INTERVAL),
    Column("std, %", Kind.NUMBER, decimals=2, most=1000.0),
)
ROWS = (
    ("left", "good", 2.6128, (2.597, 2.629), 0.61),
    (NASTY, "not identifiable", None, None, 4321.0),
    ("right", "weak", float("nan"), None, "known"),
)
FACTS, FOLDED = Facts({"file": NASTY}), Section("folded", Text("inside"), folded=True)


def lines_of(time: np.ndarray, count: int = 2) -> tuple[Series, ...]:
    return tuple(Series(f"joint {k}", time, np.sin(time + k), colour(k)) for k in range(count))


@pytest.fixture
def whole() -> Page:
    time = np.linspace(0.0, 5.0, 400)
    live = Chart(
        (Panel(Axis("time, s"), Axis("torque, N m"), lines_of(time), NASTY, shaded=np.array([1.0, 2.0])),), live=True
    )
    still = Panel(
        Axis("frequency, Hz", log=True),
        Axis("density", log=True),
        lines_of(1 + time),
        rules=(Rule(x=2.0, label=NASTY),),
    )
    return Page(
        f"Page of {NASTY}",
        Section("Verdict", Text(NASTY, ("a weak joint: use 3 % more",), "weak"), id="verdict"),
        Section("Gains", Table(COLUMNS, ROWS, name="gains-table", faint=frozenset([1])), FACTS, id="gains"),
        Section("Charts", live, Chart((still,), columns=2), FOLDED, id="charts"),
        None,
        Section("empty", None),
        lead=[NASTY],
    )  # fmt: skip


@pytest.mark.parametrize(
    ("column", "cell", "text", "key"),
    [
        (Column("x", Kind.NUMBER), 0.000012345, "1.234e-5", 1.2345e-05),
        (Column("x", Kind.NUMBER), 12, "12", 12.0),
        (Column("x", Kind.NUMBER, missing="at rest"), float("nan"), "at rest", None),
        (Column("x", Kind.NUMBER), "given", "given", None),
        (Column("x", Kind.SHARE, decimals=0), 0.834, "83", 0.834),
        (Column("x", Kind.INTERVAL), (1.23456, 1.25456), "1.2346 to 1.2546", 0.02),
        (Column("x", Kind.SPREAD), (2.50312, 0.0042), "2.5031 ± 0.0042", 2.50312),
        (Column("x", Kind.NUMBER, decimals=2, most=1000.0), 4321.0, "> 1000", 4321.0),
        (Column("x"), None, "-", None),
    ],
)
def test_a_cell_is_a_value_that_its_column_writes(column: Column, cell: object, text: str, key: float | None) -> None:
    assert column.text(cell) == text
    assert column.sort_key(cell) == (None if key is None else pytest.approx(key))


def test_a_page_holds_only_what_is_there(whole: Page) -> None:
    assert [part.id for part in whole.sections] == ["verdict", "gains", "charts"]


# Terminal


def test_the_terminal_is_plain_text_of_80_columns(whole: Page) -> None:
    columns = [Column("name"), *(Column(f"joint number {k}, N m/A", Kind.NUMBER) for k in range(12))]
    rows = [[f"row {r}", *(1000.0 + k for k in range(12))] for r in range(2)]
    wide = Page(whole.title, *whole.sections, Section("Wide", Table(columns, rows)), lead=whole.lead)
    text = plain(wide)
    assert max(map(len, text.splitlines())) <= 80
    assert text.isascii()
    assert "\x1b" not in text
    assert re.search(r"^left +good +2.6128 +2.597 to 2.629 +0.61$", text, re.MULTILINE)
    assert text.count("row 1") > 1  # a table too wide is broken, and repeats its first column
    assert sum(line.count("1005") for line in text.splitlines()) == 2  # and no number twice
    assert NASTY in text
    assert "inside" in text


def test_no_line_breaks_between_a_number_and_its_unit_or_within_a_unit() -> None:
    columns = [Column("joint"), Column("limits"), *(Column(f"gain of {k}, N m/A", Kind.NUMBER) for k in range(6))]
    limits = "1.571 to 2.618 rad, 6 rad/s, 100 rad/s2, 30 N m, 5 %"
    lines = plain(Page("", Section("", Table(columns, [["left", limits, *6 * [2.5]]])))).splitlines()
    assert max(map(len, lines)) <= 80
    assert sum(line.count("N m/A") for line in lines) == 6
    for kept in ("2.618 rad", "6 rad/s", "100 rad/s2", "30 N m", "5 %"):
        assert any(kept in line for line in lines), kept
    for words in (plain(Page("", Section("", Text(f"{'x' * k} 30 N m")))) for k in range(60, 80)):
        assert "30 N m" in words


def test_a_path_stays_in_one_piece() -> None:
    path = "/somewhere/" + "very-long-name/" * 8 + "log.csv"
    assert path in plain(Page("", Section("", Text(f"cannot read {path} at all"))))


def test_findings_are_listed_by_severity() -> None:
    columns = (Column("grade", Kind.BADGE), Column("where"), Column("what", Kind.SENTENCE), Column("do", Kind.SENTENCE))
    rows = [("warning", "free", "it is held", "log faster"), ("information", "", "a clock", "")]
    text = plain(Page("", Section("Findings", Table(columns, rows, listed=True))))
    assert text.splitlines()[1:] == [
        "Warning:",
        "- free: it is held; log faster",
        "Information:",
        "- a clock",
    ]


def test_no_zero_is_negative() -> None:
    assert Column("moved", Kind.NUMBER, decimals=2).text(-0.001) == "0.00"
    assert Column("position", Kind.INTERVAL).text((-3.0, -0.01)) == "-3.0 to 0.0"


# HTML


def test_texts_have_signs_of_numbers_and_names_that_break() -> None:
    assert in_html("-1 to -0.5 (-3), run-2, a-1/-5, 2e-5") == (
        f"{MINUS}1 to {MINUS}0.5 ({MINUS}3), run-2, a-1/-5, 2e{MINUS}5"
    )
    assert in_html("by --reset (gtau use LOG)") == 'by <span class="option">--reset</span> (<code>gtau use LOG</code>)'
    assert in_html("wrist_3 <b> +-3 %") == "wrist_<wbr>3 &lt;b&gt; \N{PLUS-MINUS SIGN}3\N{NO-BREAK SPACE}%"


def test_html_escapes_everything_and_loads_nothing(whole: Page) -> None:
    text = html(whole)
    assert "<b onclick" not in text
    assert "&lt;b onclick" in text
    assert not re.search(r"(src|href)=\"(?!#|data:)", text)
    assert "default-src &#39;none&#39;" in text
    assert text.count('class="chart"') == 1
    assert (
        set(re.findall(r'data-group="(.*?)"', text)) == {"g0"} == set(re.findall(r"group&#34;: &#34;(.*?)&#34;", text))
    )
    assert '<td class="n" data-value="">\N{EN DASH}</td>' in text
    assert "<details><summary>folded</summary>" in text
    assert html(whole) == text


def test_a_frame_of_a_notebook_holds_a_page(whole: Page) -> None:
    text = frame(whole)
    assert text.startswith('<iframe srcdoc="')
    assert text.count("<") == 2


def test_an_svg_takes_the_colours_of_the_page_and_keeps_its_words(whole: Page) -> None:
    text = svg_of(
        intervals(["left", NASTY], [1.0, None], [0.1, None], "gain, %", other=("prior", [1.2, 3.0]), zero=True), True
    )
    assert {"--predicted", "--prior", "--soft", "--grid", "--page"} == set(re.findall(r"var\((.*?)\)", text))
    assert not re.search(r"#[0-9a-f]{6}|\d\.\d{3,}|<style|font-family", text)
    root = ElementTree.fromstring(text.replace("xlink:href", "href"))
    assert (root.attrib["role"], root.attrib["aria-label"]) == ("img", "gain, %; value, 95 % interval, prior")
    assert {"left", NASTY, "gain, %", "1"} < {word.text for word in root.iter("text")}
    assert len(text) < 8000


@pytest.mark.parametrize(("low", "high"), [(-1e-5, 2e-5), (1e6, 1e6 + 3), (1.0, 1.0), (0.3, 7e8), (2.0, 3.0)])
@pytest.mark.parametrize("log", [False, True])
def test_words_at_ticks_do_not_touch(low: float, high: float, log: bool) -> None:
    axis, ends = Axis("", log), np.array([low, high])
    root = ElementTree.fromstring(svg_of(Panel(axis, axis, (Series("", ends, ends),)), alone=False))
    words = [(word.attrib, word.text or "") for word in root.iter("text")]
    across = sorted((float(at["x"]), 3.0 * len(text)) for at, text in words if "anchor: middle" in at["style"])
    up = sorted(float(at["y"]) for at, _ in words if "anchor: end" in at["style"])
    assert min(len(across), len(up)) >= (1 if log and low < 0 else 2)
    assert all(b - a > half + other for (a, half), (b, other) in pairwise(across))
    assert all(b - a > 10 for a, b in pairwise(up))


def test_an_svg_draws_a_matrix_spans_and_steps() -> None:
    x, y = Axis("x"), Axis("y")
    spans = Series("", np.array([[0.0, 1.0], [2.0, 3.0]]), np.array([0.0]), mark="spans")
    steps = Series("", np.arange(4.0), np.ones(3), mark="steps")
    matrix = Panel(x, y, matrix=np.array([[1.0, -0.5], [-0.5, 1.0]]))
    for panel, part in ((matrix, "var(--negative)"), (Panel(x, y, (spans,)), "var(--predicted)"),
                        (Panel(x, y, (steps,)), "var(--predicted)")):  # fmt: skip
        assert part in svg_of(panel, alone=True)


@pytest.mark.parametrize(
    ("value", "digits", "text"), [(110.3, 2, "110"), (1.5e-7, 2, "1.5e-7"), (203.0, 1, "200"), (123456.0, 2, "1.2e5")]
)
def test_numbers_have_an_exponent_only_where_they_are_long(value: float, digits: int, text: str) -> None:
    assert Column("", Kind.NUMBER, digits).text(value) == text


def test_numbers_in_words_keep_their_digits() -> None:
    words = "bandwidth 2.6345 Hz of M L 1"
    panel = Panel(Axis(words), Axis("y"), lines_of(np.arange(5.0)), rules=(Rule(x=2.0, label=words),))
    assert svg_of(panel, alone=True).count(f">{words}<") == 2


def test_drawings_of_a_page_need_no_ids() -> None:
    text = svg_of(Panel(Axis("x"), Axis("y"), lines_of(np.arange(5.0), 2)), alone=True)
    assert not re.search(r"\bid=|url\(", text)


def test_the_grid_of_a_panel_is_where_its_values_are() -> None:
    line = Series("", np.array([0.0, 4.0]), np.array([1.0, 2.0]))
    panel = Panel(Axis("x", limits=(0.0, 4.0)), Axis("y"), (line,))
    root = ElementTree.fromstring(svg_of(panel, alone=True))
    at = {
        word.text: (float(word.attrib["x"]), float(word.attrib["y"]))
        for word in root.iter("text")
        if "middle" in word.attrib["style"]
    }
    (drawn,) = [path.attrib["d"] for path in root.iter("path") if "--predicted" in path.attrib["style"]]
    ends = np.array(re.findall(r"[\d.]+", drawn), dtype=float).reshape(2, 2)
    np.testing.assert_allclose(ends[:, 0], [at["0"][0], at["4"][0]], atol=0.2)


# Figures


def test_a_figure_shows_the_series_of_its_chart(whole: Page) -> None:
    chart = whole.sections[2].items[0]
    assert isinstance(chart, Chart)
    figure = figure_of(chart)
    (axes,) = figure.axes
    assert [line.get_label() for line in axes.get_lines()] == ["joint 0", "joint 1"]
    assert (axes.get_xlabel(), axes.get_ylabel()) == ("time, s", "torque, N m")
    assert axes.get_lines()[1].get_color() == palette()["c1"]


def test_a_long_series_is_thinned_to_its_extremes() -> None:
    x = np.linspace(0.0, 6.0, 5000)
    series = Series("", x, np.where(x == x[777], 9.0, np.sin(x)))
    (along,) = figure_of(Chart((Panel(Axis("x"), Axis("y"), (series,)),))).axes
    assert len(along.get_lines()[0].get_xdata()) <= 1200
    assert max(along.get_lines()[0].get_ydata()) == 9.0


def test_dots_show_in_figures_and_on_pages() -> None:
    k = np.arange(5.0)
    panel = Panel(Axis("x"), Axis("y"), (Series("", k, k, mark="points", width=3.0),))
    canvas = FigureCanvasAgg(figure_of(Chart((panel,))))
    canvas.draw()
    blue = np.round(255 * np.array(to_rgb(palette()["predicted"])))
    assert np.sum((np.asarray(canvas.buffer_rgba())[..., :3] == blue).all(axis=2)) > 5 * 20
    assert svg_of(panel, alone=True).count("h0") == 5


def test_a_figure_draws_a_matrix_spans_and_steps() -> None:
    x, y = Axis("x"), Axis("y")
    panels = (
        Panel(x, y, matrix=np.array([[1.0, -0.5], [-0.5, 1.0]])),
        Panel(x, y, (Series("", np.array([[0.0, 1.0], [2.0, 3.0]]), np.array([0.0]), mark="spans"),)),
        Panel(x, y, (Series("", np.arange(4.0), np.ones(3), mark="steps"),), band=(0.2, 0.4)),
    )
    image, spans, steps = figure_of(Chart(panels)).axes
    cells = image.images[0].get_array()
    np.testing.assert_array_equal(cells[..., 3], [[1.0, 0.5], [0.5, 1.0]])
    assert [to_hex(cell) for cell in cells[0]] == [palette()[name] for name in ("positive", "negative")]
    assert len(spans.collections[0].get_paths()) == 2
    assert len(steps.patches) == 2


def test_robots_are_drawn_once(whole: Page) -> None:
    text = html(Page("robot", Section("Robot", load_robot("five-bar"))))
    assert text.count("<svg") == 1
    assert "payload on right_forearm" in text


# Time series


def test_series_share_the_budget_of_a_page_and_equal_arrays_are_packed_once() -> None:
    time = np.arange(60_000) / 1000
    panels = tuple(Panel(Axis("time, s"), Axis("N m"), lines_of(time, 3)) for _ in range(24))
    both = (Section("a", Chart(panels, live=True)), Section("b", Chart(panels, live=True), folded=True))
    arrays = arrays_for(both)
    specs = [spec_of(panel, arrays, "g", True) for panel in (*panels, *panels)]
    assert len({spec["x"] for spec in specs}) == 1
    assert len(arrays.keys) == 4
    assert arrays.buckets == 450_000 // (2 * 2 * 24 * 3)


def test_an_envelope_keeps_every_extreme_in_its_place(rng: np.random.Generator) -> None:
    time = np.arange(10_007) / 1000
    values = rng.normal(size=(len(time), 3))
    values[4321, 1] = 50.0
    values[77, 2] = -40.0
    thin_time, thin = envelope(time, values, 500)
    assert len(thin_time) == len(thin) <= 1000
    assert np.all(np.diff(thin_time) >= 0)
    np.testing.assert_array_equal(np.nanmax(thin, axis=0), values.max(axis=0))
    np.testing.assert_array_equal(np.nanmin(thin, axis=0), values.min(axis=0))
    spike = thin_time[np.argmax(thin[:, 1])]
    assert abs(spike - time[4321]) < 2 * len(time) / 500 / 1000
    kept_time, kept = envelope(time[:900], values[:900], 500)
    np.testing.assert_array_equal(kept, values[:900])
    np.testing.assert_array_equal(kept_time, time[:900])


def test_an_envelope_leaves_gaps_open() -> None:
    values = np.ones((4000, 1))
    values[1000:2000] = np.nan
    _, thin = envelope(np.arange(4000.0), values, 400)
    assert np.isnan(thin[200:400]).all()
    assert np.isfinite(thin[:190]).all()


def test_stretches_that_are_masked() -> None:
    time = np.arange(10.0)
    masked = np.array([1, 1, 0, 0, 1, 0, 1, 0, 0, 1], dtype=bool)
    np.testing.assert_array_equal(stretches(time, masked), [0, 2, 4, 5, 6, 7, 9, 9])
    fine = np.linspace(0.0, 1.0, 5001)
    close = np.zeros(5001, bool)
    close[[100, 102, 3000]] = True
    np.testing.assert_allclose(stretches(fine, close), [0.02, 0.0206, 0.6, 0.6002])
    assert stretches(time, np.zeros(10, dtype=bool)).size == 0
