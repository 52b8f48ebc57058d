"""Pictures named by URL."""

import threading
from collections.abc import Iterator
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import cv2
import pytest

from circlecal.pictures.remote import is_url, read_url, url_names

from .runs import records


class Silent(SimpleHTTPRequestHandler):
    def log_message(self, *details: object) -> None:
        pass


@pytest.fixture(autouse=True)
def without_proxy(monkeypatch: pytest.MonkeyPatch) -> None:
    """Where the surroundings name a proxy, it does not serve this machine's own addresses."""
    monkeypatch.setenv("no_proxy", "127.0.0.1")


@pytest.fixture
def served(frame_file: Path) -> Iterator[str]:
    """Address of a server of the folder of the good frame."""
    server = ThreadingHTTPServer(("127.0.0.1", 0), partial(Silent, directory=str(frame_file.parent)))
    threading.Thread(target=server.serve_forever, daemon=True).start()
    yield f"http://127.0.0.1:{server.server_address[1]}"
    server.shutdown()
    server.server_close()


def test_pictures_of_a_server(run_circlecal, in_this_process, served, frame_file, tmp_path, monkeypatch):
    frame_file.with_name("no.png").write_text("no picture")
    frame_file.with_name("small.png").write_bytes(cv2.imencode(".png", cv2.imread(str(frame_file))[:20])[1].tobytes())
    names = tmp_path / "names.txt"
    names.write_text(f"{served}/good.png\n{served}/missing.png\n{served}/no.png?size=large\n{served}/small.png\n")
    out = tmp_path / "out"
    outcome = run_circlecal("batch", names, f"{served}/good.png", "--out", out, "--workers", 1, "--files")
    assert outcome.code == 1
    assert outcome.out.startswith("4 frames: 1 calibrated, 3 refused (3 of them unreadable)")
    found = {record["id"]: record for record in records(out)}
    assert found["good"]["source"]["path"] == f"{served}/good.png"
    assert f"{served}/missing.png: cannot be fetched: 404" in found["missing"]["reason"]
    assert f"{served}/no.png?size=large: is no JPEG" in found["no"]["reason"]
    assert f"{served}/small.png: has only 960 x 20" in found["small"]["reason"]
    run_circlecal("batch", frame_file, "--out", tmp_path / "local", "--workers", 1)
    assert found["good"]["H_image_field"] == records(tmp_path / "local")[0]["H_image_field"]


def test_a_video_of_a_server_is_to_be_saved(run_circlecal, in_this_process, served, tmp_path):
    for url in (f"{served}/match.mp4", "file:///match.MP4"):
        outcome = run_circlecal("batch", url, "--out", tmp_path / "out", "--workers", 1)
        assert outcome.code == 2
        assert outcome.err == f"circlecal: error: {url}: is the URL of a video; save the video, and give its file\n"
    outcome = run_circlecal(
        "batch", f"{served}/match.mp4", f"{served}/good.png", "--out", tmp_path / "out", "--workers", 1
    )
    assert outcome.code == 2 and outcome.out.startswith("1 frame: 1 calibrated"), outcome


def test_a_url_with_another_protocol(frame_file):
    pytest.importorskip("fsspec", reason="the extra distributed is not installed")
    assert read_url(frame_file.as_uri()) == frame_file.read_bytes()


def test_ids():
    urls = ["https://a/x/f%201.jpg?k=1", "s3://b/f 1.png", "http://c/", "gs://d/e/g.h.tif"]
    assert all(map(is_url, urls))
    assert url_names(urls[2:], ["g.h"])[0] == "frame"
    assert len(set(url_names(urls, ["f 1"]))) == 4
    assert not any(map(is_url, ["a/b.jpg", "C:\\x.jpg", "@list", "/a://b"]))


def test_no_server(run_circlecal, in_this_process, tmp_path):
    outcome = run_circlecal("batch", "http://127.0.0.1:9/x.jpg", "--out", tmp_path / "out", "--workers", 1)
    assert outcome.code == 1
    assert "cannot be fetched" in records(tmp_path / "out")[0]["reason"]
    assert run_circlecal("calibrate", "@missing", "--out", tmp_path / "out").code == 2
