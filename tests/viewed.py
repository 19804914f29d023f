"""What a page of `invdyn view` shows in a browser, read for tests."""

import json
import re

from reported import Page


def data_of(page):
    return json.loads(Page(page.read_text(encoding="utf-8")).scripts["view-data"])


def value(text):
    """Numbers of a cell such as −1.2 [−1.4, −0.9] N·m."""
    return [float(each.replace("−", "-")) for each in re.findall(r"−?\d+\.?\d*", text)[:3]]


def go(browser, row):
    set_to = "arguments[0].value = arguments[1]; arguments[0].dispatchEvent(new Event('input'))"
    browser.execute_script(set_to, browser.find_element("id", "slider"), row)


def row(browser):
    return int(browser.find_element("id", "slider").get_property("value"))


def cells(browser):
    return [[cell.text for cell in line.find_elements("tag name", "td")] for line in
            browser.find_elements("css selector", "#now tbody tr")]  # fmt: skip
