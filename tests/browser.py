"""A headless Chromium for tests of pages, and the checks that every page must pass."""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

WIDTHS = {1280: 800, 390: 844}  # pixels: heights by width, a laptop and a phone
SCHEMES = ("light", "dark")
# No sandbox, because tests may run as root; no network, because pages must not need one.
FLAGS = (
    "--headless",
    "--no-sandbox",
    "--disable-gpu",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--hide-scrollbars",
)

# Returns everything that is wrong with a page.
CHECKS = (Path(__file__).parent / "page_checks.js").read_text()


def require_chromium() -> tuple[str, str]:
    """Return the paths of Chromium and its driver; skip the test if one or selenium is missing."""
    pytest.importorskip("selenium", reason="selenium is not installed: pip install -e '.[dev]'")
    browser = shutil.which("chromium") or shutil.which("google-chrome")
    server = shutil.which("chromedriver")
    if not (browser and server):
        pytest.skip("no Chromium or no ChromeDriver: apt-get install chromium chromium-driver")
    return browser, server


@contextmanager
def chromium() -> Iterator[Any]:
    """Start Chromium; the test is skipped if it, its driver or the package selenium is missing.

    Yields:
        Driver (selenium).
    """
    browser, server = require_chromium()
    import selenium.webdriver
    from selenium.webdriver.chrome.service import Service

    options = selenium.webdriver.ChromeOptions()
    options.binary_location = browser
    for flag in FLAGS:
        options.add_argument(flag)
    options.set_capability("goog:loggingPrefs", {"browser": "ALL"})
    driver = selenium.webdriver.Chrome(options=options, service=Service(server, log_output=os.devnull))
    try:
        yield driver
    finally:
        driver.quit()


def open_page(driver: Any, page: Path, width: int, scheme: str) -> None:
    """Open a page in a window of a width, in pixels, on a light or a dark display."""
    size = {"width": width, "height": WIDTHS[width], "deviceScaleFactor": 1, "mobile": width < 500}
    driver.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", size)
    media = {"features": [{"name": "prefers-color-scheme", "value": scheme}]}
    driver.execute_cdp_cmd("Emulation.setEmulatedMedia", media)
    driver.get(page.resolve().as_uri())


def faults_of(driver: Any, page: Path, width: int, scheme: str) -> list[str]:
    """Open a page with all details unfolded, and list console messages and what violates page rules."""
    driver.get_log("browser")
    open_page(driver, page, width, scheme)
    driver.execute_script("for (const d of document.querySelectorAll('details')) d.open = true")
    faults = driver.execute_script(CHECKS)
    return faults + [f"console: {entry['message']}" for entry in driver.get_log("browser")]
