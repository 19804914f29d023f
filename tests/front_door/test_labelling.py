"""Labels are set in a real browser; the pictures to label are those worth it."""

import json
import socket
import struct
import threading
import time
import urllib.error
import urllib.request
from contextlib import suppress

import numpy as np
import pytest
from browsing import chromium
from filmed import NAMES, joints, picture

from invdyn.label_server import MAX_CONNECTIONS, LabelServer
from invdyn.recordings.tracking.labels import Labels, read_labels, write_labels


@pytest.fixture(scope="module")
def browser(tmp_path_factory):
    """A headless Chromium for this file."""
    with chromium(tmp_path_factory.mktemp("chromium")) as window:
        window.set_window_size(1000, 700)
        yield window


@pytest.fixture
def served(tmp_path):
    """A server of two pictures, with labels of a third before it."""
    write_labels(Labels(np.array([2]), joints([0.2])[1], NAMES), tmp_path / "l.csv")
    pictures = [picture(each) for each in joints([0.1, 0.5])[1]]
    suggested = iter([np.full((2, 3), np.nan), np.array([[5.0, 6.0, 0.9], [np.nan, np.nan, np.nan]])])
    server = LabelServer([4, 9], pictures, NAMES, tmp_path / "l.csv", lambda _: next(suggested))
    thread = threading.Thread(target=server.serve_forever, args=(0.02,))
    with server:
        thread.start()
        yield server
        server.shutdown()
        thread.join()


def test_labels_are_set_in_a_browser(browser, served):
    from selenium.webdriver import ActionChains, Keys
    from selenium.webdriver.support.wait import WebDriverWait

    wait = WebDriverWait(browser, 60)
    browser.get(served.address)
    wait.until(lambda _: browser.find_element("id", "where").text == "Picture 1 of 2 (number 4)")
    canvas = browser.find_element("id", "picture")

    def at(u, v):
        """Move to a pixel of the film; a click's place is a whole pixel of the screen."""
        width, height = canvas.size["width"], canvas.size["height"]
        x, y = (u + 0.5) * width / 40 - width / 2, (v + 0.5) * height / 40 - height / 2
        return ActionChains(browser, duration=0).move_to_element_with_offset(canvas, round(x), round(y))

    def said(words):
        wait.until(lambda _: browser.find_element("id", "said").text == words)

    at(20, 22).click().perform()
    at(12, 30).click().perform()
    said("1 of 2 pictures labelled, written")
    labels = read_labels(served.shared.path)
    assert labels.frames.tolist() == [2, 4]
    step = 40 / canvas.size["width"]  # px of the film on one of the screen
    np.testing.assert_allclose(labels.points[1], [[20, 22], [12, 30]], atol=step)
    assert step < 0.1  # small pictures are shown large
    at(12, 30).click_and_hold().perform()
    at(15, 31).release().perform()  # the second one is dragged
    wait.until(lambda _: np.allclose(read_labels(served.shared.path).points[1, 1], [15, 31], atol=2 * step))
    ActionChains(browser).send_keys(Keys.ARROW_RIGHT).perform()
    wait.until(lambda _: browser.find_element("id", "where").text == "Picture 2 of 2 (number 9)")
    ActionChains(browser).send_keys(Keys.ENTER).perform()  # takes the elbow that is suggested
    said("2 of 2 pictures labelled, written")
    assert read_labels(served.shared.path).points[2, 0].tolist() == [5, 6]
    ActionChains(browser).send_keys("1").send_keys("h").perform()  # no, it cannot be seen here
    at(25, 28).click().perform()
    wait.until(lambda _: read_labels(served.shared.path).seen.tolist() == [[True, True], [True, True], [False, True]])
    browser.find_element("id", "done").click()
    said("Labels are written; you may close this page.")


def test_a_second_tab_is_merged_and_warned(browser, served):
    """Points of both tabs stay; where both set the same one, the second is refused, and says so."""
    from selenium.webdriver import ActionChains
    from selenium.webdriver.support.wait import WebDriverWait

    wait = WebDriverWait(browser, 60)

    def click(u, v):
        canvas = browser.find_element("id", "picture")
        width, height = canvas.size["width"], canvas.size["height"]
        x, y = (u + 0.5) * width / 40 - width / 2, (v + 0.5) * height / 40 - height / 2
        ActionChains(browser, duration=0).move_to_element_with_offset(canvas, round(x), round(y)).click().perform()

    browser.get(served.address)
    wait.until(lambda _: browser.find_element("id", "where").text == "Picture 1 of 2 (number 4)")
    # another tab's, while this one is open: the wrist here, and an elbow
    other = {"since": 0, "changes": [[0, 1, [30, 5], 0], [0, 0, [20, 5], 0]]}
    assert json.loads(request(f"{served.address}labels", json.dumps(other).encode())[1])["refused"] == []
    click(10, 12)  # the elbow
    wait.until(lambda _: "elbow in picture 1 was changed elsewhere" in browser.find_element("id", "said").text)
    assert browser.find_element("id", "said").get_attribute("class") == "bad"
    assert read_labels(served.shared.path).points[1].tolist() == [[20, 5], [30, 5]]
    browser.find_elements("css selector", "#names button")[0].click()
    click(10, 12)  # once more, and it is meant
    wait.until(lambda _: browser.find_element("id", "said").text == "1 of 2 pictures labelled, written")
    np.testing.assert_allclose(read_labels(served.shared.path).points[1], [[10, 12], [30, 5]], atol=0.2)


def test_zoom_sets_finer_points_where_the_pointer_is(browser, served):
    """The pixel under the pointer stays under it, a click hits it, and the whole picture comes back."""
    from selenium.webdriver import ActionChains
    from selenium.webdriver.support.wait import WebDriverWait

    wait = WebDriverWait(browser, 60)
    browser.get(served.address)
    wait.until(lambda _: browser.find_element("id", "where").text == "Picture 1 of 2 (number 4)")
    canvas = browser.find_element("id", "picture")
    box = "const b = arguments[0].getBoundingClientRect(); return [b.x, b.y, b.width, b.height]"
    x, y, width, height = browser.execute_script(box, canvas)
    spot = round(x + 0.8 * width), round(y + 0.7 * height)
    point = [(spot[0] - x) / width * 40 - 0.5, (spot[1] - y) / height * 40 - 0.5]
    turn = """const [canvas, clientX, clientY] = arguments, how = {bubbles: true, cancelable: true};
        canvas.dispatchEvent(new WheelEvent('wheel', {deltaY: -800, clientX, clientY, ...how}))"""
    browser.execute_script(turn, canvas, *spot)
    left, top, larger, _ = browser.execute_script(box, canvas)
    assert larger == pytest.approx(np.exp(2) * width, rel=1e-3)
    below = [(spot[0] - left) / larger * 40 - 0.5, (spot[1] - top) / larger * 40 - 0.5]
    np.testing.assert_allclose(below, point, atol=0.05)
    click = ActionChains(browser, duration=0).w3c_actions
    click.pointer_action.move_to_location(*spot).click()
    click.perform()
    wait.until(lambda _: browser.find_element("id", "said").text == "1 of 2 pictures labelled, written")
    np.testing.assert_allclose(read_labels(served.shared.path).points[1, 0], point, atol=0.05)
    pan = ActionChains(browser, duration=0).key_down("\ue008").w3c_actions
    pan.pointer_action.move_to_location(*spot).pointer_down().move_to_location(spot[0] - 60, spot[1] - 40).pointer_up()
    pan.perform()
    ActionChains(browser).key_up("\ue008").perform()
    moved = browser.execute_script(box, canvas)
    np.testing.assert_allclose([moved[0], moved[1]], [left - 60, top - 40], atol=2)
    assert not np.isfinite(read_labels(served.shared.path).points[1, 1]).any(), "a move of the picture set a joint"
    ActionChains(browser).send_keys("0").perform()
    np.testing.assert_allclose(browser.execute_script(box, canvas), [x, y, width, height], atol=0.5)


def test_done_in_one_tab_waits_for_the_other(browser, served):
    """Labels of the second tab are written after the first one is done; the end comes when it is closed."""
    from selenium.webdriver.support.wait import WebDriverWait

    wait = WebDriverWait(browser, 60)
    browser.get(served.address)
    first = browser.current_window_handle
    wait.until(lambda _: browser.find_element("id", "where").text == "Picture 1 of 2 (number 4)")
    browser.switch_to.new_window("tab")
    browser.get(served.address)
    wait.until(lambda _: browser.find_element("id", "where").text == "Picture 1 of 2 (number 4)")
    second = browser.current_window_handle
    browser.switch_to.window(first)
    browser.find_element("id", "done").click()
    wait.until(lambda _: "Another page still labels" in browser.find_element("id", "said").text)
    assert served.pages == {2}
    assert not served.over
    browser.switch_to.window(second)
    browser.execute_script("joint = 0; set([7, 8])")
    wait.until(lambda _: browser.find_element("id", "said").text == "1 of 2 pictures labelled, written")
    assert read_labels(served.shared.path).points[1, 0].tolist() == [7, 8]
    browser.close()
    browser.switch_to.window(first)
    wait.until(lambda _: served.over)
    assert served.pages == set()


def test_who_says_done_twice_is_believed(served):
    """A page that crashed never says that it was closed."""
    pages = [served.state()["page"] for _ in range(2)]
    say = f"{served.address}done"
    assert json.loads(request(say, b"%d" % pages[0])[1]) == {"open": 1}
    assert request(f"{served.address}state")[0] == 200
    assert json.loads(request(say, b"%d" % pages[0])[1]) == {"open": 0}
    assert served.over


def request(address, content=None, **headers):
    try:
        with urllib.request.urlopen(urllib.request.Request(address, content, headers)) as answer:
            return answer.status, answer.read()
    except urllib.error.HTTPError as error:
        with error:
            return error.code, error.read()


def changes(*each, since=0):
    return json.dumps({"since": since, "changes": each}).encode()


def test_the_server_takes_nothing_else(served):
    before = served.shared.path.read_bytes()
    labels = f"{served.address}labels"
    for length in ("x", "-1", "+2", "1_0", "", str(1 << 30), "9" * 5000):
        assert request(labels, b"[]", **{"Content-Length": length})[0] == 400
    for content in (
        b"",
        b"{}",
        b"[]",
        b"null",
        b"[" * 5000,
        b'{"since": 0, "changes": []',
        b'{"since": 0, "changes": [], "more": 1}',
        b'{"since": "0", "changes": []}',
        b'{"since": true, "changes": []}',
        b'{"since": 0, "changes": {}}',
        changes([0, 0, [1, 2]]),
        changes([0, 0, None]),
        changes([2, 0, [1, 2], 0]),
        changes([-1, 0, [1, 2], 0]),
        changes([0, 2, [1, 2], 0]),
        changes([0.0, 0, [1, 2], 0]),
        changes([0, 0, [1, 2, 3], 0]),
        changes([0, 0, ["a", 2], 0]),
        changes([0, 0, [True, 2], 0]),
    ):
        assert request(labels, content)[0] == 400, content
    assert served.shared.path.read_bytes() == before


@pytest.mark.parametrize("point", ["[null, 2]", "[NaN, 2]", "[1, NaN]", "[1e9, 2]", "[-1, 2]", f"[1{'0' * 400}, 2]"])
def test_half_points_and_points_outside_are_refused(served, point):
    before = served.shared.path.read_bytes()
    content = f'{{"since": 0, "changes": [[0, 0, {point}, 0]]}}'.encode()
    status, words = request(f"{served.address}labels", content)
    assert (status, words[:16]) == (400, b"expected a point")
    assert served.shared.path.read_bytes() == before
    assert np.isnan(served.shared.points).all()


def test_a_change_is_written_and_seen_by_others(served):
    status, answer = request(f"{served.address}labels", changes([0, 0, [1.5, 2], 0]))
    assert status == 200
    ((*place, point, version),) = json.loads(answer)["changed"]
    assert (place, point) == ([0, 0], [1.5, 2.0])
    assert read_labels(served.shared.path).frames.tolist() == [2, 4]
    state = json.loads(request(f"{served.address}state")[1])
    assert state["changed"] == [[0, 0, [1.5, 2.0], version]]
    assert state["revision"] == version


def raw(served, *lines, content=b""):
    """Status of the answer to a request of those lines; None where the server hangs up without one."""
    with socket.create_connection(("127.0.0.1", served.server_port)) as connection:
        connection.sendall("\r\n".join([*lines, "", ""]).encode("latin-1") + content)
        answer = connection.makefile("rb").readline().split()
        return int(answer[1]) if answer else None


def test_only_the_path_itself_is_one(served):
    """No second spelling of a path reaches it: an attacker's guess at one is as good as at any."""
    host, secret = f"Host: 127.0.0.1:{served.server_port}", served.secret
    assert raw(served, f"GET /{secret}/state HTTP/1.1", host) == 200
    for target in (
        f"//{secret}/state",
        f"///{secret}/",
        f"/./{secret}/",
        f"/{secret}//state",
        f"/{secret}/./state",
        f"/{secret}/../{secret}/",
        f"/{secret}/state?",
        f"/{secret}/state#x",
        f"/%{ord(secret[0]):02x}{secret[1:]}/",
        f"http://127.0.0.1:{served.server_port}/{secret}/state",
        f"/{secret}",
        f"/{secret}/picture/2",
        f"/{secret}/picture/-1",
        f"/{secret}/picture/01",
        f"/{secret}/../invdyn/cli.py",
        f"/{secret[:-1]}é/",
        "/x/state",
        "/",
    ):
        assert raw(served, f"GET {target} HTTP/1.1", host) == 404, target


def test_another_host_or_page_reaches_nothing(served):
    """DNS rebinding: a page of evil.example whose name now means 127.0.0.1 knows neither this host nor this origin."""
    port, own = served.server_port, f"Host: 127.0.0.1:{served.server_port}"
    state, labels = f"GET /{served.secret}/state HTTP/1.1", f"POST /{served.secret}/labels HTTP/1.1"
    assert raw(served, state, f"Host: localhost:{port}") == 200
    for host in (f"evil.example:{port}", "127.0.0.1", "127.0.0.1:1", f"127.0.0.1:{port}.evil.example", ""):
        assert raw(served, state, f"Host: {host}") == 404, host
    assert raw(served, state) == 404
    assert raw(served, state, own, "Host: evil.example") == 404
    content = changes([0, 0, [1, 2], 0])
    length = f"Content-Length: {len(content)}"
    for origin in ("http://evil.example", "null", f"https://127.0.0.1:{port}", ""):
        assert raw(served, labels, own, length, f"Origin: {origin}", content=content) == 404, origin
    assert np.isnan(served.shared.points).all()
    assert raw(served, labels, own, length, f"Origin: http://127.0.0.1:{port}", content=content) == 200


@pytest.mark.parametrize("limit", ["MAX_SECONDS", "_Handler.timeout"])
def test_a_connection_that_sends_nothing_is_ended(served, monkeypatch, limit):
    monkeypatch.setattr(f"invdyn.label_server.{limit}", 0.2)
    with socket.create_connection(("127.0.0.1", served.server_port)) as connection:
        connection.sendall(b"GET /")
        assert connection.recv(1) == b""


def test_a_connection_that_sends_slowly_is_ended(served, monkeypatch):
    """Each byte is in time, and their sum is not."""
    monkeypatch.setattr("invdyn.label_server.MAX_SECONDS", 0.2)
    with socket.create_connection(("127.0.0.1", served.server_port)) as connection, suppress(ConnectionError):
        while True:  # until the server's end is closed, and says so by a reset
            connection.sendall(b"a")
            time.sleep(0.005)


def test_one_connection_too_many_is_closed_at_once(served):
    silent = [socket.create_connection(("127.0.0.1", served.server_port)) for _ in range(MAX_CONNECTIONS)]
    try:
        while served.active < MAX_CONNECTIONS:
            time.sleep(0.005)
        with socket.create_connection(("127.0.0.1", served.server_port)) as late:
            assert late.recv(1) == b""
        assert served.active == MAX_CONNECTIONS
    finally:
        for each in silent:
            each.close()
    while served.active:
        time.sleep(0.005)
    assert request(f"{served.address}state")[0] == 200


def test_a_client_that_leaves_is_no_traceback(served, capfd):
    """In the middle of its request, of its content, and of the answer."""
    host, length = f"Host: 127.0.0.1:{served.server_port}", "Content-Length: 100"
    leave = struct.pack("ii", 1, 0)  # a reset, as of a killed browser
    for words in (
        "GET",
        f"GET /{served.secret}/picture/0 HTTP/1.1\r\n{host}\r\n\r\n",
        f"POST /{served.secret}/labels HTTP/1.1\r\n{host}\r\n{length}\r\n\r\n[",
    ):
        for option in (None, leave):
            with socket.create_connection(("127.0.0.1", served.server_port)) as connection:
                if option is not None:
                    connection.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, option)
                connection.sendall(words.encode())
    while served.active:
        time.sleep(0.005)
    assert request(f"{served.address}state")[0] == 200
    assert capfd.readouterr().err == ""
