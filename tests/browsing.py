"""A headless Chromium for tests: what a page asks for, how wide it is, what its console says."""

import json
import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from importlib.util import find_spec
from pathlib import Path

import pytest

FLAGS = (
    "headless=new",
    "no-sandbox",
    "disable-gpu",
    "disable-quic",
    "no-first-run",
    "disable-background-networking",
    "disable-component-update",
    "disable-sync",
    "disable-dev-shm-usage",
)


@contextmanager
def chromium(profile: Path) -> Iterator:
    """A window, closed at the end. Without the programs the test is skipped; INVDYN_REQUIRE_BROWSER=1 has it fail."""
    program, driver = shutil.which("chromium"), shutil.which("chromedriver")
    if not (program and driver and find_spec("selenium")):
        stop = pytest.fail if os.environ.get("INVDYN_REQUIRE_BROWSER") == "1" else pytest.skip
        stop("needs the programs chromium and chromedriver, and the package selenium")
    from selenium import webdriver

    options = webdriver.ChromeOptions()
    options.binary_location = program
    for flag in (*FLAGS, f"user-data-dir={profile}"):
        options.add_argument(f"--{flag}")
    options.set_capability("goog:loggingPrefs", {"browser": "ALL", "performance": "ALL"})
    window = webdriver.Chrome(options=options, service=webdriver.ChromeService(driver))
    try:
        yield window
    finally:
        window.quit()


def opened(browser, page: Path, width: int = 1200):
    """The browser with the page in a window so many pixels wide; below 500 it is a phone's."""
    browser.execute_cdp_cmd(
        "Emulation.setDeviceMetricsOverride",
        {"width": width, "height": 800, "deviceScaleFactor": 1, "mobile": width < 500},
    )
    browser.get_log("browser"), browser.get_log("performance")  # those of the page before
    browser.get(page.as_uri())
    return browser


def requests(browser, page: Path) -> set[str]:
    """Addresses that the page has asked for, data: aside."""
    events = [json.loads(entry["message"])["message"] for entry in browser.get_log("performance")]
    asked = [event["params"] for event in events if event["method"] == "Network.requestWillBeSent"]
    own = [each["request"]["url"] for each in asked if each["documentURL"] == page.as_uri()]  # not the browser's own
    return {url for url in own if not url.startswith("data:")}
