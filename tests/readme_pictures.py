"""The pictures of the README: ``python -m tests.readme_pictures samples/pictures`` makes them again.

Pages are photographed in headless Chromium; everything shown is made from the samples.
"""

from __future__ import annotations

import contextlib
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np

from circlecal.pictures.files import OVERLAY_SUFFIX
from tests.report.browser import Browser

SAMPLES = Path(__file__).parents[1] / "samples"
COMMAND = (sys.executable, "-m", "circlecal")
MOST_BYTES = 200_000
"""Of one picture."""
WIDTH = 1280
"""Of pages, CSS pixels."""
DRAWN = ("australian-football", "curling", "field-hockey", "lacrosse", "netball", "wrestling")
"""Fields that no sample shows."""
READY = "document.body.dataset.ready && document.getElementById('busy').hidden"


def write_pictures(folder: Path) -> list[Path]:
    """Every picture, into a folder."""
    with tempfile.TemporaryDirectory() as name:
        work = Path(name)
        shutil.copytree(SAMPLES, work / "samples")  # paths in pictures are those of the README's commands
        _run(work, "calibrate", "samples/hidden_mark.jpg", "--radar", "--out", "out")
        _run(work, "debug", "samples/hidden_mark.jpg", "--out", "debug")
        _run(work, "batch", "samples", "--out", "circlecal-run", "--no-overlay", codes=(0, 1))
        _run(work, "report", "circlecal-run")
        kept = [
            _keep(cv2.imread(str(work / "out" / f"hidden_mark{OVERLAY_SUFFIX}")), folder / "hidden_mark.overlay.jpg"),
            _keep(cv2.imread(str(next((work / "out").glob("*radar*")))), folder / "hidden_mark.radar.overlay.jpg"),
            _keep(
                cv2.imread(str(next((work / "debug").rglob("*sheet*")))), folder / "hidden_mark.debug-sheet.overlay.jpg"
            ),
        ]
        _run(work, "fields", "--draw", "fields")
        kept += [
            _keep(cv2.imread(str(work / "fields" / f"{field}.png")), folder / f"{field}.field.overlay.jpg", (480, 85))
            for field in DRAWN
        ]
        browser = Browser(WIDTH, 720)
        try:
            browser.prefer("light")
            kept += _photograph_report(browser, work / "circlecal-run" / "circlecal-report" / "index.html", folder)
            kept += _photograph_workbench(browser, work, folder)
        finally:
            browser.close()
    return kept


def _photograph_report(browser: Browser, page: Path, folder: Path) -> Iterator[Path]:
    browser.open(page)
    browser.wait("document.querySelectorAll('.card').length")
    time.sleep(0.5)
    yield _photograph(browser, folder / "report.overlay.jpg")
    browser.run("location.hash = 'q=hidden_mark&frame=' + [...document.querySelectorAll('.card .name')]"
                ".findIndex(e => e.textContent === 'hidden_mark')")  # fmt: skip
    browser.wait("document.querySelector('#facts dd')")
    browser.run("document.getElementById('show-heat').click()")
    time.sleep(0.5)
    yield _photograph(browser, folder / "report-frame.overlay.jpg")


def _photograph_workbench(browser: Browser, work: Path, folder: Path) -> Iterator[Path]:
    with _served(work) as address:
        browser.open(address)
        browser.wait(READY)
        browser.wait("document.querySelector('#offers button')")
        yield _photograph(browser, folder / "workbench-before.overlay.jpg")
        browser.run("document.querySelector('#offers button').click()")
        browser.wait("document.getElementById('verdict').textContent.startsWith('calibrated')")
        time.sleep(1.0)
        yield _photograph(browser, folder / "workbench.overlay.jpg")


@contextlib.contextmanager
def _served(work: Path) -> Iterator[str]:
    command = [*COMMAND, "annotate", "samples/touchline_only.jpg", "--no-browser", "-q"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True, cwd=work) as server:
        try:
            if server.stdout is None:
                raise RuntimeError("the workbench prints no address")
            yield server.stdout.readline().strip()
        finally:
            server.terminate()


def _photograph(browser: Browser, path: Path) -> Path:
    taken = path.with_suffix(".png")
    browser.screenshot(taken)
    picture = cv2.imread(str(taken))
    taken.unlink()
    return _keep(picture, path)


def _keep(picture: np.ndarray | None, path: Path, first: tuple[int, int] = (WIDTH, 85)) -> Path:
    """Write a JPEG of at most :data:`MOST_BYTES`, of a width and a quality, smaller and coarser until it is."""
    if picture is None:
        raise RuntimeError(f"{path}: was not drawn")
    for width, quality in (first, (WIDTH, 70), (1000, 70), (800, 65)):
        share = min(1.0, width / picture.shape[1])
        smaller = cv2.resize(picture, None, fx=share, fy=share, interpolation=cv2.INTER_AREA)
        content = cv2.imencode(".jpg", smaller, [cv2.IMWRITE_JPEG_QUALITY, quality])[1].tobytes()
        if len(content) <= MOST_BYTES:
            break
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(content)
    return path


def _run(work: Path, *arguments: str, codes: tuple[int, ...] = (0,)) -> None:
    ended = subprocess.run([*COMMAND, *arguments], capture_output=True, text=True, cwd=work)
    if ended.returncode not in codes:
        raise RuntimeError(f"circlecal {' '.join(arguments)}: {ended.stderr}")


if __name__ == "__main__":
    for path in write_pictures(Path(sys.argv[1])):
        sys.stdout.write(f"{path}: {path.stat().st_size // 1000} kB\n")
