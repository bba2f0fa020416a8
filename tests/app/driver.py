"""The window `hframe app` in a headless Chromium, and a session of a newcomer in it."""

from __future__ import annotations

import base64
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from hframe_gym.dynamics import simulate
from hframe_gym.effects import EFFECTS
from hframe_gym.machine import BUILTIN_MACHINES
from tests.browser import WIDTHS, chromium, require_chromium

ROOT = Path(__file__).resolve().parents[2]
STAGES = ("machine", "logs", "check", "identify", "results", "control", "export")
# Drops files on the element that matches a selector, as a file manager does.
_DROP = """
const [selector, files, done] = [arguments[0], arguments[1], arguments[2]];
const transfer = new DataTransfer();
for (const [name, content] of files) {
  const bytes = Uint8Array.from(atob(content), (c) => c.charCodeAt(0));
  transfer.items.add(new File([bytes], name));
}
const box = document.querySelector(selector);
box.dispatchEvent(new DragEvent("dragover", { bubbles: true, cancelable: true, dataTransfer: transfer }));
setTimeout(() => {
  const target = box.querySelector(".q-uploader__dnd") || box;
  target.dispatchEvent(new DragEvent("drop", { bubbles: true, cancelable: true, dataTransfer: transfer }));
  done();
}, 200);
"""


def foreign_logs(count: int = 4, rows: int = 1500) -> dict[str, bytes]:
    """Return logs of an axis with Stribeck friction of spreadsheets: semicolons, decimal commas, mm, ms."""
    truth = BUILTIN_MACHINES["axis"]().with_effects(EFFECTS["stribeck_friction"].at("x", dF=1.5, vs=0.02))
    rng, logs = np.random.default_rng(7), {}
    for k in range(1, count + 1):
        time_s = np.arange(rows) * 1e-3
        volts = np.repeat(rng.uniform(-3.0, 3.0, (12, 1)), -(-rows // 12), axis=0)[:rows]
        volts[:100] = 0.0
        position = simulate(truth, time_s, volts).outputs[:, 0] + rng.normal(0.0, 20e-6, rows)
        lines = ["Zeit [ms];Sollspannung [V];Weg [mm];Temperatur [°C]"]
        for t, u, x in zip(time_s, volts[:, 0], position, strict=True):
            lines.append(f"{1e3 * t:.1f};{u:.5f};{1e3 * x:.5f};{21.0 + 0.1 * t:.2f}".replace(".", ","))
        logs[f"Messung_{k}.csv"] = "\n".join(lines).encode("latin-1")
    return logs


@contextmanager
def served(folder: Path) -> Iterator[str]:
    """Serve the window of a session in a process of its own.

    Yields:
        Address with the token.
    """
    command = [sys.executable, "-m", "hframe_gym", "app", str(folder), "--no-open"]
    with (
        tempfile.TemporaryFile("w+") as errors,
        subprocess.Popen(command, cwd=ROOT, stdout=subprocess.PIPE, stderr=errors, text=True) as process,
    ):
        try:
            lines: list[str] = []
            assert process.stdout is not None
            for line in process.stdout:
                lines.append(line)
                if line.startswith("open http"):
                    break
            else:
                raise AssertionError(f"the window did not start: {lines}")
            yield lines[-1].split()[1]
        finally:
            process.terminate()
        process.wait()
        errors.seek(0)
        text = errors.read().replace("hframe: terminated; files are unchanged or complete\n", "")
        assert not text, f"the window reported errors:\n{text}"


class Visitor:
    """Somebody who uses the window in a browser."""

    def __init__(self, driver: Any, address: str) -> None:
        """Take a browser and the address of the window."""
        self.driver, self.address = driver, address

    def look(self, width: int, scheme: str) -> None:
        """Open the page in a window of a width, in pixels, on a light or a dark display."""
        size = {"width": width, "height": WIDTHS[width], "deviceScaleFactor": 1, "mobile": width < 500}
        self.driver.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", size)
        media = {"features": [{"name": "prefers-color-scheme", "value": scheme}]}
        self.driver.execute_cdp_cmd("Emulation.setEmulatedMedia", media)
        self.driver.get(self.address)
        self.until("document.querySelector('.q-tab') !== null", 30.0)
        time.sleep(0.5)

    def until(self, condition: str, seconds: float) -> None:
        """Wait until an expression of JavaScript is true."""
        end = time.monotonic() + seconds
        while not self.driver.execute_script(f"return !!({condition})"):
            if time.monotonic() > end:
                text = self.driver.execute_script("return document.body.innerText")
                raise AssertionError(f"not within {seconds:g} s: {condition}\n{text}")
            time.sleep(0.1)

    def go(self, key: str) -> None:
        """Open a stage."""
        number = STAGES.index(key)
        self.driver.execute_script(f"document.querySelectorAll('.q-tab')[{number}].click()")
        self.until(f"document.querySelector('main[data-stage={key}]')?.offsetParent", 10.0)
        time.sleep(0.6)

    def stage(self, key: str) -> str:
        """Return the text of a stage."""
        return str(
            self.driver.execute_script(f"return document.querySelector('main[data-stage={key}]').innerText")
        )

    def drop(self, files: dict[str, bytes], selector: str = "main[data-stage=logs] .q-uploader") -> None:
        """Drop files on an element, by default on the stage Logs."""
        contents = [[name, base64.b64encode(content).decode()] for name, content in files.items()]
        self.driver.set_script_timeout(60)
        self.driver.execute_async_script(_DROP, selector, contents)

    def click(self, selector: str) -> None:
        """Click an element."""
        self.driver.execute_script("document.querySelector(arguments[0]).click()", selector)

    def click_text(self, selector: str, text: str) -> None:
        """Click the first of some elements whose text begins with a text."""
        found = self.driver.execute_script(
            "const found = [...document.querySelectorAll(arguments[0])]"
            ".find((e) => e.innerText.trim().startsWith(arguments[1])); "
            "if (found) found.click(); return !!found",
            selector,
            text,
        )
        assert found, f"nothing of {selector} begins with {text}"

    def choose(self, selector: str, text: str) -> None:
        """Choose an entry of a menu (q-select) by the beginning of its text."""
        from selenium.webdriver.common.by import By
        from selenium.webdriver.common.keys import Keys

        field = self.driver.find_element(By.CSS_SELECTOR, selector)
        # A choice may redraw the stage, and the field with it: what is asked of it is asked before.
        stays_open = self.driver.execute_script(
            "arguments[0].scrollIntoView({block: 'center'});"
            "return !!arguments[0].closest('.q-select--multiple')",
            field,
        )
        field.click()
        self.until("document.querySelectorAll('.q-menu .q-item').length > 0", 5.0)
        time.sleep(0.3)
        found = self.driver.execute_script(
            "const item = [...document.querySelectorAll('.q-menu .q-item')]"
            ".find((i) => i.innerText.trim().startsWith(arguments[0])); "
            "if (item) item.click(); return !!item",
            text,
        )
        assert found, f"{selector} has no entry {text}"
        if stays_open:
            self.press(Keys.ESCAPE)  # the menu stays open for further choices
        self.until("document.querySelectorAll('.q-menu .q-item').length === 0", 5.0)

    def tab_to(self, condition: str) -> None:
        """Press Tab until an expression of JavaScript about the focused element, `e`, is true."""
        from selenium.webdriver.common.action_chains import ActionChains
        from selenium.webdriver.common.keys import Keys

        for _ in range(80):
            if self.driver.execute_script(f"const e = document.activeElement; return !!({condition})"):
                return
            ActionChains(self.driver).send_keys(Keys.TAB).perform()
        raise AssertionError(f"the keyboard does not reach: {condition}")

    def press(self, key: str) -> None:
        """Press a key."""
        from selenium.webdriver.common.action_chains import ActionChains

        ActionChains(self.driver).send_keys(key).perform()

    def fill(self, selector: str, text: str) -> None:
        """Type a text into a field."""
        from selenium.webdriver.common.by import By
        from selenium.webdriver.common.keys import Keys

        field = self.driver.find_element(By.CSS_SELECTOR, selector)
        self.driver.execute_script("arguments[0].scrollIntoView({block: 'center'})", field)
        field.send_keys(Keys.CONTROL, "a")
        field.send_keys(text, Keys.TAB)

    def drag_over_chart(self, first: float, last: float) -> None:
        """Drag the mouse over the curves of the stage Logs, between two fractions of their width."""
        from selenium.webdriver.common.action_chains import ActionChains

        self.until("document.querySelector('main[data-stage=logs] canvas')", 30.0)
        time.sleep(1.0)  # the chart is armed for the selection a moment after it is drawn
        canvas = self.driver.execute_script(
            "const c = document.querySelector('main[data-stage=logs] canvas');"
            "c.scrollIntoView({block: 'center'}); return c"
        )
        time.sleep(1.5)
        width, height = canvas.size["width"], canvas.size["height"]
        left, up = int((first - 0.5) * width), 60 - height // 2  # in the first plot
        chain = ActionChains(self.driver, duration=50).move_to_element_with_offset(canvas, left, up)
        chain.click_and_hold().move_by_offset(int((last - first) * width / 2), 0)
        chain.move_by_offset(int((last - first) * width / 2), 0).release().perform()

    def run(self, key: str, seconds: float) -> str:
        """Run the commands of a stage; return its text when they have ended."""
        self.click(f"[data-run={key}]")
        ended = f"document.querySelector('main[data-stage={key}] .hf-details summary')?.innerText"
        self.until(f"{ended}.includes('…')", 20.0)
        self.until(f"/(done in|exit code) [\\d.]+/.test({ended})", seconds)
        time.sleep(0.5)
        return self.stage(key)

    def picture(self, path: Path) -> None:
        """Save a picture of the page in its full height."""
        time.sleep(1.0)
        width, height = self.driver.execute_script(
            "return [innerWidth, Math.max(innerHeight, document.documentElement.scrollHeight)]"
        )
        size = {"width": width, "height": min(height, 4000), "deviceScaleFactor": 1, "mobile": width < 500}
        self.driver.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", size)
        time.sleep(0.7)
        content = self.driver.execute_cdp_cmd("Page.captureScreenshot", {})
        path.write_bytes(base64.b64decode(content["data"]))
        size["height"] = WIDTHS.get(width, 800)
        self.driver.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", size)


@contextmanager
def visitor_of(folder: Path) -> Iterator[Visitor]:
    """Open the window of a session in Chromium; without it, skip the test before the window is started."""
    require_chromium()
    with served(folder) as address, chromium() as driver:
        yield Visitor(driver, address)


def newcomers_session(visitor: Visitor) -> dict[str, str]:
    """Go from a dropped log to exports; return what each stage shows at its end."""
    texts = {}
    visitor.look(1280, "light")
    visitor.click_text("main[data-stage=machine] .q-radio", "One axis")
    visitor.until(
        "document.querySelector('[data-run=machine]').closest('main').innerText.includes('--like axis')", 10.0
    )
    texts["machine"] = visitor.run("machine", 60.0)
    visitor.go("logs")
    visitor.drop(foreign_logs())
    visitor.until("document.querySelectorAll('main[data-stage=logs] canvas').length > 0", 30.0)
    texts["dropped"] = visitor.stage("logs")
    visitor.choose("[data-unit=x_m]", "mm")
    visitor.until("document.querySelector('main[data-stage=logs]').innerText.includes('--unit x_m=mm')", 10.0)
    texts["logs"] = visitor.run("logs", 60.0)
    visitor.go("check")
    texts["check"] = visitor.run("check", 120.0)
    visitor.until("document.querySelector('main[data-stage=check] canvas')", 30.0)
    visitor.go("identify")
    texts["identify"] = visitor.run("identify", 240.0)
    visitor.go("results")
    visitor.until("document.querySelector('.hf-report')?.contentDocument?.querySelector('.verdict')", 20.0)
    texts["results"] = str(
        visitor.driver.execute_script(
            "return document.querySelector('.hf-report').contentDocument.body.innerText"
        )
    )
    visitor.go("control")
    texts["control"] = visitor.run("control", 120.0)
    visitor.go("export")
    texts["c"] = visitor.run("export", 60.0)
    visitor.choose("[data-kind]", "fmu")
    visitor.until(
        "document.querySelector('main[data-stage=export]').innerText.includes('hframe export fmu')", 10.0
    )
    texts["fmu"] = visitor.run("export", 60.0)
    return texts
