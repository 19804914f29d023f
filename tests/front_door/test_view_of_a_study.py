"""The page of a study, in a real browser: trials by condition, aligned at an event, and what was left out."""

import numpy as np
import pandas as pd
import pytest
import xarray as xr
from browsing import opened
from viewed import cells, data_of, go, value

from invdyn.recordings import InputError
from invdyn.view import view_of

WIDTHS = (1280, 390)


@pytest.fixture
def study(tmp_path):
    """A folder as `invdyn trials` leaves it: two levels of two trials each, whose event is at another time of each."""
    folder, rng = tmp_path / "study", np.random.default_rng(0)
    (folder / "posteriors").mkdir(parents=True)
    (folder / "in_doubt.csv").write_text("trial,subject,session,doubt\n")
    (folder / "left_out.csv").write_text("trial,subject,session,reason\nt9,1,1,it is <b>gone</b>\n")
    times = np.linspace(-0.2, 0.3, 11)
    rows = [
        {"joint": joint, "condition": level, "time": t, "mean": k + t + n, "q05": k + t + n - 1, "q95": k + t + n + 1}
        | {"trial_q05": k + t + n - 2, "trial_q95": k + t + n + 2, "unit": "N·m", "trials": 2}
        for k, joint in enumerate(("shoulder", "elbow")) for n, level in enumerate(("01", "2")) for t in times
    ]  # fmt: skip
    pd.DataFrame(rows).to_csv(folder / "averages_touch.csv", index=False)
    pd.DataFrame(rows).to_csv(folder / "averages_lift.csv", index=False)
    pd.DataFrame({"joint": ["elbow"], "quantity": ["peak"], "mean": [1.23456], "found": [True]}).to_csv(
        folder / "differences.csv", index=False
    )
    clock = np.tile(np.arange(31) / 30, (4, 1))
    events = np.array([0.3, 0.4, 0.5, np.nan])
    torque = (clock - events[:, None])[:, None, :, None] + np.array([0.0, 1.0]) + 0.01 * rng.normal(size=(4, 49, 31, 2))
    xr.Dataset(
        {"torque": (("trial", "draw", "row", "joint"), torque), "time": (("trial", "row"), clock)},
        {
            "joint": ["shoulder", "elbow"],
            "condition": ("trial", ["01", "01", "2", "2"]),
            "event_touch": ("trial", events),
        },
    ).to_netcdf(folder / "posteriors" / "1_1.nc", engine="h5netcdf")
    files = [file.relative_to(folder).as_posix() for file in folder.rglob("*.*")]
    (folder / "files.txt").write_text("\n".join(files))
    return folder


@pytest.mark.parametrize("width", WIDTHS)
def test_a_study_by_condition_aligned(browser, study, tmp_path, width):
    (tmp_path / "page.html").write_text(view_of(study, "touch").html(), "utf-8")
    opened(browser, tmp_path / "page.html", width)
    assert browser.execute_script("return document.documentElement.scrollWidth") <= width
    assert browser.find_element("tag name", "h1").text == "Torques of 4 trials by condition"
    assert "t9 is left out: it is <b>gone</b>" in browser.find_element("tag name", "header").text
    legend = [each.text for each in browser.find_elements("css selector", ".curves .legend li")]
    assert legend == ["01 (2 trials)", "2 (2 trials)"]
    go(browser, 6)  # .1 s after the event
    told = [value(line) for line in cells(browser)[1][0].splitlines()]
    np.testing.assert_allclose(told, [[1.1, -0.9, 3.1], [2.1, 0.1, 4.1]], atol=0.051)
    panel = data_of(tmp_path / "page.html")["panels"][1]
    assert [each["style"] for each in panel["trials"]] == ["after", "after", "before"], "the fourth lacks the event"
    for each in panel["trials"]:  # each trial's torque is the time after its event, and 1
        np.testing.assert_allclose(each["values"], 1.0 + np.linspace(-0.2, 0.3, 11), atol=0.01)
    assert "1.23" in browser.find_element("css selector", ".curves [aria-label=Differences]").text
    assert browser.get_log("browser") == []


def test_a_study_s_bands_are_the_average_s_and_a_further_trial_s(study):
    """Of the elbow under level 2, whose mean is two more than the time."""
    side = view_of(study, "touch").panels[1]["sides"][1]
    for name, more in (("low", -2), ("lower", -1), ("middle", 0), ("upper", 1), ("high", 2)):
        np.testing.assert_allclose(side[name], np.linspace(-0.2, 0.3, 11) + 2 + more, atol=1e-3)


def test_a_study_begins_at_its_event(browser, study, tmp_path):
    averages = pd.read_csv(study / "averages_touch.csv", dtype={"condition": str})
    averages["time"] -= 1e-3
    averages.to_csv(study / "averages_touch.csv", index=False)
    (tmp_path / "page.html").write_text(view_of(study, "touch").html(), "utf-8")
    opened(browser, tmp_path / "page.html")
    assert browser.find_element("id", "now-time").text == "0.00 s"
    place = "return [...document.querySelectorAll('#chart-0 .now, #chart-0 .event')].map((each) => each.offsetLeft)"
    now, event = browser.execute_script(place)
    assert now == pytest.approx(event, abs=3)
    assert event > 0
    go(browser, 0)
    assert browser.find_element("id", "now-time").text == "−0.20 s"
    now, same = browser.execute_script(place)
    assert now < same == event


def test_many_trials_that_do_not_count_are_a_table(study):
    lines = [f"t{number},1,1,reason {number}" for number in range(20)]
    (study / "left_out.csv").write_text("\n".join(["trial,subject,session,reason", *lines]))
    view = view_of(study, "touch")
    assert view.doubts[2:] == ["t2 is left out: reason 2", "17 more, in the tables at the end of this page"]
    assert view.tables["Left out"] == [["trial", "subject", "session", "reason"], *(line.split(",") for line in lines)]
    assert "In doubt" not in view.tables
    (study / "left_out.csv").write_text("\n".join(["trial,subject,session,reason", *lines[:4]]))
    assert view_of(study, "touch").doubts[3:] == ["t3 is left out: reason 3"], "no line for a single one"


def test_a_study_is_aligned_at_an_event_of_its_own(study):
    assert view_of(study).kicker.endswith("aligned at lift")
    with pytest.raises(InputError, match="expected --align with an event among lift, touch, got 'go'"):
        view_of(study, "go")
    with pytest.raises(InputError, match="leave --align out"):
        view_of(study / "posteriors" / "1_1.nc", "touch")
