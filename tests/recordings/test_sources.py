"""Downloads, against a server on this machine."""

import gc
import hashlib
import http.server
import multiprocessing
import threading
import warnings

import pooch
import pytest

from invdyn.recordings import InputError
from invdyn.recordings.catalogue import Source, fetch, round_table

WIDE = (
    "time, pos1\n"
    "0.000000000000000000e+00,1.907377737087045944e-04\n"
    "3.661394119262695312e-03,-9.830300346842930914e-02\n"
)
NARROW = "time, pos1\n0,0.0001907378\n0.003661394,-0.098303\n"


@pytest.fixture
def server(tmp_path, monkeypatch):
    """Serves tmp_path/site in place of GitHub, and keeps downloads in tmp_path/cache."""
    site = tmp_path / "site"
    site.mkdir()

    class Handler(http.server.SimpleHTTPRequestHandler):
        def __init__(self, *args):
            super().__init__(*args, directory=str(site))

        def log_message(self, *args):
            pass

    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), Handler) as httpd:
        thread = threading.Thread(target=httpd.serve_forever, args=(0.01,))
        thread.start()
        address = f"http://127.0.0.1:{httpd.server_port}"
        monkeypatch.setattr(Source, "url", property(lambda self: f"{address}/{self.path}"))
        monkeypatch.setattr("pooch.os_cache", lambda name: tmp_path / "cache" / name)
        monkeypatch.delenv("INVDYN_DATA", raising=False)
        for variable in ("http_proxy", "HTTP_PROXY", "all_proxy", "ALL_PROXY"):
            monkeypatch.delenv(variable, raising=False)
        yield site
        httpd.shutdown()
        thread.join()
        with warnings.catch_warnings():  # a client that refused an answer leaves its socket to the collector
            warnings.simplefilter("ignore")
            gc.collect()


def source(text: str, **changes) -> Source:
    sha256 = hashlib.sha256(text.encode()).hexdigest()
    fields = {"file": "arm/rec.csv", "repository": "a/b", "commit": "c", "path": "rec.csv", "sha256": sha256}
    return Source(**(fields | changes))


def test_a_file_is_downloaded_once_and_checked(server):
    (server / "rec.csv").write_text(WIDE)
    path = fetch(source(WIDE))
    assert path.read_text() == WIDE
    (server / "rec.csv").unlink()
    assert fetch(source(WIDE)) == path  # from the cache


def test_a_wide_table_is_kept_and_hashed_with_seven_digits(server):
    (server / "rec.csv").write_text(WIDE)
    assert fetch(source(NARROW, rounded=True)).read_text() == NARROW
    assert round_table(NARROW) == NARROW


@pytest.mark.parametrize("rounded", [False, True])
def test_another_files_hash_is_refused_and_nothing_is_kept(server, tmp_path, rounded):
    (server / "rec.csv").write_text("time\n1\n")
    with pytest.raises(InputError, match=r"could not download .*hash.* set INVDYN_DATA"):
        fetch(source(NARROW, rounded=rounded))
    assert [p for p in (tmp_path / "cache").rglob("*") if p.is_file()] == []


def test_a_page_that_is_not_there(server):
    with pytest.raises(InputError, match=r"could not download .*404") as caught:
        fetch(source(WIDE))
    assert len(str(caught.value).splitlines()) == 1


def test_the_folder_comes_first_and_says_what_it_lacks(tmp_path, monkeypatch):
    monkeypatch.setenv("INVDYN_DATA", str(tmp_path))
    (tmp_path / "arm").mkdir()
    (tmp_path / "arm" / "rec.csv").write_text("any")  # the user's own folder is not hashed
    assert fetch(source(WIDE)) == tmp_path / "arm" / "rec.csv"
    with pytest.raises(InputError, match=r"there is no file arm/other.csv in it"):
        fetch(source(WIDE, file="arm/other.csv"))


def test_what_is_not_published_needs_the_folder(monkeypatch):
    monkeypatch.delenv("INVDYN_DATA", raising=False)
    with pytest.raises(InputError, match=r"film\.csv is not published: set INVDYN_DATA"):
        fetch(Source("film.csv"))


def fetch_with_another(wanted, both_found_nothing, results):
    """One of two processes; neither downloads before both have looked into the empty cache."""
    own = pooch.HTTPDownloader

    def downloader(**options):
        load = own(**options)

        def wait_and_load(*arguments, **more):
            both_found_nothing.wait()
            return load(*arguments, **more)

        return wait_and_load

    pooch.HTTPDownloader = downloader
    results.put(fetch(wanted).read_text())


def test_two_processes_that_start_on_an_empty_cache_both_succeed(server, tmp_path):
    (server / "rec.csv").write_text(WIDE)
    context = multiprocessing.get_context("fork")
    both, results = context.Barrier(2), context.SimpleQueue()
    arguments = source(WIDE), both, results
    processes = [context.Process(target=fetch_with_another, args=arguments) for _ in range(2)]
    for process in processes:
        process.start()
    for process in processes:
        process.join()
    assert [process.exitcode for process in processes] == [0, 0]
    assert [results.get(), results.get()] == [WIDE, WIDE]
    assert len([path for path in (tmp_path / "cache").rglob("*") if path.is_file()]) == 1
