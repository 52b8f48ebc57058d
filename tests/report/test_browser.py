"""The page as people use it, in headless Chromium."""

import json
import re
import shlex
from pathlib import Path

import cv2
import numpy as np
import pytest

from circlecal.checks import CHECKS
from circlecal.field.view import FieldView
from circlecal.geometry.camera import Camera, PlaneCamera
from circlecal.geometry.surface import Surface
from circlecal.overlay.page_view import describe_view
from circlecal.pictures.files import REPORT_FOLDER
from circlecal.records.json_text import result_line
from circlecal.report import ReportOptions, read_run, write_report
from circlecal.report.pages import tell_workbench
from tests.report.browser import Browser, programs
from tests.report.conftest import refused, write_run
from tests.report.test_pages import NASTY, contrast

pytestmark = pytest.mark.skipif(programs() is None, reason="needs Chromium and chromedriver")

IDS = "[...document.querySelectorAll('.card .name')].map(e => e.textContent)"
OPEN = "document.getElementById('large').open"
TITLE = "document.getElementById('large-title').textContent"
FOCUSED = "document.activeElement.querySelector('.name')?.textContent"


@pytest.fixture(scope="module")
def browser():
    started = Browser()
    yield started
    started.close()


@pytest.fixture(scope="module")
def report(tmp_path_factory, named, frame_image) -> Path:
    """Six pictures, three of them refused, and a video of four frames."""
    folder = tmp_path_factory.mktemp("report")
    picture = folder / "good.png"
    cv2.imwrite(str(picture), frame_image)
    records = [
        named("f1", 9.0, str(picture)),
        named("f2", 2.0, str(picture), case=3),
        named("f10", 30.0, rig={"camera": "camera-1", "alone": {"status": "refused", "code": "rotation_free"}}),
        refused("f3"),
        refused("f4", "too_uncertain", "uncertain by 99 px", "verdict"),
        refused(NASTY, "circle_support_too_low"),
        *(named(f"v{t}", 3.0 + t, source={"path": "match.mp4", "time_s": float(t)}) for t in range(3)),
        refused("v3") | {"source": {"path": "match.mp4", "time_s": 3.0}},
    ]
    earlier = [refused("f1"), named("f2", 20.0), named("f10", 30.0), named("f3"), *records[4:6]]
    run, other = read_run(write_run(folder / "run", records)), read_run(write_run(folder / "earlier", earlier))
    return write_report(run, None, ReportOptions(title="Cup final"), against=other).page


def point_at(browser: Browser, selector: str, share: tuple[float, float], *kinds: str, **more) -> None:
    """Mouse events at a share of an element's width and height."""
    box = browser.run(
        "const e = document.querySelector(arguments[0]); e.scrollIntoView({ block: 'center' });"
        "const b = e.getBoundingClientRect(); return [b.x, b.y, b.width, b.height]",
        selector,
    )
    x, y = box[0] + share[0] * box[2], box[1] + share[1] * box[3]
    for kind in kinds:
        button = {"mouseMoved": "none", "mouseWheel": "none"}.get(kind, "left")
        held = 1 if more.get("held") else 0
        wheel = {"deltaX": 0, "deltaY": more.get("wheel", 0)} if kind == "mouseWheel" else {}
        browser.devtools(
            "Input.dispatchMouseEvent", type=kind, x=x, y=y, button=button, clickCount=1, buttons=held, **wheel
        )


@pytest.fixture(scope="module")
def wide_lens() -> FieldView:
    """A view with a strong lens and a crowned field, whose upper rows are above the horizon."""
    camera = Camera(
        width=1280,
        height=720,
        focal_px=np.array([900.0, 905.0]),
        principal_point_px=np.array([650.0, 350.0]),
        angles_rad=np.radians([12.0, 80.0, 1.5]),
        position_m=np.array([4.0, 60.0, -14.0]),
        kappa=np.array([0.12, -0.02]),
    )
    return FieldView(camera, Surface("parabola", 9.15, 0.06))


@pytest.fixture
def page(browser, report):
    """The report freshly opened; at the end nothing went wrong and nothing left the folder."""
    browser.resize(1280, 900)
    browser.prefer("light")
    browser.console()
    browser.open(report)
    browser.wait("document.querySelectorAll('.card').length")
    browser.requests()
    yield browser
    assert browser.console() == []
    base = report.parent.as_uri()
    outside = [url for url in browser.requests() if not url.startswith((base, "data:,", "about:"))]
    assert not outside


def choose(browser: Browser, name: str, value: str, count: int) -> None:
    script = """
        const field = document.getElementById('filter').elements[arguments[0]];
        if (field.type === 'checkbox') field.checked = Boolean(arguments[1]); else field.value = arguments[1];
        field.dispatchEvent(new Event('input', { bubbles: true }));
    """
    browser.run(script, name, value)
    browser.wait(f"(new URLSearchParams(location.hash.slice(1)).get('{name}') || '') === {json.dumps(value)}")
    browser.wait(f"document.querySelectorAll('.card').length === {count}")


def test_all_frames_are_there_in_order(page):
    ids = page.run(f"return {IDS}")
    assert ids == [NASTY, "f1", "f2", "f3", "f4", "f10", "v0", "v1", "v2", "v3"]
    assert "10 of 10 frames: 6 calibrated, 4 refused" in page.run("return document.body.innerText")


@pytest.mark.parametrize(
    ("name", "value", "ids"),
    [
        ("verdict", "refused", [NASTY, "f3", "f4", "v3"]),
        ("reason", "too_uncertain", ["f4"]),
        ("case", "3", ["f2"]),
        ("from", "18", ["f1", "f10"]),  # of pictures of 960 px width, whose sigma is 9 px of their own
        ("to", "5", ["f2"]),
        ("camera", "camera-1", ["f10"]),
        ("rig", "gained", ["f10"]),
        ("change", "1", ["f1"]),
        ("change", "2", ["f3"]),
        ("change", "4", ["f2"]),
        ("q", "F1", ["f1", "f10"]),
        ("q", "uncertain 99", ["f4"]),
        ("q", "nothing like it", []),
    ],
)
def test_filter(page, name, value, ids):
    choose(page, name, value, len(ids))
    assert page.run(f"return {IDS}") == ids
    assert f"{len(ids)} of 10 frames" in page.run("return document.getElementById('count').textContent")
    page.run("document.querySelector('#filter button[type=reset]').click()")
    page.wait("document.querySelectorAll('.card').length === 10")


def test_sort(page):
    choose(page, "verdict", "calibrated", 6)
    choose(page, "sort", "sigma", 6)
    page.wait(f"{IDS}[0] === 'f2'")
    assert page.run(f"return {IDS}") == ["f2", "v0", "v1", "v2", "f1", "f10"]
    choose(page, "down", "1", 6)
    page.wait(f"{IDS}[0] === 'f10'")
    assert page.run(f"return {IDS}")[-1] == "f2"
    choose(page, "verdict", "", 10)  # frames without a sigma stay last
    page.wait(f"{IDS}[0] === 'f10'")
    assert set(page.run(f"return {IDS}")[-4:]) == {NASTY, "f3", "f4", "v3"}
    choose(page, "sort", "id", 10)
    page.wait(f"{IDS}[1] === 'v2'")
    ids = page.run(f"return {IDS}")
    assert ids.index("f10") < ids.index("f4") < ids.index("f1")


def test_keyboard(page):
    page.press("j")
    assert page.run(f"return {FOCUSED}") == NASTY
    page.press("j", "j")
    assert page.run(f"return {FOCUSED}") == "f2"
    page.press("k", "ArrowRight", "ArrowLeft")
    assert page.run(f"return {FOCUSED}") == "f1"
    page.press("Enter")
    page.wait(OPEN)
    assert page.run(f"return {TITLE}").startswith("f1 ")
    page.press("j")
    page.wait(f"{TITLE}.startsWith('f2 ')")
    page.press("ArrowLeft", "k")
    page.wait(f"{TITLE}.includes('onerror')")
    page.press("k")  # nothing before the first
    assert "onerror" in page.run(f"return {TITLE}")
    page.press("Escape")
    page.wait(f"!{OPEN} && {FOCUSED} === {json.dumps(NASTY)}")
    page.press("ArrowDown")
    row = page.run(
        "const all = [...document.querySelectorAll('.card')];"
        "return all.filter(c => c.offsetTop === all[0].offsetTop).length"
    )
    assert page.run(f"return {FOCUSED}") == page.run(f"return {IDS}")[row]
    page.press("/")
    assert page.run("return document.activeElement.name") == "q"
    page.press("f", "1", "0")
    page.wait("document.querySelectorAll('.card').length === 1")
    page.press("j", "k")  # letters now
    page.wait("document.querySelectorAll('.card').length === 0")
    page.press("Escape", "j")
    assert page.run("return document.activeElement === document.body")


def test_template_toggle(page):
    page.run("location.hash = 'frame=1'")
    page.wait(OPEN)
    layer = "document.querySelector('#stage .template')"
    page.wait(f"{layer}?.complete && {layer}.naturalWidth && document.querySelector('#stage img').naturalWidth")
    shown = f"return {layer}.checkVisibility() && document.querySelector('#radar .template').checkVisibility()"
    assert page.run(shown)
    box = page.run(
        "return [...document.querySelectorAll('#stage img')].map(i => { const b = i.getBoundingClientRect();"
        "return [b.left, b.top, b.width, b.height]; })"
    )
    np.testing.assert_allclose(box[0], box[1], atol=0.01)
    with_template = _pixels(page)
    page.press("t")
    assert not page.run(shown)
    without = _pixels(page)
    page.press("t")
    assert page.run(shown)
    assert _yellow(with_template) > 200 > 20 > _yellow(without)
    page.run("document.getElementById('show-template').click()")
    assert not page.run(shown)
    page.press("j")  # stays off for the next frame
    page.wait(f"{TITLE}.startsWith('f2 ')")
    assert not page.run(shown)
    page.press("p")
    assert page.run("return document.querySelector('#stage .points').checkVisibility()")


def test_zoom_keeps_the_layers_together(page):
    page.run("location.hash = 'frame=1'")
    page.wait(f"{OPEN} && document.querySelectorAll('#stage img').length > 1")
    page.wait("[...document.querySelectorAll('#stage img')].every(image => image.naturalWidth)")
    boxes = """
        return [...document.querySelectorAll('#stage img')].map(i => {
          const b = i.getBoundingClientRect(); return [b.left, b.top, b.width, b.height]; });
    """
    before = np.array(page.run(boxes))
    page.press("z")
    after = np.array(page.run(boxes))
    np.testing.assert_allclose(after[:, 2:], 3 * before[:, 2:], rtol=1e-3)
    np.testing.assert_allclose(after[0], after[1], atol=0.01)
    page.press("z")
    np.testing.assert_allclose(page.run(boxes), before)
    # the wheel zooms about the pointer, a drag moves, and neither ever shows what is beside the picture
    point_at(page, "#stage", (0.25, 0.5), "mouseMoved", "mouseWheel", wheel=-600)
    wheeled = np.array(page.run(boxes))
    zoom = wheeled[0, 2] / before[0, 2]
    assert zoom == pytest.approx(np.exp(600 * 0.0016), rel=1e-3)
    assert wheeled[0, 0] + 0.25 * wheeled[0, 2] == pytest.approx(before[0, 0] + 0.25 * before[0, 2], abs=1.0)
    point_at(page, "#stage", (0.5, 0.5), "mouseMoved", "mousePressed")
    point_at(page, "#stage", (0.6, 0.5), "mouseMoved", held=True)
    point_at(page, "#stage", (0.6, 0.5), "mouseReleased")
    dragged = np.array(page.run(boxes))
    assert dragged[0, 0] - wheeled[0, 0] == pytest.approx(0.1 * before[0, 2], abs=1.0)
    np.testing.assert_allclose(dragged[0], dragged[1], atol=0.01)
    page.press("z")
    np.testing.assert_allclose(page.run(boxes), before)


def test_the_page_computes_metres_and_sigma_as_python_does(page, report, wide_lens):
    page.run("location.hash = 'frame=1'")
    page.wait(f"{OPEN} && document.querySelector('#facts dd')")
    row = read_run(report.parents[1]).row("f1")
    own = read_run(report.parents[1]).record(row).view
    plane = FieldView(PlaneCamera(own.camera.width, own.camera.height, own.camera.homography))
    script = "return arguments[1].map(([x, y]) => circlecalCamera.toField(arguments[0], x, y) || [null, null])"
    hipped = FieldView(wide_lens.camera, Surface("hip", 9.15, 0.09))
    for view in (own, wide_lens, hipped, plane):
        x, y = np.meshgrid(np.linspace(0, view.camera.width - 1, 9), np.linspace(0, view.camera.height - 1, 7))
        pixels = np.stack([x, y], axis=-1).reshape(-1, 2)
        told = np.array(page.run(script, describe_view(view), pixels.tolist()), dtype=np.float64)
        np.testing.assert_allclose(told, view.to_field(pixels), atol=1e-4, rtol=1e-6)
    assert page.run("return circlecalCamera.tell([-0.001, -2.5])") == "0.00, -2.50 m"
    for share in ((0.5, 0.5), (0.3, 0.8)):
        point_at(page, "#stage", share, "mouseMoved")
        text = page.run("return document.getElementById('under').textContent")
        numbers = [float(n) for n in re.findall(r"-?\d+\.?\d*", text)]
        pixel = np.array(share) * (own.camera.width, own.camera.height) - 0.5
        place, sigma = own.to_field(pixel, sigma=True)
        np.testing.assert_allclose(numbers[:2], pixel, atol=1.0)
        np.testing.assert_allclose(numbers[2:4], place, atol=0.05)
        sigma_px = own.project(place, sigma=True).sigma * 1920 / own.camera.width
        np.testing.assert_allclose(numbers[4], sigma_px, rtol=0.1)
        np.testing.assert_allclose(numbers[6], sigma, rtol=0.1)
        assert " px at 1920 px width, " in text
    assert page.run("return document.querySelector('#radar .here').checkVisibility()")
    page.press("m")
    assert page.run("return document.querySelector('#stage .heat').checkVisibility()")


def test_the_record_and_the_way_to_the_workbench(page, report):
    page.run("location.hash = 'frame=1'")
    page.wait(OPEN)
    page.run("document.getElementById('show-record').click()")
    page.wait("document.getElementById('record-text').textContent.startsWith('{')")
    told = json.loads(page.run("return document.getElementById('record-text').textContent"))
    stored = read_run(report.parents[1])
    assert told == json.loads(result_line(stored.record(stored.row("f1"))))
    page.press("k")
    assert page.run("return document.getElementById('record').hidden")
    command = page.run("return document.getElementById('command').textContent")
    assert shlex.split(command) == ["circlecal", "annotate", str(report.parents[1]), "--frame", NASTY]
    link = "return [document.getElementById('annotate').hidden, document.getElementById('annotate').href]"
    assert page.run(link)[0]
    for address, shown in (("http://127.0.0.1:4711/t0ken/", True), ("javascript:alert(1)", False), (None, False)):
        tell_workbench(report.parents[1], address)
        page.open(report)
        page.run("location.hash = 'frame=1'")
        page.wait(OPEN)
        hidden, target = page.run(link)
        assert hidden != shown
        assert not shown or target == f"{address}#f1"


def _pixels(page) -> np.ndarray:
    import base64

    page.run("""
        return Promise.all([...document.querySelectorAll('#stage img')].map(image => image.decode())).then(
          () => new Promise(done => requestAnimationFrame(() => requestAnimationFrame(done))));
    """)
    box = page.run(
        "const b = document.getElementById('stage').getBoundingClientRect(); return [b.x, b.y, b.width, b.height]"
    )
    clip = dict(zip(("x", "y", "width", "height"), box, strict=True)) | {"scale": 1}
    content = page.devtools("Page.captureScreenshot", format="png", clip=clip)["data"]
    return cv2.imdecode(np.frombuffer(base64.b64decode(content), np.uint8), cv2.IMREAD_COLOR)


def _yellow(picture: np.ndarray) -> int:
    return int(((picture[..., 2] > 200) & (picture[..., 1] > 190) & (picture[..., 0] < 110)).sum())


def test_large_view_tells_why(page):
    page.run("location.hash = 'verdict=refused&frame=4'")
    page.wait(f"{OPEN} && document.querySelector('#facts dd')")
    text = page.run("return document.getElementById('large').innerText")
    for said in ("too_uncertain at verdict", "uncertain by 99 px", "--camera-prior", "3 of 4", "960 x 540 px"):
        assert said in text
    assert page.run("return document.getElementById('show-template').disabled")


def test_large_view_of_a_calibrated_frame(page):
    page.run("location.hash = 'frame=1'")
    page.wait(f"{OPEN} && document.querySelectorAll('#more table').length === 3")
    text = page.run("return document.getElementById('large').innerText")
    for said in ("✓ calibrated", "predicted sigma", "m high", "pan, tilt, roll", "sigma px", "Radar"):
        assert said in text
    page.press("Escape")


def test_a_check_says_on_which_side_of_its_limit_it_passes_and_what_it_measures(page):
    page.run("location.hash = 'frame=1'")
    page.wait(f"{OPEN} && document.querySelectorAll('#more table').length === 3")
    row = "[...document.querySelectorAll('#more tr')].find((row) => row.cells[0].textContent === 'lowest height m')"
    assert page.run(f"return {row}.cells[2].textContent").startswith("≥ ")
    assert page.run(f"return {row}.cells[0].title") == CHECKS["lowest_height_m"].measures


def test_missing_pictures_leave_the_rest(page, report):
    frame = report.parent / "frames" / "000" / "000001.jpg"
    content = frame.read_bytes()
    frame.unlink()
    try:
        page.run("location.hash = 'frame=1'")
        page.wait("document.querySelector('#stage .none')")
        page.wait("document.querySelector('#stage .template').naturalWidth")
    finally:
        frame.write_bytes(content)
    assert any("000001.jpg" in message for message in page.console())


def test_address_keeps_filter_and_frame(page, report):
    choose(page, "q", "v", 4)
    page.press("j", "j", "Enter")
    page.wait(OPEN)
    address = page.run("return location.href")
    page.open(address)
    page.wait(OPEN)
    assert page.run(f"return {TITLE}").startswith("v1 ")
    assert page.run("return document.getElementById('place').textContent") == "match.mp4 at 0:01, 2 of 4"
    assert page.run(f"return {IDS}") == ["v0", "v1", "v2", "v3"]


def test_links_of_the_summary_filter(page):
    page.run("document.querySelector('.reasons a[href*=too_uncertain]').click()")
    page.wait("document.querySelectorAll('.card').length === 1")
    assert page.run(f"return {IDS}") == ["f4"]
    page.run("document.querySelector('#filter button[type=reset]').click()")
    page.wait("document.querySelectorAll('.card').length === 10")
    bars = "[...document.querySelectorAll('.chart')][0].querySelectorAll('a')"
    counts = page.run(f"return [...{bars}].map(a => a.getAttribute('aria-label').match(/show (\\d+)/)[1])")
    assert sum(map(int, counts)) == 6
    for k, count in enumerate(counts):
        page.run(f"{bars}[{k}].dispatchEvent(new MouseEvent('click', {{ bubbles: true, cancelable: true }}))")
        page.wait(f"location.hash.includes('bar=') && document.querySelectorAll('.card .name').length === {count}")
    page.wait("!document.getElementById('bar').hidden")
    assert page.run(f"return {IDS}") == ["f10"]
    page.run("""
        const keep = URL.createObjectURL;
        URL.createObjectURL = (content) => { window.saved = content; return keep.call(URL, content); };
        HTMLAnchorElement.prototype.click = () => {};
        document.getElementById('ids').click();
    """)
    assert page.run("return window.saved.text()") == "f10\n"
    page.run("document.getElementById('bar').click()")
    page.wait("document.querySelectorAll('.card').length === 10")


def test_every_moment_of_the_timeline_opens_its_frame(page):
    pictures, video = ".match:nth-of-type(1) .strip", ".match:nth-of-type(2) .strip.sigma"
    point_at(page, video, (0.6, 0.5), "mouseMoved", "mousePressed", "mouseReleased")
    page.wait(OPEN)
    assert page.run(f"return {TITLE}").startswith("v2 ")
    page.press("Escape")
    page.wait(f"!{OPEN}")
    assert "0:02, v2: calibrated, sigma 10 px" in page.run("return document.querySelectorAll('.moment')[1].textContent")
    page.run(f"document.querySelector('{pictures}').focus()")
    page.press("ArrowRight", "ArrowRight")
    assert page.run("return document.activeElement.getAttribute('aria-valuetext')").startswith("f2: calibrated")
    page.press("Enter")
    page.wait(OPEN)
    assert page.run(f"return {TITLE}").startswith("f2 ")
    page.press("Escape")
    page.wait(f"!{OPEN}")
    page.settle()
    point_at(page, pictures, (0.1, 0.5), "mouseMoved", "mousePressed")
    for share in (0.2, 0.3, 0.4):
        point_at(page, pictures, (share, 0.5), "mouseMoved", held=True)
    point_at(page, pictures, (0.4, 0.5), "mouseReleased")
    page.wait("!document.getElementById('range').hidden")
    assert page.run(f"return {IDS}") == [NASTY, "f1", "f2"]
    page.run("document.getElementById('range').click()")
    page.wait("document.querySelectorAll('.card').length === 10")


def test_summary_without_scripts(browser, report):
    browser.scripts(False)
    try:
        browser.open(report)
        text = browser.devtools("DOM.getOuterHTML", nodeId=browser.devtools("DOM.getDocument")["root"]["nodeId"])[
            "outerHTML"
        ]
    finally:
        browser.scripts(True)
    words = " ".join(re.sub(r"<[^>]+>", " ", text).split())
    assert "60.0 %" in words
    assert "too_uncertain" in words
    assert "needs JavaScript" in words
    assert text.count("<svg") >= 4


CONTRASTS = """
    const canvas = document.createElement('canvas').getContext('2d', { willReadFrequently: true });
    const rgba = (color) => {
      canvas.clearRect(0, 0, 1, 1); canvas.fillStyle = color; canvas.fillRect(0, 0, 1, 1);
      return [...canvas.getImageData(0, 0, 1, 1).data];
    };
    const hex = ([r, g, b]) => '#' + [r, g, b].map(v => v.toString(16).padStart(2, '0')).join('');
    const found = {};
    const top = document.getElementById('large')?.open ? document.getElementById('large') : document.body;
    const walker = document.createTreeWalker(top, NodeFilter.SHOW_TEXT);
    const skipped = 'title, noscript, .unseen, :disabled' + (top === document.body ? ', dialog' : '');
    while (walker.nextNode()) {
      const text = walker.currentNode.textContent.trim();
      const element = walker.currentNode.parentElement;
      if (!text || !element.checkVisibility() || element.closest(skipped)) continue;
      let ground = element;
      while (ground !== document.body && rgba(getComputedStyle(ground).backgroundColor)[3] === 0) {
        ground = ground.parentElement;
      }
      const style = getComputedStyle(element);
      const pair = [element.ownerSVGElement ? style.fill : style.color, getComputedStyle(ground).backgroundColor];
      found[pair.map(color => hex(rgba(color)))] = `${element.tagName}.${element.className}: ${text.slice(0, 30)}`;
    }
    return found;
"""


@pytest.mark.parametrize("theme", ["light", "dark"])
def test_contrast_of_every_text(page, report, theme):
    page.prefer(theme)
    page.open(report)
    page.wait("document.querySelectorAll('.card').length")
    for place in ("list", "large view"):
        if place == "large view":
            page.run("location.hash = 'frame=4'")
            page.wait(f"{OPEN} && document.querySelector('#facts dd')")
        pairs = page.run(CONTRASTS)
        assert len(pairs) >= 3
        for pair, where in pairs.items():
            assert contrast(*pair.split(",")) >= 4.5, (where, pair)


@pytest.mark.parametrize("theme", ["light", "dark"])
def test_theme_follows_the_system_and_the_button(page, report, theme):
    page.prefer(theme)
    page.open(report)
    page.wait("document.querySelectorAll('.card').length")
    system = "matchMedia('(prefers-color-scheme: dark)').matches"
    dark = f"return {system} === (document.documentElement.dataset.theme === 'dark')"
    assert page.run(dark)
    before = page.run("return getComputedStyle(document.body).backgroundColor")
    page.run("document.getElementById('theme').click()")
    assert page.run("return getComputedStyle(document.body).backgroundColor") != before
    assert not page.run(dark)
    page.run("localStorage.clear()")


@pytest.mark.parametrize("width", [320, 390, 768])
def test_narrow_screens_do_not_scroll_sideways(page, report, width):
    page.resize(width, 844, phone=True)
    page.open(report)
    page.wait("document.querySelectorAll('.card').length")
    assert page.run("return document.documentElement.scrollWidth") <= width
    page.run("location.hash = 'frame=1'")
    page.wait(f"{OPEN} && document.querySelector('#facts dd')")
    assert page.run("const b = document.querySelector('.large-body'); return b.scrollWidth <= b.clientWidth")


@pytest.mark.parametrize("width", [800, 1400])
def test_the_table_of_cameras_is_whole(page, report, width):
    page.resize(width, 900)
    page.open(report)
    page.run("document.querySelector('.wide-table td:nth-child(6)').textContent = '105.26 ± 0.212 x 68.03 ± 0.117'")
    assert page.run("const b = document.querySelector('.wide-table'); return b.scrollWidth <= b.clientWidth")


def test_links_of_the_summary_are_large_enough_to_hit(page):
    boxes = page.run(
        "return [...document.querySelectorAll('.top nav a, .number .jump')].map("
        "(a) => [a.textContent, a.getBoundingClientRect().width, a.getBoundingClientRect().height])"
    )
    assert len(boxes) > 5
    assert [box for box in boxes if min(box[1:]) < 24] == [], "the smallest target of WCAG 2.2 AA is 24 x 24 px"
    told = [text for text, *_ in boxes if text.startswith("1 ")]
    assert told and set(told) == {"1 frame: show it"}


def test_everything_that_can_be_used_has_a_name(page):
    page.run("location.hash = 'frame=1'")
    page.wait(OPEN)
    page.devtools("Accessibility.enable")
    nodes = page.devtools("Accessibility.getFullAXTree")["nodes"]
    wanted = {"button", "checkbox", "link", "textbox", "searchbox", "combobox", "spinbutton", "image", "dialog"}
    used = [node for node in nodes if node.get("role", {}).get("value") in wanted and not node.get("ignored")]
    assert {"button", "checkbox", "image", "dialog"} <= {node["role"]["value"] for node in used}
    nameless = [node["role"]["value"] for node in used if not node.get("name", {}).get("value", "").strip()]
    assert not nameless
    page.press("Escape")
    page.wait(f"!{OPEN}")
    nodes = page.devtools("Accessibility.getFullAXTree")["nodes"]
    used = [node for node in nodes if node.get("role", {}).get("value") in wanted and not node.get("ignored")]
    assert {"link", "searchbox", "combobox", "spinbutton"} <= {node["role"]["value"] for node in used}
    assert not [node["role"]["value"] for node in used if not node.get("name", {}).get("value", "").strip()]


def test_a_thousand_frames(browser, tmp_path, named):
    codes = ("no_field", "no_circle_found", "too_uncertain")
    records = [
        named(f"f{k:05d}", 1.0 + k % 97) if k % 12 == 0 else refused(f"f{k:05d}", codes[k // 300 % 3])
        for k in range(1200)
    ]
    report = write_report(read_run(write_run(tmp_path, records))).page
    browser.console()
    browser.open(report)
    browser.wait("document.querySelectorAll('.card').length === 60")
    assert browser.run("return document.getElementsByTagName('*').length") < 4000
    assert "1200 of 1200 frames: 100 calibrated" in browser.run("return document.getElementById('count').textContent")
    choose(browser, "q", "f0077", 10)
    choose(browser, "q", "", 60)
    choose(browser, "verdict", "calibrated", 60)
    choose(browser, "sort", "sigma", 60)
    browser.run("document.getElementById('on').click()")
    browser.wait("document.querySelectorAll('.card').length === 40")
    last = browser.run(f"return {IDS}")[-1]
    sigma = {record["id"]: record["camera"]["max_sigma_px"] for record in records if record["camera"]}
    assert sigma[last] == max(sigma.values())
    browser.run("document.querySelectorAll('.card')[39].click()")
    browser.wait(f"{OPEN} && document.querySelector('#facts dd')")
    assert browser.run("return document.getElementById('place').textContent") == "100 of 100"
    assert browser.console() == []
    listing = (tmp_path / REPORT_FOLDER / "frames.js").stat().st_size
    assert listing < 250 * len(records)
    assert json.loads((tmp_path / REPORT_FOLDER / "frames.js").read_text()[len("circlecalFrames(") : -3])


def test_the_printed_report_has_its_frames(page):
    page.devtools("Emulation.setEmulatedMedia", media="print")
    try:
        page.run("document.documentElement.dataset.theme = 'dark'; window.dispatchEvent(new Event('beforeprint'))")
        told = page.run(
            "const seen = (id) => document.getElementById(id).getClientRects().length > 0;"
            "return [seen('list'), seen('filter'), seen('printed'), document.documentElement.dataset.theme,"
            "document.querySelectorAll('#list .card').length, document.getElementById('printed').textContent]"
        )
        assert told[:4] == [True, False, True, "light"] and told[4] == 10
        assert told[5].startswith("10 of 10 frames: "), "which frames pass the filter is told, too"
        assert page.run("return document.documentElement.scrollWidth <= innerWidth")
        page.run("window.dispatchEvent(new Event('afterprint'))")
        assert page.run("return document.documentElement.dataset.theme") == "dark"
    finally:
        page.devtools("Emulation.setEmulatedMedia", media="")
        page.run("document.documentElement.dataset.theme = 'light'")
