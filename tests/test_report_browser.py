"""The page in a real browser: it needs no network, and what it shows are the motions it carries."""

import re
import shutil

import numpy as np
import pytest

from tog_mjx.drawing.report import Section
from tog_mjx.drawing.report.packed import QUANTUM, unpack
from tog_mjx.paper.answer import write_report
from tog_mjx.paper.gallery import draw_common
from tog_mjx.paper.scenario import GRID, scenario
from tog_mjx.paper.tasks import get_task
from tog_mjx.solving.descent import Descent, Status
from tog_mjx.studies.landscape import landscape

sync_api = pytest.importorskip("playwright.sync_api", reason="playwright is not installed: pip install '.[browser]'")
CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
PATIENCE = 600_000
"""Milliseconds after which a browser that hangs fails its test."""
pytestmark = pytest.mark.skipif(CHROMIUM is None, reason="no Chromium: apt-get install chromium")


@pytest.fixture(scope="module")
def chromium():
    with sync_api.sync_playwright() as playwright:
        options = ["--no-sandbox", "--disable-gpu"]
        browser = playwright.chromium.launch(executable_path=CHROMIUM, args=options, timeout=PATIENCE)
        yield browser
        browser.close()


@pytest.fixture(scope="module")
def content(tmp_path_factory):
    """The page's path, and its scenarios with their poses: both tasks on the penalty simulator."""
    out = tmp_path_factory.mktemp("browser")
    scenarios = []
    for name in ("flip", "grasp"):
        task = get_task(name)
        setpoints = np.array([task.initial_guess, task.initial_guess * 1.5])
        setpoints[1, 1] = 2.2  # Outside the landscape.
        descent = Descent(np.array([1.0, 0.5]), setpoints, 0 * setpoints, Status.EXHAUSTED, 0.0, 0.0)
        costs = landscape(task, "penalty", task.plane, 20, out / name)
        scenarios.append(scenario(task, "penalty", costs, {"exact": descent, "stochastic": descent}))
    tasks = [get_task("flip"), get_task("grasp")]
    write_report(out / "report.html", {}, [Section("The tasks", draw_common(tasks, out))], scenarios, tasks)
    poses = [
        unpack(one["motions"], (len(one["setpoints"]), len(one["seconds"]), 3 + len(one["setpoints"][0])))
        for one in scenarios
    ]
    return out / "report.html", scenarios, poses


@pytest.fixture
def page(chromium, content):
    """Opened, with all that it said and asked for in `said` and `asked`. Its time runs only where a test lets it."""
    page = chromium.new_page(viewport={"width": 1100, "height": 900})
    page.set_default_timeout(PATIENCE)
    page.clock.install(time=0)
    page.clock.pause_at(1000)
    page.said, page.asked = [], []
    page.on("console", lambda message: page.said.append(message.text))
    page.on("pageerror", lambda error: page.said.append(str(error)))
    page.on("request", lambda request: page.asked.append(request.url))
    page.goto(content[0].as_uri())
    page.wait_for_selector("body[data-ready='0']")
    yield page
    page.close()


def shown(page) -> tuple[float, float, float]:
    """x, z and theta of the box drawn."""
    transform = page.locator("#box").get_attribute("transform")
    x, z, degrees = map(float, re.findall(r"-?[\d.]+(?:e-?\d+)?", transform))
    return x, z, np.deg2rad(degrees)


def frame(page) -> int:
    """The number that the time's slider stands at."""
    return int(page.locator("#time").input_value())


def told(page) -> tuple[float, float, float, float]:
    """Time, x, z and the angle in degrees of the status line."""
    found = re.search(r"At (.*) s the box is at x = (.*) m, z = (.*) m, turned by (.*) degrees", said(page))
    assert found
    seconds, x, z, degrees = map(float, found.groups())
    return seconds, x, z, degrees


def said(page) -> str:
    return page.locator("#said").inner_text()


def test_it_loads_from_disk_without_a_word_and_without_the_network(page, content):
    page.locator("#landscape").click(position={"x": 100, "y": 100})
    page.locator("#play").click()
    page.clock.run_for(200)
    assert frame(page) > 0
    assert page.said == []
    assert {address.split(":")[0] for address in page.asked} <= {"file", "data"}
    assert [address for address in page.asked if address.startswith("file")] == [content[0].as_uri()]


def test_a_click_on_the_landscape_shows_the_motion_simulated_there(page, content):
    _, (one, _), (poses, _) = content
    before = shown(page)
    page.locator("#time").evaluate("slider => { slider.value = slider.max; slider.dispatchEvent(new Event('input')) }")
    image = page.locator("#landscape image").bounding_box()
    # A quarter from the left, a quarter from the top: column 8 and row 24 of 33 x 33.
    page.mouse.click(image["x"] + image["width"] / 4, image["y"] + image["height"] / 4)
    motion = 24 * GRID + 8
    np.testing.assert_allclose(shown(page), poses[motion, -1, :3], atol=QUANTUM)
    assert np.abs(np.subtract(shown(page), before)).max() > 0.05
    x, z = one["setpoints"][motion]
    assert f"setpoint ({x:.3f}, {z:.3f}) m: J = {one['costs'][motion]:.4f}" in said(page)


def test_play_advances_with_its_status_line_and_pause_holds(page, content):
    _, (one, _), (poses, _) = content
    first = one["paths"]["exact"]["first"] + 1  # The best iterate is shown at first.
    start = shown(page)
    page.locator("#speed").select_option("0.1")
    page.locator("#play").click()
    page.clock.run_for(1000)
    assert page.locator("#play").inner_text() == "Pause"
    seconds = float(page.locator("#time").get_attribute("aria-valuetext").split()[0])
    assert 0.09 <= seconds <= 0.1  # A tenth of real time; the first frame starts the clock.
    assert frame(page) == np.searchsorted(one["seconds"], seconds, "right") - 1
    x, z, theta = (np.interp(seconds, one["seconds"], poses[first, :, i]) for i in range(3))
    np.testing.assert_allclose(shown(page), [x, z, theta], atol=5e-3)  # Of half a millisecond, and the poses' rounding.
    assert (np.abs(np.subtract(told(page), [seconds, x, z, np.degrees(theta)])) < [0.006, 0.01, 0.01, 1]).all()
    assert page.locator("#said").get_attribute("aria-live") == "off"  # Else a screen reader would never end.

    page.locator("#play").click()
    assert page.locator("#play").inner_text() == "Play"
    assert page.locator("#said").get_attribute("aria-live") == "polite"
    held = shown(page), told(page)
    assert held[0] != start
    page.clock.run_for(1000)
    assert (shown(page), told(page)) == held
    page.locator("#speed").select_option("1")
    page.locator("#play").click()
    page.clock.run_for(1000)
    assert frame(page) == len(one["seconds"]) - 1
    assert page.locator("#play").inner_text() == "Play"
    assert told(page)[0] == pytest.approx(one["seconds"][-1], abs=0.006)


def test_the_keyboard_scrubs_picks_and_plays(page, content):
    _, (one, _), (poses, _) = content
    first = one["paths"]["exact"]["first"] + 1  # The best iterate is shown at first.
    page.locator("#time").focus()
    for _ in range(7):
        page.keyboard.press("ArrowRight")
    np.testing.assert_allclose(shown(page), poses[first, 7, :3], atol=QUANTUM)
    page.keyboard.press("End")
    np.testing.assert_allclose(shown(page), poses[first, -1, :3], atol=QUANTUM)

    page.locator("#landscape").focus()
    page.keyboard.press("ArrowDown")  # From (0, 2.2), above the window, to its upper edge.
    np.testing.assert_allclose(shown(page), poses[32 * GRID + 16, -1, :3], atol=QUANTUM)
    page.keyboard.press("ArrowDown")
    page.keyboard.press("ArrowRight")
    np.testing.assert_allclose(shown(page), poses[31 * GRID + 17, -1, :3], atol=QUANTUM)
    page.locator("#play").focus()
    page.keyboard.press("Space")
    assert page.locator("#play").inner_text() == "Pause"


def test_an_iterate_of_a_descent_and_another_scenario(page, content):
    _, (_, two), (_, poses) = content
    page.locator("#scenario").select_option("1")
    page.wait_for_selector("body[data-ready='1']")
    page.locator("#source").select_option("stochastic")
    page.locator("#iterate").focus()
    page.keyboard.press("End")
    page.locator("#time").focus()
    page.keyboard.press("End")
    first = two["paths"]["stochastic"]["first"]
    np.testing.assert_allclose(shown(page), poses[first + 1, -1, :3], atol=QUANTUM)
    assert (
        f"grasp on penalty, setpoint (-0.075, 2.200, 0.075, 0.375) m: J = {two['costs'][first + 1]:.4f}, outside"
        in said(page)
    )
    mark, stage = page.locator("#motion .setpoint").first.bounding_box(), page.locator("#motion").bounding_box()
    assert stage["y"] < mark["y"] < stage["y"] + stage["height"]
    assert page.locator("#motion circle").count() == 2
    assert page.said == []


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_a_phone_needs_no_sideways_scrolling_and_the_night_is_dark(chromium, content, scheme):
    page = chromium.new_page(viewport={"width": 360, "height": 740}, color_scheme=scheme)
    page.set_default_timeout(PATIENCE)
    page.goto(content[0].as_uri())
    page.wait_for_selector("body[data-ready='0']")
    assert page.evaluate("document.documentElement.scrollWidth") <= 360
    back = page.evaluate("getComputedStyle(document.body).backgroundColor")
    brightness = np.mean([int(number) for number in re.findall(r"\d+", back)[:3]])
    assert brightness > 200 if scheme == "light" else brightness < 50
    page.close()
