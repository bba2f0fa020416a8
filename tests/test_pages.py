"""Tests of the report page and of the scorecard page: their text, and how Chromium shows them."""

from __future__ import annotations

import dataclasses
import itertools
import re
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hframe_gym.evaluation import Episodes, score_episodes, write_scorecard
from hframe_gym.identification import write_result
from hframe_gym.identification.report.page import build_report
from hframe_gym.web_page import COLORS, Panel, number, panel_svg, plot_style, save_panels
from tests.browser import SCHEMES, WIDTHS, chromium, faults_of, open_page
from tests.identification.report.axis_results import PLAN, STRIBECK, TABLE, result_of
from tests.identification.single_axis import AXIS, axis_runs

pytest.importorskip("jinja2")
pytest.importorskip("matplotlib")
pytestmark = pytest.mark.integration

PAGES = ("effect", "table", "unexplained", "reach", "track")
WARNING = "the agent 'ppo' was trained on the machine 'hframe', not on this one"


def report_page(kind: str, folder: Path) -> Path:
    """Write the report page of a hand-made result with everything that a page can have."""
    data = axis_runs(STRIBECK, rows=500, volts=2.0)
    if kind == "effect":
        result = result_of(data, "effect_found", STRIBECK, PLAN, gain=0.9)
    elif kind == "table":
        result = result_of(data, "effect_found", TABLE)
    else:
        result = result_of(data, "unexplained", AXIS)
    result = dataclasses.replace(result, white=kind != "unexplained")
    write_result(result, folder, ("advice: run_0: sampled at 999 Hz",))
    return build_report(folder)


def episodes_of(seed: int, *, contour: bool, decay_s: float) -> Episodes:
    """Return 20 episodes in which the tool approaches its goal exponentially."""
    rng = np.random.default_rng(seed)
    time_s = 1e-3 * np.arange(601)
    goal = np.zeros((20, 601, 2))
    position = rng.uniform(-0.1, 0.1, (20, 1, 2)) * np.exp(-time_s / decay_s)[:, None]
    distance = np.linalg.norm(position, axis=2)
    return Episodes(
        time_s, position, goal, 1e-3 * distance if contour else None, rng.uniform(-12.0, 12.0, (20, 60, 2)),
        np.full(2, 12.0), rng.uniform(1.0, 2.0, 20), rng.uniform(10.0, 20.0, 20),
    )  # fmt: skip


def scorecard_page(task: str, folder: Path, **changes: Any) -> Path:
    """Write the scorecard of three controllers that differ in their time constants."""
    names = ("pid", "textbook-pid", "out/agents/a_folder_with_a_long_name")
    recorded = {
        name: episodes_of(k, contour=task == "track", decay_s=0.04 * (k + 1)) for k, name in enumerate(names)
    }
    bound = np.full(20, 0.15) if task == "reach" else None
    scores = {
        "schema": 1, "machine": "hframe", "task": task, "randomize": "default", "episodes": 20, "seed": 0,
        "sensors": "state", "period_s": 0.01,
        "controllers": {name: score_episodes(e, bound) for name, e in recorded.items()},
    }  # fmt: skip
    return write_scorecard(folder, scores | changes, recorded, [WARNING])


@pytest.fixture(scope="module")
def pages(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """Write all pages once."""
    folder = tmp_path_factory.mktemp("pages")
    makers: dict[str, Callable[[str, Path], Path]] = {"reach": scorecard_page, "track": scorecard_page}
    return {kind: makers.get(kind, report_page)(kind, folder / kind) for kind in PAGES}


@pytest.fixture(scope="module")
def driver() -> Iterator[Any]:
    """Start Chromium once."""
    with chromium() as browser:
        yield browser


@pytest.mark.slow
@pytest.mark.parametrize("scheme", SCHEMES)
@pytest.mark.parametrize("width", WIDTHS)
@pytest.mark.parametrize("kind", PAGES)
def test_chromium_shows_the_page_without_a_fault(
    kind: str, width: int, scheme: str, pages: dict[str, Path], driver: Any
) -> None:
    assert faults_of(driver, pages[kind], width, scheme) == []


@pytest.mark.slow
def test_the_checks_find_faults(tmp_path: Path, driver: Any) -> None:
    page = tmp_path / "bad.html"
    page.write_text(
        "<!doctype html><html><body><main><h1>a</h1><h3 style='color: #ccc'>b</h3><svg></svg>"
        "<div style='width: 2000px'>c</div></main><script>throw Error('broken')</script></body></html>"
    )
    faults = " ".join(faults_of(driver, page, 390, "light"))
    for text in (
        "px wide",
        "no language",
        "level skipped",
        "no alternative text",
        "contrast",
        "console: ",
        "broken",
    ):
        assert text in faults


@pytest.mark.slow
def test_the_page_is_dark_on_a_dark_display(pages: dict[str, Path], driver: Any) -> None:
    colors = {}
    for scheme in SCHEMES:
        open_page(driver, pages["effect"], 1280, scheme)
        colors[scheme] = driver.execute_script(
            "return [getComputedStyle(document.body).backgroundColor, "
            "getComputedStyle(document.querySelector('svg text')).fill]"
        )
    assert colors["light"][0] == "rgb(255, 255, 255)"
    assert colors["dark"][0] == "rgb(18, 22, 28)"
    assert colors["light"][1] != colors["dark"][1]


@pytest.mark.slow
def test_the_keyboard_reaches_and_unfolds_the_details(pages: dict[str, Path], driver: Any) -> None:
    from selenium.webdriver.common.action_chains import ActionChains
    from selenium.webdriver.common.keys import Keys

    open_page(driver, pages["effect"], 1280, "light")
    reached = []
    for _ in range(30):
        ActionChains(driver).send_keys(Keys.TAB).perform()
        reached.append(driver.execute_script("return document.activeElement.tagName"))
        assert (
            driver.execute_script("return getComputedStyle(document.activeElement).outlineStyle") == "solid"
        )
        if reached[-1] == "SUMMARY":
            break
    assert reached[0] == "A"  # the link that skips the head of the page
    assert reached[-1] == "SUMMARY"
    ActionChains(driver).send_keys(Keys.ENTER).perform()
    assert driver.execute_script("return document.activeElement.parentElement.open")


@pytest.mark.slow
@pytest.mark.parametrize(("width", "scheme"), [(1280, "light"), (390, "dark")])
def test_a_part_of_a_run_is_enlarged_and_curves_are_hidden(
    width: int, scheme: str, pages: dict[str, Path], driver: Any
) -> None:
    from selenium.webdriver.common.action_chains import ActionChains

    open_page(driver, pages["effect"], width, scheme)
    plot = driver.find_element("css selector", ".plot")

    def shown_s() -> tuple[float, float]:
        text = plot.find_element("css selector", "svg").get_attribute("aria-label")
        match = re.search(r"from ([\d.]+) to ([\d.]+) s:", text)
        assert match is not None
        return float(match[1]), float(match[2])

    def press(text: str) -> None:
        driver.find_element("xpath", f"//button[.='{text}']").click()

    whole = shown_s()
    assert whole == pytest.approx((0.0, 0.499), abs=1e-3)
    driver.execute_script("arguments[0].scrollIntoView({block: 'center'})", plot)
    drag = ActionChains(driver).move_to_element(plot).click_and_hold().move_by_offset(60, 3).release()
    drag.perform()
    start, end = shown_s()
    seconds_per_pixel = 0.499 / (plot.size["width"] - 66)  # 66 px: the margins of the axes
    assert end - start == pytest.approx(60 * seconds_per_pixel, rel=0.05)
    press("Zoom out")
    assert shown_s()[1] - shown_s()[0] == pytest.approx(2 * (end - start), rel=0.02)
    press("Whole run")
    assert shown_s() == whole
    curves = len(plot.find_elements("css selector", "path"))
    press("refitted")
    assert len(plot.find_elements("css selector", "path")) == curves - 2  # its simulation and its error


@pytest.mark.parametrize("kind", PAGES)
def test_the_page_is_self_contained(kind: str, pages: dict[str, Path]) -> None:
    text = pages[kind].read_text()
    assert "://" not in text
    for attributes in re.findall("<script([^>]*)>", text):
        assert attributes in ("", ' type="application/json" id="curve-data"')  # no script from elsewhere
    assert len(text) < 3e6
    style = text[text.index("<style>") : text.index("</style>")]
    for light, dark in COLORS.values():
        assert light in style
        assert dark in style
        assert light not in text.replace(style, "")  # plots take their colors from the style sheet


def test_the_report_says_what_was_found_what_is_left_and_what_to_do(pages: dict[str, Path]) -> None:
    text = pages["effect"].read_text()
    first, last = text[: text.index('<section id="errors">')], text[text.index('<section id="next">') :]
    for words in (
        "Missing effects found",
        "Its force is 10 % of the drives' force (rms).",
        "It removes 90 % of the squared error of the held-out runs.",
        "consistent with the sensors' noise",
        "record the run, and identify again with it.",
    ):
        assert words.replace("'", "&#39;") in first or words in first, words
    for words in (
        "record the run, and identify again with it.",
        "pid first, with a control period of 10 ms.",
        "Read the findings about the recordings (1)",
        f"hframe evaluate pid --machine {pages['effect'].parent / 'machine.json'}",
    ):
        assert words.replace("'", "&#39;") in last or words in last, words
    assert re.search(r"<dd>[\d.]+ × noise<small>[\d.]+ (µm|mm) rms at x_m</small></dd>", first)


def test_the_report_of_an_unexplained_error_compares_declared_and_refitted(pages: dict[str, Path]) -> None:
    text = pages["unexplained"].read_text()
    assert "Unexplained error" in text
    assert "The force that the model lacks on x depends most on velocity of x" in text
    assert "Record runs that isolate it" in text
    assert "hframe check" not in text
    assert "with effects" not in text


def test_the_scorecard_compares_the_controllers(pages: dict[str, Path]) -> None:
    text = pages["reach"].read_text()
    assert "Best: pid" in text
    assert "pid comes to rest within 0.2 mm of the goal in 100.0 % of the episodes" in text
    assert re.search(r"In the same episodes textbook-pid is 0\.\d+ s slower \(95 % interval", text)
    assert "times the shortest possible time" in text
    assert WARNING.replace("'", "&#39;") in text
    assert text.count("tool path") == 6  # captions of the median and the worst episode of each controller
    assert "worst episode" in text
    assert "settling time to 0.2 mm, s, over the episodes. 5, 50 and 95 % quantiles: pid" in text
    assert "exact positions and velocities" in text
    assert "10 ms (100 Hz)" in text
    steps = text[text.index('<section id="next">') :]
    assert "Remove what the warnings at the top name" in steps
    assert "hframe evaluate pid --machine hframe --sensors machine --episodes 20 --html" in steps
    assert "hframe export gains --machine hframe --period 0.01 --out gains" in steps
    assert "contour" not in text


def test_the_scorecard_of_a_path_has_contour_errors(pages: dict[str, Path]) -> None:
    text = pages["track"].read_text()
    assert "pid follows the path with a contour error of" in text
    assert "settling" not in text


def test_a_controller_that_never_settles_is_not_praised(tmp_path: Path) -> None:
    slow = episodes_of(0, contour=False, decay_s=10.0)
    scores = {"controllers": {"idle": score_episodes(slow)}}
    text = scorecard_page("reach", tmp_path, **scores).read_text()
    assert "No controller succeeds" in text
    assert "hframe evaluate idle --machine hframe --period 0.002 --episodes 20 --html" in text
    assert text.count("<td>–<small>") == 4  # no settling time to the three bands, and no bound
    assert "Settling time to" not in text  # no plot of the length of the episodes


def test_a_scorecard_names_what_the_drives_are_commanded_by(tmp_path: Path) -> None:
    page = scorecard_page("reach", tmp_path, command={"name": "current", "unit": "A"}).read_text()
    assert "current variation, A" in page
    assert "time at rated current, %" in page
    assert "Current variation: sum" in page
    assert "voltage variation" not in page


def test_the_plot_of_settling_times_leaves_out_a_controller_that_never_settles(tmp_path: Path) -> None:
    recorded = {
        name: episodes_of(0, contour=False, decay_s=s) for name, s in {"pid": 0.04, "idle": 10.0}.items()
    }
    scores = {"controllers": {name: score_episodes(episodes) for name, episodes in recorded.items()}}
    text = scorecard_page("reach", tmp_path, **scores).read_text()
    (described,) = re.findall(r"Settling time to 0.2 mm, mean over the episodes: ([^\"]*)\.", text)
    assert "pid" in described
    assert "idle" not in described


def test_a_panel_has_a_label_and_identifiers_of_its_own() -> None:
    panel = Panel("A title", 'Values of "x" & y', lambda axes: axes.plot([0, 1], [0, 1], "o"))
    first, second = panel_svg(panel, "a"), panel_svg(panel, "b")
    assert 'aria-label="Values of &#34;x&#34; &amp; y"' in first
    ids = [set(re.findall(r' id="([^"]+)"', text)) for text in (first, second)]
    assert ids[0]
    assert not ids[0] & ids[1]
    assert set(re.findall(r'(?:href="|url\()#([^")]+)', first)) <= ids[0]
    assert "var(--after)" in first


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (0.03124, "0.0312"),
        (18.34, "18.3"),
        (999.4, "999"),
        (999.7, "1000"),
        (1234.5, "1234"),
        (2e6, "2e+06"),
        (-0.5, "-0.5"),
    ],
)
def test_numbers_are_written_without_exponent_where_that_is_short(value: float, text: str) -> None:
    assert number(value) == text


def test_numbers_below_a_plot_do_not_touch_each_other(tmp_path: Path) -> None:
    """With the ticks that matplotlib chooses by itself, -0.075 and -0.050 do."""
    import matplotlib
    from matplotlib.backends.backend_agg import FigureCanvasAgg

    drawn: list[Any] = []

    def draw(axes: Any) -> None:
        axes.set(xlim=(-0.095, 0.08), xlabel="y, m", ylabel="mean error of y, mm")
        drawn.append(axes)

    save_panels([Panel("error", "", draw)] * 3, tmp_path / "plot.svg")
    with matplotlib.rc_context(plot_style()):
        FigureCanvasAgg(drawn[0].figure).draw()
    low, high = drawn[0].get_xlim()
    labels = [label for label in drawn[0].get_xticklabels() if low <= label.get_position()[0] <= high]
    boxes = [label.get_window_extent() for label in labels]
    assert min(after.x0 - before.x1 for before, after in itertools.pairwise(boxes)) > 5.0  # pixels


def test_a_long_label_of_the_vertical_axis_is_not_cut_off(tmp_path: Path) -> None:
    import matplotlib
    from matplotlib.backends.backend_agg import FigureCanvasAgg

    drawn: list[Any] = []

    def draw(axes: Any) -> None:
        axes.set(ylabel="change of the command of left_motor, V")
        drawn.append(axes)

    save_panels([Panel("dead band", "", draw)], tmp_path / "plot.svg")
    with matplotlib.rc_context(plot_style()):
        FigureCanvasAgg(drawn[0].figure).draw()
    box = drawn[0].yaxis.label.get_window_extent()
    assert box.y0 >= 0.0
    assert box.y1 <= drawn[0].figure.bbox.height


def test_titles_in_picture_files_are_not_cut_off(tmp_path: Path) -> None:
    panel = Panel(
        "Force that the model lacks on carriage_x, against velocity of carriage_x", "", lambda axes: None, 2.8
    )
    save_panels([panel], tmp_path / "plot.svg")
    texts = re.findall(
        r"<text[^>]*>([^<]*)</text>|<tspan[^>]*>([^<]*)</tspan>", (tmp_path / "plot.svg").read_text()
    )
    title = [line for pair in texts for line in pair if re.search("[a-z]{2}", line)]
    assert " ".join(title) == panel.title
    assert max(map(len, title)) <= 44
