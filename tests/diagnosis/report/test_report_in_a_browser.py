"""The report in a real browser: it works, fits a phone, prints, and runs nothing that a file contains."""

import base64
import json
from dataclasses import replace

import pytest
from browsing import opened, requests
from pendulum import diagnosed
from reported import KINDS, Page, diagnosis, hostile

from invdyn.diagnosis import save
from invdyn.diagnosis.report import write_report
from invdyn.diagnosis.report.sentences import verdict
from invdyn.inference import load_posterior


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

    assert requests(browser, page) == {page.as_uri()}
    assert browser.get_log("browser") == []
    printed = base64.b64decode(browser.execute_cdp_cmd("Page.printToPDF", {})["data"])
    assert printed.startswith(b"%PDF-")
    assert len(printed) > 20_000


def test_a_replay_without_a_correction_moves(browser, tmp_path):
    page, d = tmp_path / "report.html", diagnosis()
    write_report(replace(d, tracks=replace(d.tracks, corrected_replay=d.tracks.nominal_replay)), page)
    opened(browser, page)
    slider, still = browser.find_element("id", "replay-slider"), browser.find_element("id", "replay-nominal")
    before = still.get_attribute("d")
    browser.execute_script("arguments[0].value = 7; arguments[0].dispatchEvent(new Event('input'));", slider)
    assert still.get_attribute("d") != before
    assert browser.get_log("browser") == []


@pytest.mark.parametrize("name", ["three joints", "not enough data", "hostile", "ambiguous"])
def test_fits_a_phone(browser, tmp_path, name):
    page = tmp_path / "report.html"
    write_report(KINDS[name](), page)
    opened(browser, page, width=360)
    assert browser.execute_script("return window.innerWidth") == 360
    assert browser.execute_script("return document.documentElement.scrollWidth") <= 360
    assert browser.get_log("browser") == []


@pytest.mark.long
def test_what_a_diagnosis_saves_is_opened(browser, tmp_path):
    """All three files of a real one, which says the same in each."""
    found = diagnosed()
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
