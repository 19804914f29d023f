"""The page of a result, in a real browser: curves, body and table show the same row, by pointer and by keyboard."""

import re
from dataclasses import replace

import numpy as np
import pytest
from browsing import opened, requests
from pendulum import diagnosed
from reported import HOSTILE, diagnosis
from viewed import cells, data_of, go, row, value

from invdyn.diagnosis import save
from invdyn.inference import save_posterior
from invdyn.page import with_prefix
from invdyn.plots import quantiles
from invdyn.recordings import InputError
from invdyn.view import MAX_ROWS, of_posterior, view_of

WIDTHS = (1280, 390)


@pytest.fixture
def found(tmp_path, make_posterior):
    """The folder of a diagnosis."""
    (folder := tmp_path / "found").mkdir()
    save(replace(diagnosis(), posterior=make_posterior(2)), folder)
    return folder


def in_space(idata):
    """The same posterior with a third coordinate."""
    for name in idata.groups():
        if "space" in idata[name].dims:
            idata[name] = idata[name].pad(space=(0, 1), constant_values=0.1)
            idata[name]["space"] = ["x", "y", "z"]
    return idata


def page_of(idata, folder):
    save_posterior(idata, folder / "posterior.nc")
    (folder / "page.html").write_text(view_of(folder / "posterior.nc").html(), "utf-8")
    return folder / "page.html"


@pytest.mark.parametrize("width", WIDTHS)
def test_the_numbers_at_a_time_are_the_posteriors(browser, make_posterior, tmp_path, width):
    idata = make_posterior(2, 80)
    opened(browser, page := page_of(idata, tmp_path), width)
    assert browser.execute_script("return innerWidth") == width
    assert browser.execute_script("return document.documentElement.scrollWidth") <= width
    assert requests(browser, page) == {page.as_uri()}
    go(browser, 33)
    assert browser.find_element("id", "now-time").text == f"{idata.posterior.time.values[33]:.2f} s"
    for column, group in enumerate(("torque", "angle")):
        for joint in range(2):
            low, _, median, _, high = quantiles(idata, group)[:, 33, joint]
            told = value(cells(browser)[joint][column])
            np.testing.assert_allclose(told, [median, low, high], atol=0.06 * (high - low))
    assert browser.get_log("browser") == []


def test_the_body_is_drawn_again_where_only_the_windows_height_changes(browser, make_posterior, tmp_path):
    from selenium.webdriver.support.wait import WebDriverWait

    opened(browser, page_of(make_posterior(2), tmp_path), 1280)
    sizes = "const c = document.getElementById('picture'); return [c.width, c.height, c.clientWidth, c.clientHeight]"
    before = browser.execute_script(sizes)
    lower = {"width": 1280, "height": 600, "deviceScaleFactor": 1, "mobile": False}
    browser.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", lower)
    WebDriverWait(browser, 10).until(lambda _: browser.execute_script(sizes)[3] != before[3])

    def sharp(_):
        *drawn, wide, high = browser.execute_script(sizes)
        return drawn == [wide, high]

    WebDriverWait(browser, 10).until(sharp)


def test_all_move_together(browser, make_posterior, tmp_path):
    """Keys, a drag in a curve and the time that passes: each moves the body, the curves' marks and the table."""
    from selenium.webdriver import ActionChains, Keys
    from selenium.webdriver.support.wait import WebDriverWait

    idata = make_posterior(2, 80)
    opened(browser, page_of(idata, tmp_path), 1280)
    picture = "return document.getElementById('picture').toDataURL()"
    marks = "return [...document.querySelectorAll('.now')].map(mark => parseFloat(mark.style.left))"

    def state():
        return row(browser), browser.execute_script(picture), browser.execute_script(marks), cells(browser)

    def press(*keys):
        ActionChains(browser).send_keys(*keys).perform()

    at_start = state()
    assert at_start[0] == 0
    press(Keys.ARROW_RIGHT)
    assert row(browser) == 1
    ActionChains(browser).key_down(Keys.SHIFT).send_keys(Keys.ARROW_RIGHT).key_up(Keys.SHIFT).perform()
    assert row(browser) == 11
    after = state()
    assert all(one != other for one, other in zip(at_start, after, strict=True))
    assert len(set(after[2])) == 1, "each curve has its mark at the same time"
    press(Keys.END)
    assert row(browser) == 79
    press(Keys.HOME)
    assert state() == at_start
    over = browser.find_elements("css selector", "#chart-2 .u-over")[0]
    middle, quarter = 0, -over.size["width"] // 4
    drag = ActionChains(browser, duration=0).move_to_element_with_offset(over, middle, 0).click_and_hold()
    drag.move_to_element_with_offset(over, quarter, 0).release().perform()
    assert abs(row(browser) - 79 / 4) < 1.5
    shown = row(browser)
    press(" ")
    WebDriverWait(browser, 20).until(lambda _: row(browser) > shown + 3)
    assert browser.find_element("id", "play").text == "Pause"
    press(" ")
    assert browser.find_element("id", "play").text == "Play"
    assert browser.get_log("browser") == []


def test_one_who_cannot_see_it_can_use_it(browser, make_posterior, tmp_path):
    """Every control has a name, the keys reach all of them in order, and pictures say in words what they show."""
    from selenium.webdriver import ActionChains, Keys

    idata = in_space(make_posterior(2, 80))
    opened(browser, page_of(idata, tmp_path), 1280)
    tree = browser.execute_cdp_cmd("Accessibility.getFullAXTree", {})["nodes"]
    kinds = {"button", "slider", "combobox", "image", "region", "table"}
    named = [(node["role"]["value"], node.get("name", {}).get("value", "")) for node in tree if not node.get("ignored")]
    names = [name for kind, name in named if kind in kinds]
    assert len(names) > 10
    assert all(names)
    assert {"Play", "Time", "Front", "Side", "Above"} <= {name for _, name in named}
    assert [name for kind, name in named if kind == "image" and name.startswith("torque of")]
    focused = []
    for _ in range(8):
        ActionChains(browser).send_keys(Keys.TAB).perform()
        focused.append(browser.execute_script("return document.activeElement.id || document.activeElement.textContent"))
    assert focused == ["play", "slider", "speed", "Front", "Side", "Above", "Table of the curves", "Summary of the run"]
    browser.find_element("id", "slider").send_keys(Keys.ARROW_RIGHT)
    assert row(browser) == 1, "the slider's own step, once"
    assert browser.find_element("id", "slider").get_attribute("aria-valuetext") == "0.03 s"
    words = browser.find_element("id", "picture").get_attribute("aria-label")
    x, y, z = idata.posterior.position.mean(("chain", "draw")).values[1, -1]
    told = re.search(r"wrist at (\S+), (\S+), (\S+)", words).groups()
    np.testing.assert_allclose([float(each.replace("−", "-")) for each in told], [x, y, z], atol=0.01)


def test_the_table_has_the_curves(browser, make_posterior, tmp_path):
    from selenium.webdriver.support.wait import WebDriverWait

    idata = make_posterior(2, 150)
    opened(browser, page_of(idata, tmp_path), 1280)
    browser.find_element("css selector", "#all summary").click()
    lines = WebDriverWait(browser, 20).until(lambda _: browser.find_elements("css selector", "#all tbody tr"))
    assert len(lines) == 75
    heads = [head.text for head in browser.find_elements("css selector", "#all thead th")]
    assert heads[:3] == ["time, s", "shoulder torque, N·m", "elbow torque, N·m"]
    low, _, median, _, high = quantiles(idata, "angle")[:, 20, 1]
    last = lines[10].find_elements("tag name", "td")[-1].text
    np.testing.assert_allclose(value(last), [median, low, high], atol=0.06 * (high - low))


def test_a_body_in_space_turns(browser, make_posterior, tmp_path):
    opened(browser, page_of(in_space(make_posterior(2, 30)), tmp_path), 1280)
    seen = set()
    for button in browser.find_elements("css selector", ".seen-from"):
        button.click()
        seen.add(browser.execute_script("return document.getElementById('picture').toDataURL()"))
    assert len(seen) == 3
    assert browser.get_log("browser") == []


@pytest.mark.parametrize("width", WIDTHS)
def test_a_diagnosis_before_and_after(browser, found, tmp_path, width):
    (tmp_path / "page.html").write_text(view_of(found).html(), "utf-8")
    opened(browser, tmp_path / "page.html", width)
    assert browser.execute_script("return document.documentElement.scrollWidth") <= width
    assert "viscous friction" in browser.find_element("tag name", "h1").text
    legend = [each.text for each in browser.find_elements("css selector", ".body .legend li")]
    assert legend == ["simulation as it is", "corrected", "keypoints as seen"]
    tracks, data = diagnosis().tracks, data_of(tmp_path / "page.html")
    before, after = data["panels"][0]["sides"]
    np.testing.assert_allclose(np.array(before["middle"], float), tracks.residual_before[:, 0], atol=1e-3)
    np.testing.assert_allclose(after["middle"], tracks.residual_after[:, 0], atol=1e-3)
    high = (tracks.residual_after + 1.645 * tracks.residual_after_sd)[:, 0]
    np.testing.assert_allclose(after["high"], high, atol=1e-3)
    for arm, replay in zip(data["arms"], (tracks.nominal_replay, tracks.corrected_replay), strict=True):
        np.testing.assert_allclose(np.array(arm["points"])[:, 1:], replay, atol=1e-3)
    site = next(panel for panel in data["panels"] if panel["group"] == "replay error")
    for side, replay in zip(site["sides"], (tracks.nominal_replay, tracks.corrected_replay), strict=True):
        off = np.linalg.norm(replay[:, 0] - tracks.smoothed[:, 0], axis=-1)
        np.testing.assert_allclose(np.array(side["middle"], float), off, atol=1e-3)
    assert browser.get_log("browser") == []


def test_the_folder_and_both_files_of_a_diagnosis_are_the_same_page(found):
    pages = {view_of(found / name).html() for name in ("", "diagnosis.json", "posterior.nc")}
    assert len(pages) == 1


def test_a_diagnosis_that_corrected_nothing_shows_one_simulation(found, make_posterior):
    nothing = diagnosis()
    same = replace(nothing.tracks, corrected_replay=nothing.tracks.nominal_replay)
    save(replace(nothing, tracks=same, posterior=make_posterior(2)), found)
    view = view_of(found)
    assert list(view.arms) == [("simulation as it is", "before")]
    assert [side["style"] for side in view.panels[0]["sides"]] == ["before"]


def test_small_torques_have_a_small_unit(browser, make_posterior, tmp_path):
    """Of a mouse: numbers of the cells, of the words and of the axis are in one unit, and the data in N·m."""
    idata = make_posterior(2, 80)
    for group, name in (("posterior", "torque"), ("constant_data", "truth_torque")):
        idata[group][name] = 1e-6 * idata[group][name]
    opened(browser, page := page_of(idata, tmp_path))
    go(browser, 33)
    low, _, median, _, high = 1e6 * quantiles(idata, "torque")[:, 33, 0]
    cell = cells(browser)[0][0]
    assert cell.endswith("µN·m")
    np.testing.assert_allclose(value(cell), [median, low, high], atol=0.06 * (high - low))
    panel = data_of(page)["panels"][0]
    np.testing.assert_allclose(panel["sides"][0]["middle"][33], 1e-6 * median, rtol=1e-3)
    most = value(re.search(r"to (\S+) at", panel["label"])[1])[0]
    assert most == pytest.approx(1e6 * quantiles(idata, "torque")[2, :, 0].max(), rel=0.01)
    assert with_prefix("rad", 1e-4) == (1.0, "rad")
    assert [with_prefix("N", size) for size in (0.02, 0.002, 2e-6)] == [(1.0, "N"), (1e3, "mN"), (1e6, "µN")]


@pytest.mark.long
def test_a_real_diagnosis(browser, tmp_path):
    save(diagnosed(), tmp_path)
    (tmp_path / "page.html").write_text(view_of(tmp_path).html(), "utf-8")
    opened(browser, tmp_path / "page.html", 390)
    assert "viscous friction" in browser.find_element("tag name", "h1").text
    assert len(browser.find_elements("css selector", ".chart canvas")) == 3
    assert browser.get_log("browser") == []


def test_doubts_stand_first(make_posterior):
    idata = make_posterior(2, num_filters=64)
    idata.attrs["outer_ess"] = 3.0
    html = of_posterior(idata, "posterior.nc").html()
    assert html.index("3 of 64 filters carry the weight") < html.index("<main>")
    idata.attrs["outer_ess"] = 60.0
    assert "In doubt" not in of_posterior(idata, "posterior.nc").html()


def test_hostile_names_run_nothing(browser, make_posterior, tmp_path):
    idata = make_posterior(2, 30)
    idata.posterior["joint"] = list(HOSTILE[:2])
    for group in ("posterior", "posterior_predictive", "observed_data"):
        idata[group]["keypoint"] = list(HOSTILE[1:])
    (tmp_path / "page.html").write_text(of_posterior(idata, HOSTILE[0]).html(), encoding="utf-8")
    opened(browser, tmp_path / "page.html")
    go(browser, 3)
    assert browser.execute_script("return [typeof window.hacked, document.images.length]") == ["undefined", 0]
    assert browser.get_log("browser") == []


def test_a_long_recording_fits(make_posterior):
    """Six joints and an hour at 2 frames a second: thinned, and far below 15 MB."""
    idata = make_posterior(6, 7200, num_filters=2, num_draws=2)
    view = of_posterior(idata, "posterior.nc")
    assert MAX_ROWS / 2 < len(view.time) <= MAX_ROWS
    assert "of 7200 rows" in view.foot
    assert len(view.html().encode()) < 5e6


def test_missing_stays_missing_and_numbers_are_as_fine_as_needed(make_posterior, tmp_path):
    idata = make_posterior(2, 60)
    data = data_of(page_of(idata, tmp_path))
    seen = np.array(data["observed"], float)
    wanted = idata.observed_data.position.values
    np.testing.assert_array_equal(np.isnan(seen), np.isnan(wanted))
    np.testing.assert_allclose(seen, wanted, atol=1e-3)
    middle = np.array(data["panels"][0]["sides"][0]["middle"])
    np.testing.assert_allclose(middle, quantiles(idata, "torque")[2, :, 0], atol=1e-3 * np.ptp(middle))


def test_what_is_no_result_is_refused(tmp_path, found, run):
    (tmp_path / "other").mkdir()
    with pytest.raises(InputError, match=r"expected a posterior, \.nc, or a folder of `invdyn diagnose`"):
        view_of(tmp_path / "other")
    (tmp_path / "other" / "diagnosis.json").write_text("{}")
    with pytest.raises(InputError, match=r"left no posterior\.nc"):
        view_of(tmp_path / "other")
    said = run("view", found, "--out", tmp_path / "page.pdf")
    assert said.exit_code == 2
    assert "page" in said.stderr
    done = run("view", found, "--out", tmp_path / "page.html")
    assert done.exit_code == 0, done.output
    assert done.stdout == f"page       {tmp_path / 'page.html'}\n"
