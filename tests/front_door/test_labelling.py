"""Labels are set in a real browser; the pictures to label are those worth it."""

import json
import threading
import urllib.error
import urllib.request

import numpy as np
import pytest
from browsing import chromium
from filmed import NAMES, SHOULDER, joints, picture, swinging, write_film

from invdyn.label_server import LabelServer
from invdyn.recordings import InputError
from invdyn.recordings.tracking.choose import different, surprising
from invdyn.recordings.tracking.film import Film
from invdyn.recordings.tracking.heatmap import HeatmapTracker
from invdyn.recordings.tracking.labels import Labels, read_labels, write_labels
from invdyn.recordings.tracking.unet import UNet
from invdyn.surprise import surprise


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
    before = read_labels(tmp_path / "l.csv")
    server = LabelServer([4, 9], pictures, NAMES, tmp_path / "l.csv", before, lambda _: next(suggested))
    thread = threading.Thread(target=server.serve_forever)
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
    labels = read_labels(served.out)
    assert labels.frames.tolist() == [2, 4]
    step = 40 / canvas.size["width"]  # px of the film on one of the screen
    np.testing.assert_allclose(labels.points[1], [[20, 22], [12, 30]], atol=step)
    assert step < 0.1  # small pictures are shown large
    at(12, 30).click_and_hold().perform()
    at(15, 31).release().perform()  # the second one is dragged
    wait.until(lambda _: np.allclose(read_labels(served.out).points[1, 1], [15, 31], atol=2 * step))
    ActionChains(browser).send_keys(Keys.ARROW_RIGHT).perform()
    wait.until(lambda _: browser.find_element("id", "where").text == "Picture 2 of 2 (number 9)")
    ActionChains(browser).send_keys(Keys.ENTER).perform()  # takes the elbow that is suggested
    said("2 of 2 pictures labelled, written")
    assert read_labels(served.out).points[2, 0].tolist() == [5, 6]
    ActionChains(browser).send_keys("1").send_keys("h").perform()  # no, it cannot be seen here
    at(25, 28).click().perform()
    wait.until(lambda _: read_labels(served.out).seen.tolist() == [[True, True], [True, True], [False, True]])
    browser.find_element("id", "done").click()
    said("Labels are written; you may close this page.")


def ask(address, content=None):
    try:
        with urllib.request.urlopen(address, content) as answer:
            return answer.status, answer.read()
    except urllib.error.HTTPError as error:
        with error:
            return error.code, error.read()


def test_the_server_takes_nothing_else(served):
    before = served.out.read_bytes()
    root = f"http://127.0.0.1:{served.server_port}/"
    assert ask(root)[0] == 404  # the word is secret
    assert ask(f"{root}x/state")[0] == 404
    assert ask(f"{root}x/labels", b"[]")[0] == 404
    assert ask(f"{served.address}picture/1")[0] == 200
    for path in ("picture/2", "picture/-1"):
        assert ask(f"{served.address}{path}")[0] == 404
    for length in ("x", "-1", str(1 << 30)):
        call = urllib.request.Request(f"{served.address}labels", b"[]", {"Content-Length": length})
        assert ask(call)[0] == 400
    assert ask(f"{served.address}../invdyn/cli.py")[0] == 404
    huge = f"[[[1{0:0400},2],null],[null,null]]".encode()  # more than a float64 holds
    for content in (
        b"",
        b"{}",
        b"[]",
        b"[[[1,2],[3]],[null,null]]",
        b'[[["a",2],null],[null,null]]',
        b"[" * 5000,
        huge,
    ):
        assert ask(f"{served.address}labels", content)[0] == 400
    assert ask(f"{served.address}labels", json.dumps([[[1e9, 2], None], [None, None]]).encode())[0] == 400
    assert served.out.read_bytes() == before
    assert ask(f"{served.address}labels", json.dumps([[[1.5, 2], None], [None, None]]).encode()) == (200, b"written")
    assert read_labels(served.out).frames.tolist() == [2, 4]
    assert json.loads(ask(f"{served.address}state")[1])["points"] == [[[1.5, 2.0], None], [None, None]]


def test_different_pictures_are_chosen(tmp_path):
    """Of long rests in three poses, one picture each; then what is labelled is left alone."""
    poses = [SHOULDER + np.array(each) for each in (((0, 10), (0, 19)), ((10, 0), (19, 0)), ((-10, 0), (-10, 9)))]
    order = [0] * 10 + [1] * 5 + [2] * 2
    film = Film(write_film(tmp_path / "f.mov", [picture(poses[i]) for i in order], np.arange(17) / 30))
    chosen = different(film, 3)
    assert sorted(order[number] for number in chosen) == [0, 1, 2]
    assert order[different(film, 1, [0, 11])[0]] == 2
    assert len(different(film, 99, [3])) == 16
    with pytest.raises(InputError, match="all of its pictures are labelled"):
        different(film, 1, range(17))


def test_surprising_pictures_are_chosen(make_posterior):
    idata = make_posterior(2, 60, missing=True)
    usual = surprise(idata)
    observed = idata["observed_data"]["position"]
    observed.loc[{"time": observed["time"][[10, 11, 40]]}] += 2.0  # strays
    found = surprise(idata)
    assert set(np.argsort(-found)[:3]) == {10, 11, 40}
    same = np.delete(np.arange(60), [10, 11, 40])
    np.testing.assert_array_equal(found[same], usual[same])
    numbers = np.arange(60) + 100
    assert surprising(found, numbers, 2) in ([110, 140], [111, 140])  # of two that are near, one
    assert 140 not in surprising(found, numbers, 2, {140})
    assert surprising(np.full(60, -np.inf), numbers, 2) == []


def test_the_command_labels_and_goes_on(tmp_path, monkeypatch, run):
    swinging(tmp_path / "f.mov", 20)
    monkeypatch.chdir(tmp_path)

    def user(server):
        server.take([[[1.0, 2.0], [3.0, 4.0]] for _ in server.numbers])

    monkeypatch.setattr(LabelServer, "serve_forever", user)
    call = ("label", "f.mov", "--out", "l.csv", "--count", "3", "--no-browser")
    outcome = run(*call)
    assert outcome.exit_code == 2
    assert outcome.stderr.startswith("error: expected --keypoints, the joints to label")
    outcome = run(*call, "--keypoints", "elbow, wrist")
    assert outcome.exit_code == 0, outcome.output
    assert outcome.stdout.startswith("3 pictures to label: http://127.0.0.1:")
    outcome = run(*call)
    assert outcome.stdout.endswith("6 labelled pictures\nlabels     l.csv\n")
    assert len(read_labels(tmp_path / "l.csv")) == 6
    HeatmapTracker(UNet(2, (8,)), NAMES, (20, 20), [9.0] * 3, [9.0] * 3, widths=(8,)).save("n.safetensors")
    shown = []
    monkeypatch.setattr(LabelServer, "serve_forever", lambda server: shown.extend(server.suggested))
    assert run(*call, "--network", "n.safetensors").exit_code == 0
    assert np.array(shown).shape == (3, 2, 2)
    assert (np.array(shown) < 41).all()
    outcome = run(*call, "--keypoints", "hand")
    assert outcome.exit_code == 2
    assert "labels of elbow, wrist are there" in outcome.stderr


def test_labels_of_a_larger_film_are_not_continued(tmp_path, run):
    swinging(tmp_path / "film.mov", 5)
    write_labels(Labels(np.array([2]), np.full((1, 2, 2), 55.0), NAMES), tmp_path / "l.csv")
    before = (tmp_path / "l.csv").read_bytes()
    said = run("label", tmp_path / "film.mov", "--out", tmp_path / "l.csv", "--no-browser")
    assert said.exit_code == 2
    assert "l.csv: elbow of picture 2 lies outside its pictures of 40 × 40 px, at (55, 55)" in said.stderr
    assert (tmp_path / "l.csv").read_bytes() == before
