"""The report in a real browser: it works, fits a phone, prints, and runs nothing that a file contains."""

import base64
import json
import os
import shutil
from importlib.util import find_spec

import pytest
from pendulum import FRICTION, MANY, PENDULUM, recording_of
from reported import KINDS, Page, diagnosis, hostile

from invdyn.diagnosis import diagnose, save
from invdyn.diagnosis.report import write_report
from invdyn.diagnosis.report.sentences import verdict
from invdyn.inference import load_posterior


@pytest.fixture(scope="module")
def browser(tmp_path_factory):
    """A headless Chromium; INVDYN_REQUIRE_BROWSER=1 makes its absence a failure."""
    chromium, driver = shutil.which("chromium"), shutil.which("chromedriver")
    if not (chromium and driver and find_spec("selenium")):
        stop = pytest.fail if os.environ.get("INVDYN_REQUIRE_BROWSER") == "1" else pytest.skip
        stop("needs the programs chromium and chromedriver, and the package selenium")
    from selenium import webdriver

    options = webdriver.ChromeOptions()
    options.binary_location = chromium
    flags = (
        "headless=new no-sandbox disable-gpu disable-quic no-first-run disable-background-networking "
        "disable-component-update disable-sync disable-dev-shm-usage"
    )
    for flag in (*flags.split(), f"user-data-dir={tmp_path_factory.mktemp('chromium')}"):
        options.add_argument(f"--{flag}")
    options.set_capability("goog:loggingPrefs", {"browser": "ALL", "performance": "ALL"})
    window = webdriver.Chrome(options=options, service=webdriver.ChromeService(driver))
    try:
        yield window
    finally:
        window.quit()


def opened(browser, page, width=1200):
    browser.execute_cdp_cmd(
        "Emulation.setDeviceMetricsOverride",
        {"width": width, "height": 800, "deviceScaleFactor": 1, "mobile": width < 500},
    )
    browser.get_log("browser"), browser.get_log("performance")  # those of the page before
    browser.get(page.as_uri())
    return browser


def test_in_a_browser(browser, tmp_path):
    page = tmp_path / "report.html"
    write_report(diagnosis(), page)
    opened(browser, page)
    heading = browser.find_element("id", "verdict")
    assert heading.is_displayed()
    assert heading.text == verdict(diagnosis()).replace("\u00a0", " ")
    picture, slider = browser.find_element("id", "replay-nominal"), browser.find_element("id", "replay-slider")
    still = picture.get_attribute("d")
    data = json.loads(Page(page.read_text(encoding="utf-8")).scripts["replay-data"])
    set_to = "arguments[0].value = arguments[1]; arguments[0].dispatchEvent(new Event('input'));"
    browser.execute_script(set_to, slider, 7)
    points = [data["base"], *data["nominal"][7]]
    assert still != picture.get_attribute("d") == "M" + "L".join(f"{x} {y}" for x, y in points)
    browser.execute_script(set_to, slider, data["start"])
    assert picture.get_attribute("d") == still  # the still picture is the script's own
    browser.find_element("id", "replay-play").click()
    browser.execute_async_script("setTimeout(arguments[0], 400)")
    assert picture.get_attribute("d") != still
    browser.find_element("id", "replay-play").click()

    events = [json.loads(entry["message"])["message"] for entry in browser.get_log("performance")]
    requests = [m["params"] for m in events if m["method"] == "Network.requestWillBeSent"]
    asked = [r["request"]["url"] for r in requests if r["documentURL"] == page.as_uri()]  # not the browser's own
    assert {url for url in asked if not url.startswith("data:")} == {page.as_uri()}
    assert browser.get_log("browser") == []
    printed = base64.b64decode(browser.execute_cdp_cmd("Page.printToPDF", {})["data"])
    assert printed.startswith(b"%PDF-")
    assert len(printed) > 20_000


@pytest.mark.parametrize("name", ["three joints", "not enough data", "hostile", "ambiguous"])
def test_fits_a_phone(browser, tmp_path, name):
    page = tmp_path / "report.html"
    write_report(KINDS[name](), page)
    opened(browser, page, width=360)
    assert browser.execute_script("return window.innerWidth") == 360
    assert browser.execute_script("return document.documentElement.scrollWidth") <= 360
    assert browser.get_log("browser") == []


def test_what_a_diagnosis_saves_is_opened(browser, tmp_path):
    """All three files of a real one, which says the same in each."""
    found = diagnose(recording_of(FRICTION, damping=0.05), PENDULUM, without=MANY)
    save(found, tmp_path)
    told = json.loads((tmp_path / "diagnosis.json").read_text(encoding="utf-8"))
    assert told == found.to_json()
    damping = told["causes"][0]["effects"][0]["parameters"]["damping"]
    drawn = load_posterior(tmp_path / "posterior.nc").posterior["effect.viscous_friction.pivot.damping"]
    assert abs(float(drawn.mean()) - damping["mean"]) < 3 * damping["sd"]
    opened(browser, tmp_path / "report.html", width=360)
    heading = browser.find_element("id", "verdict").text
    assert heading == verdict(found).replace("\u00a0", " ")
    assert "viscous friction" in heading
    assert browser.execute_script("return document.documentElement.scrollWidth") <= 360
    assert browser.get_log("browser") == []


def test_hostile_names_run_nothing(browser, tmp_path):
    page = tmp_path / "report.html"
    write_report(hostile(), page)
    opened(browser, page)  # an open alert would make every later call fail
    assert browser.execute_script("return typeof window.hacked") == "undefined"
    assert browser.execute_script("return document.images.length") == 0
    assert browser.get_log("browser") == []
