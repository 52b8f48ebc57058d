"""The workbench in a real browser: named, snapped, undone, kept, by keys alone, in two windows."""

import json
import os
import signal
import subprocess
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
import yaml

from circlecal.field import field_folder, load_field
from circlecal.workbench.answers import distance_to_polyline
from tests.report.browser import Browser, programs
from tests.report.test_browser import CONTRASTS
from tests.report.test_pages import contrast
from tests.workbench.test_measuring import FEW

pytestmark = pytest.mark.skipif(programs() is None, reason="no Chromium")

READY = "document.body.dataset.ready && document.getElementById('busy').hidden"
SAVED = "document.getElementById('saved').textContent === 'saved'"
VERDICT = "document.getElementById('verdict').textContent"


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    found = Browser(1400, 900)
    yield found
    found.close()


@pytest.fixture(scope="module")
def out(tmp_path_factory) -> Path:
    return tmp_path_factory.mktemp("annotations")


@pytest.fixture(scope="module")
def options(tmp_path_factory, out) -> tuple[object, ...]:
    """What a server is started with: names for a refused frame are looked for among few markings, with few starts."""
    few = yaml.safe_load((field_folder() / "soccer.yaml").read_text(encoding="utf-8"))
    few["lines"] = [line for line in few["lines"] if line["name"] in FEW]
    path = tmp_path_factory.mktemp("field") / "few.yaml"
    path.write_text(yaml.safe_dump(few), encoding="utf-8")
    return "--out", out, "--field", path, "--set", "camera.starts=2"


@pytest.fixture(scope="module")
def server(serve, folder, options) -> tuple[subprocess.Popen[str], str]:
    return serve(folder, *options)


def go_to(browser: Browser, address: str, name: str = "open") -> None:
    browser.open(f"{address}#{name}")
    browser.wait(READY)
    browser.wait("document.getElementById('picture').complete")


def press_at(browser: Browser, pixel, event: str = "click", alt: bool = False) -> None:
    """Press and release the mouse at a pixel of the picture."""
    box = browser.run(
        "const box = document.getElementById('picture').getBoundingClientRect();"
        "return [box.left, box.top, box.width / document.getElementById('picture').naturalWidth]"
    )
    x, y = box[0] + (pixel[0] + 0.5) * box[2], box[1] + (pixel[1] + 0.5) * box[2]
    keys = 1 if alt else 0
    for kind in ("mouseMoved", "mousePressed", "mouseReleased"):
        button = "none" if kind == "mouseMoved" else "left"
        browser.devtools("Input.dispatchMouseEvent", type=kind, x=x, y=y, button=button, clickCount=1, modifiers=keys)


def seen(camera, name: str) -> np.ndarray:
    points = camera.project(load_field("soccer").polylines(0.5)[name])
    inside = (points > 15).all(axis=1) & (points < (camera.width - 15, camera.height - 15)).all(axis=1)
    return points[inside]


def choose_on_field(browser: Browser, name: str) -> None:
    browser.run(f"document.querySelector('#field [data-name={name}]').dispatchEvent(new MouseEvent('click'))")


def stored(out: Path, name: str = "open") -> dict:
    return json.loads((out / f"{name}.json").read_text())


def test_nothing_sticks_out_of_the_window(browser, server):
    for width, scheme in ((390, "dark"), (1400, "light")):
        browser.resize(width, 900)
        browser.prefer(scheme)
        go_to(browser, server[1])
        assert browser.run("return document.documentElement.scrollWidth") <= width
        stage = browser.run(
            "const b = document.getElementById('stage').getBoundingClientRect(); return [b.width, b.height]"
        )
        assert stage[0] > 300 and stage[1] > 200
        drawn = "[...document.querySelectorAll('#drawing .traced')].map((e) => e.getBoundingClientRect().width)"
        assert max(browser.run(f"return {drawn}")) > 50, "what was measured is drawn on screens of every width"
        wide = browser.run(
            "const p = document.getElementById('picture'), zoom = p.getBoundingClientRect().width / p.naturalWidth;"
            "const width = (line) => zoom * parseFloat(getComputedStyle(line).strokeWidth);"
            "return [...document.querySelectorAll('#drawing .traced:not(.chosen)')].map(width)"
        )
        assert wide == pytest.approx([3.0] * len(wide), abs=0.05), "lines are as wide at every zoom"
        pairs = browser.run(CONTRASTS)
        assert len(pairs) >= 3
        for pair, where in pairs.items():
            assert contrast(*pair.split(",")) >= 4.5, (where, pair, scheme)
    keys = "const d = document.getElementById('keys'); d.showModal(); const b = d.querySelector('.talk');"
    low = browser.run(f"{keys} const low = d.offsetHeight <= b.scrollHeight + 4; d.close(); return low")
    assert low, "a dialog is no higher than what it says"
    of_ten_thousand_frames_only_those_in_view_are_drawn(browser)


def of_ten_thousand_frames_only_those_in_view_are_drawn(browser):
    """Only the rows in view exist, and keys, filters and search reach all of them."""
    told = browser.run(
        """
        return import("./list.js").then(({ FrameList, isToDo, clock }) => {
          const box = document.body.appendChild(document.createElement("div")), rows = document.createElement("div");
          box.style.cssText = "height: 400px; overflow-y: auto; position: relative"; box.append(rows);
          const opened = [], list = new FrameList(box, rows, (index) => opened.push(index));
          const states = ["refused", "doubtful", "calibrated"];
          list.frames = Array.from({ length: 10000 }, (_, k) => [`f${k}`, states[k % 3], null, 3.5, null, false, null]);
          list.keep("", ""); list.select(9000);
          const nodes = rows.children.length, there = rows.textContent.includes("f9000");
          list.step(1);
          list.keep("refused", ""); list.current = 301;  // left the list, between the refused 300 and 303
          list.step(1); list.current = 301; list.step(-1); list.current = 9999; const beyond = list.step(1);
          list.keep("refused", "f99"); const few = list.shown.length; list.keep("", "");
          box.style.width = "150px"; box.scrollTop = 0;
          list.frames = [["a_clip_with_a_long_name_00-00-00.040", ...list.frames[0].slice(1)]]; list.keep("", "");
          const place = (tag) => rows.querySelector(tag).getBoundingClientRect();
          const name = place("bdi"), cell = place("b");
          const cut = { before: cell.left - name.left, behind: name.right - cell.right };
          box.remove();
          const clocks = [0.04, 61.96, 59.999, 120].map(clock);
          const asked = (state, done) => isToDo(["f", state, null, 20, null, done, null]);
          const todo = [...states, "unknown"].map((state) => [asked(state, false), asked(state, true)]);
          return { nodes, there, opened, beyond, few, todo, cut, clocks };
        });
        """
    )
    assert told["nodes"] < 40 and told["there"] and told["opened"] == [9001, 303, 300] and not told["beyond"]
    asked = "a refused frame is to do, a doubtful or unseen one until somebody annotates it"
    assert told["todo"] == [[True, True], [True, False], [False, False], [True, False]], asked
    assert told["cut"]["before"] > 20 and told["cut"]["behind"] < 1, "ids of a clip's frames differ at their end"
    assert told["clocks"] == ["0:00.04", "1:01.96", "1:00", "2:00"]
    assert told["few"] == sum(f"f{k}".startswith("f99") or "f99" in f"f{k}" for k in range(0, 10_000, 3))


def test_an_offer_for_what_was_there_before_is_not_accepted(browser, serve, folder, tmp_path):
    away = "[...document.querySelectorAll('#markings .away')].find((b) => b.ariaLabel.includes('{}')).click();"
    go_to(browser, serve(folder / "good.png", "--out", tmp_path)[1], "good")
    browser.run(away.format("side line top"))
    browser.wait(SAVED)
    browser.wait("document.getElementById('offers').textContent.includes('Accept the line that fits: side line top')")
    nameless = "[...document.querySelectorAll('#markings .away')].find((b) => !b.ariaLabel.includes('ellipse') "
    nameless += "&& (b.ariaLabel.includes('no name') || b.ariaLabel.includes('recognised'))).click();"
    pressed = "document.body.dispatchEvent(new KeyboardEvent('keydown', { key: 'a', bubbles: true }))"
    browser.run(nameless + pressed)
    browser.wait(SAVED)
    assert "side_line_top" not in {m["name"] for m in stored(tmp_path, "good")["markings"]}


def test_an_import_tells_what_it_took_and_what_it_left_out(browser, serve, folder, tmp_path):
    def choose(content: dict[str, object]) -> None:
        browser.run(
            "const held = new DataTransfer(), input = document.getElementById('import');"
            f"held.items.add(new File([{json.dumps(json.dumps(content))}], 'good.json'));"
            "input.files = held.files; input.dispatchEvent(new Event('change'))"
        )
        browser.wait("document.getElementById('trouble').open")

    go_to(browser, serve(folder / "good.png", "--out", tmp_path)[1], "good")
    ends = [{"x": 0.0, "y": 0.5}, {"x": 1.0, "y": 0.25}]
    choose({"Side line top": ends, "goose": ends})
    assert "goose" in browser.run("return document.getElementById('trouble-text').textContent")
    browser.wait("document.getElementById('saved').textContent === '1 taken in, 0 unknown'")
    browser.run("document.getElementById('close-trouble').click()")
    browser.wait("!document.getElementById('undo').disabled")
    browser.run("document.getElementById('undo').click()")
    browser.wait(SAVED)
    assert {marking["source"] for marking in stored(tmp_path, "good")["markings"]} == {"measured"}
    choose({"goose": ends})
    assert "did not work" in browser.run("return document.getElementById('trouble-title').textContent")
    browser.run("document.getElementById('close-trouble').click()")
    browser.console()  # the refused request is named there


def test_an_export_tells_what_it_left_out(browser, serve, folder, tmp_path):
    (tmp_path / "open.json").write_text('{"annotation_version": 1, "id": "open", "wi')
    go_to(browser, serve(folder, "--out", tmp_path)[1], "good")
    note(browser, "mine")
    browser.wait(SAVED)
    browser.run(
        "window.clicked = []; HTMLAnchorElement.prototype.click = function () { window.clicked.push(this.download); };"
        "document.getElementById('export').click()"
    )
    browser.wait("document.getElementById('trouble').open")
    assert "open.json" in browser.run("return document.getElementById('trouble-text').textContent")
    assert browser.run("return window.clicked") == ["coco.json"]
    assert "the middle of the paint, as it says itself" in browser.run(
        "return document.getElementById('saved').textContent"
    )
    browser.run("document.getElementById('close-trouble').click()")
    assert "unusable annotation" in browser.run("return document.getElementById('rows').textContent")


def test_the_way_back_leads_to_what_was_measured(browser, serve, folder, tmp_path):
    address = serve(folder / "good.png", "--out", tmp_path)[1]
    told = "return [...document.querySelectorAll('#markings .pick span')].map((span) => span.textContent).sort()"
    go_to(browser, address, "good")
    before = browser.run(told)
    line = {"Side line top": [{"x": 0.0, "y": 0.5}, {"x": 1.0, "y": 0.25}]}
    asked = f"fetch('import?name=good.json', {{ method: 'POST', body: JSON.stringify({json.dumps(line)}) }})"
    browser.run(f"{asked}.then(() => {{ document.body.dataset.imported = 'yes'; }})")
    browser.wait("document.body.dataset.imported")
    browser.open("about:blank")
    go_to(browser, address, "good")
    browser.run("document.getElementById('reset').click()")
    browser.wait(SAVED)
    browser.wait("!document.getElementById('undo').disabled")
    browser.wait(SAVED)
    assert browser.run(told) == before
    assert {m["source"] for m in stored(tmp_path, "good")["markings"]} == {"measured"}


def test_what_is_typed_is_taken_back_on_the_page_too(browser, serve, folder, tmp_path):
    def typed() -> list[str]:
        return browser.run(
            "return [document.getElementById('note').value, document.getElementById('flag').value,"
            "document.querySelector('#priors input').value]"
        )

    def press(button: str) -> None:
        browser.run(f"document.getElementById('{button}').click()")

    go_to(browser, serve(folder / "good.png", "--out", tmp_path)[1], "good")
    for selector, value in (("#note", "windy"), ("#flag", "no_field"), ("#priors input", "104")):
        browser.run(
            f"const input = document.querySelector('{selector}'); input.value = '{value}';"
            "input.dispatchEvent(new Event('change'))"
        )
    for _ in range(3):
        press("undo")
    assert typed() == ["", "", ""]
    for _ in range(3):
        press("redo")
    assert typed() == ["windy", "no_field", "104"]
    press("reset")
    browser.wait("!document.getElementById('flag').value")
    assert typed() == ["windy", "", ""]
    for _ in range(4):
        press("undo")
    browser.wait(SAVED)


def note(browser: Browser, text: str, then: str = "") -> None:
    """Write a note and leave it, and do something else before it can be saved."""
    browser.run(
        f"const n = document.getElementById('note'); n.value = {json.dumps(text)};"
        f"n.dispatchEvent(new Event('change')); {then}"
    )


GO_ON = "document.getElementById('next').click();"
TITLE = "document.getElementById('title').textContent"


def test_a_frame_that_was_changed_elsewhere_is_not_left_before_one_of_both_is_chosen(browser, serve, folder, tmp_path):
    go_to(browser, serve(folder, "--out", tmp_path)[1], "good")
    note(browser, "mine")
    browser.wait(SAVED)
    theirs = stored(tmp_path, "good") | {"revision": 7, "note": "theirs"}
    (tmp_path / "good.json").write_text(json.dumps(theirs))
    note(browser, "mine again", GO_ON)
    browser.wait("document.getElementById('conflict').open")
    assert browser.run(f"return {TITLE}") == "good"
    browser.run("document.getElementById('conflict').close();" + GO_ON)  # as Escape does, which chooses nothing
    browser.wait("document.getElementById('conflict').open")
    browser.run("document.getElementById('keep-mine').click()")
    browser.wait(SAVED)
    assert (stored(tmp_path, "good")["note"], stored(tmp_path, "good")["revision"]) == ("mine again", 8)
    assert [path.name for path in tmp_path.glob("*.json")] == ["good.json"]
    browser.console()  # the browser itself reports the answer 409


def test_a_change_that_cannot_be_saved_is_kept_until_it_can_or_is_given_up(browser, serve, folder, tmp_path):
    out = tmp_path / "out"
    go_to(browser, serve(folder, "--out", out)[1], "good")
    out.rmdir()
    out.write_text("in the way")
    note(browser, "mine", GO_ON)
    browser.wait("document.getElementById('trouble').open && !document.getElementById('drop').hidden")
    assert browser.run(f"return {TITLE}") == "good"
    browser.run("document.getElementById('close-trouble').click()")
    browser.run("window.asked = !window.dispatchEvent(new Event('beforeunload', { cancelable: true }))")
    assert browser.run("return window.asked"), "closing the window asks first"
    out.unlink()
    browser.run(GO_ON)
    browser.wait(f"{TITLE} !== 'good' && {READY}")
    assert stored(out, "good")["note"] == "mine"
    name = browser.run(f"return {TITLE}")
    (out / f"{name}.json").mkdir()
    note(browser, "given up", "document.getElementById('previous').click();")
    browser.wait("document.getElementById('trouble').open && !document.getElementById('drop').hidden")
    browser.run("document.getElementById('drop').click()")
    browser.wait(f"{TITLE} !== '{name}' && {READY}")
    assert stored(out, "good")["note"] == "mine"
    browser.console()


def test_keys_of_other_layouts_and_keys_held_down(browser, serve, folder, tmp_path):
    go_to(browser, serve(folder, "--out", tmp_path)[1], "good")

    def press(**event) -> None:
        browser.run(
            "document.activeElement.blur(); document.body.dispatchEvent("
            f"new KeyboardEvent('keydown', Object.assign({json.dumps(event)}, {{ bubbles: true }})))"
        )

    def is_ticked() -> bool:
        return browser.run("return document.getElementById('show-heat').checked")

    chosen = "return document.querySelectorAll('.pick[aria-pressed=true]').length"
    before = is_ticked()
    press(key="ь", code="KeyM")  # m on a Russian keyboard
    assert is_ticked() != before
    press(key="M", code="KeyM")  # with Caps Lock
    assert is_ticked() == before
    press(key="]", code="Digit6", altKey=True)  # as a German Mac has it
    assert browser.run(chosen) == 1
    press(key="Escape")
    press(key="]", code="Digit9", altKey=True, ctrlKey=True)  # AltGr, as Windows has it
    assert browser.run(chosen) == 1
    press(key="Escape")
    note(browser, "windy")
    browser.wait(SAVED)
    browser.wait(f"{READY}")
    press(key="я", code="KeyZ", ctrlKey=True)
    assert browser.run("return document.getElementById('note').value") == ""
    browser.wait(SAVED)
    revision = stored(tmp_path, "good")["revision"]
    press(key="y", code="KeyY", repeat=True)  # held down
    assert browser.run(f"return {TITLE}") == "good" and stored(tmp_path, "good")["revision"] == revision
    browser.console()


def test_what_is_typed_is_saved_without_leaving_the_input(browser, serve, folder, tmp_path):
    go_to(browser, serve(folder, "--out", tmp_path)[1], "good")
    browser.run("document.getElementById('note').focus()")
    browser.press(*"wet")
    browser.wait(SAVED)
    assert stored(tmp_path, "good")["note"] == "wet"
    browser.press("!")
    browser.run("document.querySelector('#frame-1').click()")  # a click of a script takes the cursor nowhere
    browser.wait(f"{TITLE} !== 'good' && {READY}")
    assert stored(tmp_path, "good")["note"] == "wet!"


def test_a_frame_that_cannot_be_shown_hides_none_of_the_others(browser, serve, folder, tmp_path):
    (tmp_path / "pictures").mkdir()
    for name in ("good", "keys"):
        (tmp_path / "pictures" / f"{name}.png").write_bytes((folder / f"{name}.png").read_bytes())
    (tmp_path / "pictures" / "half.png").write_bytes((folder / "good.png").read_bytes()[:2000])
    go_to(browser, serve(tmp_path / "pictures", "--out", tmp_path / "out")[1], "good")
    browser.run("document.activeElement.blur()")
    browser.press("j")
    browser.wait("document.getElementById('trouble').open")
    assert "half.png" in browser.run("return document.getElementById('trouble-text').textContent")
    assert browser.run(f"return [{TITLE}, {VERDICT}]") == ["half", "cannot be shown"]
    browser.run("document.getElementById('close-trouble').click()")
    browser.press("j")
    browser.wait(f"{TITLE} === 'keys' && {READY}")
    assert browser.run("return document.querySelector('.side').inert") is False
    browser.console()


def test_two_clicks_calibrate_a_refused_frame_and_undo_takes_them_back(browser, server, out, wide_camera):
    address = server[1]
    go_to(browser, address)
    browser.console()
    browser.requests()
    assert "refused" in browser.run(f"return {VERDICT}")
    for width in (1366, 683):  # the second is the first at a zoom of 200 %
        browser.resize(width, 768)
        assert browser.run("const v = document.getElementById('verdict'); return v.scrollWidth <= v.clientWidth"), width
    why = browser.run("const w = document.getElementById('why'); return [w.hidden, w.textContent]")
    assert not why[0] and why[1].startswith("Why: ") and len(why[1].split()) > 5, "the whole reason stands on the page"
    browser.resize(1400, 900)
    assert "Name one straight marking" in browser.run("return document.getElementById('missing').textContent")
    counted = browser.run("return document.getElementById('count').textContent")
    assert counted == "3 of 3 frames, 3 to do, 0 annotated"
    press_at(browser, seen(wide_camera, "side_line_top")[10])
    browser.wait("document.querySelector('.pick[aria-pressed=true]')")
    choose_on_field(browser, "side_line_top")
    browser.wait(f"{VERDICT}.startsWith('calibrated') && {SAVED}")
    assert browser.run("return document.querySelectorAll('#drawing .drawn').length") > 2
    browser.press("m")
    assert browser.run("return !document.getElementById('heat').hidden")
    browser.press("m")
    browser.run("document.getElementById('undo').click()")
    browser.wait(f"{VERDICT}.startsWith('refused') && {SAVED}")
    browser.run("document.getElementById('redo').click()")
    browser.wait(f"{VERDICT}.startsWith('calibrated') && {SAVED}")
    assert "side_line_top" in {m["name"] for m in stored(out)["markings"]}
    assert browser.console() == []
    host = address.split("/")[2]
    outside = [
        r for r in browser.requests() if not r.startswith(("data:", "blob:", "chrome:", "about:")) and host not in r
    ]
    assert outside == []


def test_a_click_snaps_to_paint_and_a_killed_server_loses_nothing(
    browser, server, serve, folder, options, out, wide_camera
):
    process, address = server
    go_to(browser, address)
    line = seen(wide_camera, "side_line_top")
    choose_on_field(browser, "penalty_arc_left")
    press_at(browser, line[40] + (0.0, 3.0))
    browser.wait(f"document.getElementById('markings').textContent.includes('penalty arc left') && {SAVED}")
    clicked = [m for m in stored(out)["markings"] if m["source"] == "clicked"]
    assert distance_to_polyline(np.array(clicked[0]["points_px"]), line)[0] < 0.5
    os.kill(process.pid, signal.SIGKILL)
    process.wait()
    before = stored(out)
    _, again = serve(folder, *options)
    go_to(browser, again)
    assert stored(out) == before
    assert "penalty arc left" in browser.run("return document.getElementById('markings').textContent")
    browser.console()
    one_key_confirms(browser, again, out)
    two_windows(browser, again, out)
    keys_alone(browser, again, out)


def one_key_confirms(browser, address, out):
    """What is calibrated is saved as it is, counts as annotated, and the next frame to do is opened."""
    go_to(browser, address, "good")
    assert not (out / "good.json").exists()
    before = int(browser.run("return document.getElementById('count').textContent.match(/(\\d+) annotated/)[1]"))
    assert "save, next frame" in browser.run("return document.getElementById('confirm').textContent")
    browser.run("document.activeElement.blur()")
    browser.press("y")
    browser.wait(f"document.getElementById('count').textContent.includes('{before + 1} annotated')")
    browser.wait(f"document.getElementById('title').textContent !== 'good' && {READY}")
    kept = stored(out, "good")
    assert kept["touched"] and kept["revision"] == 1


def two_windows(browser, address, out):
    """They do not overwrite each other."""
    go_to(browser, address, "good")
    browser.run("const n = document.getElementById('note'); n.value = 'mine'; n.dispatchEvent(new Event('change'))")
    browser.wait(SAVED)
    # what the other window saved meanwhile
    theirs = stored(out, "good") | {"revision": 7, "note": "theirs"}
    (out / "good.json").write_text(json.dumps(theirs))
    browser.run(
        "const n = document.getElementById('note'); n.value = 'mine again'; n.dispatchEvent(new Event('change'))"
    )
    browser.wait("document.getElementById('conflict').open")
    assert stored(out, "good")["note"] == "theirs"
    browser.run("document.getElementById('take-theirs').click()")
    browser.wait(f"document.getElementById('note').value === 'theirs' && {READY}")
    browser.console()  # the browser itself reports the answer 409


def keys_alone(browser, address, out):
    """They are enough, and everything has a name that can be read out."""
    go_to(browser, address, "keys")
    longest = browser.run(
        "const all = [...document.querySelectorAll('.pick')];"
        "return all.findIndex((b) => b.textContent.includes('line, no name'))"
    )
    assert longest >= 0
    browser.run("document.activeElement.blur()")
    browser.press(*["]"] * (longest + 1))  # the brackets walk through the list as it stands beside the picture
    assert browser.run(f"return document.querySelectorAll('.pick')[{longest}].ariaPressed") == "true"
    browser.press("t")
    browser.wait(f"{VERDICT}.startsWith('calibrated') && {SAVED}")
    nameless = browser.run(
        "return [...document.querySelectorAll('button, input, select, textarea, [role=button], [role=listbox], a')]"
        ".filter((e) => e.offsetParent !== null && !(e.getAttribute('aria-label') || e.textContent.trim()"
        " || e.labels?.[0]?.textContent.trim())).map((e) => e.outerHTML)"
    )
    assert nameless == []


OFFLINE = "!document.getElementById('offline').hidden"
STOPPED = "document.getElementById('saved').textContent === 'not saved yet'"


def kill(process: subprocess.Popen[str]) -> None:
    os.kill(process.pid, signal.SIGKILL)
    process.wait()


def test_a_page_goes_on_when_its_server_is_started_again_and_saves_what_was_not(browser, serve, folder, tmp_path):
    process, address = serve(folder, "--out", tmp_path)
    go_to(browser, address, "good")
    kill(process)
    note(browser, "not lost")
    browser.wait(f"{OFFLINE} && {STOPPED}")
    told = browser.run("return document.getElementById('offline').textContent")
    assert "Start circlecal annotate again" in told and not browser.run("return document.querySelector('dialog[open]')")
    process, again = serve(folder, "--out", tmp_path)
    assert again == address
    browser.wait(f"!({OFFLINE}) && {READY} && {SAVED}")
    assert browser.run(f"return [{TITLE}, document.getElementById('note').value]") == ["good", "not lost"]
    assert stored(tmp_path, "good")["note"] == "not lost"
    assert browser.run("return Object.keys(localStorage).filter((key) => key.includes('draft'))") == []
    kill(process)
    note(browser, "of a closed window")
    browser.wait(STOPPED)
    browser.open("about:blank")
    browser.open(serve(folder, "--out", tmp_path)[1])  # opens the frame of which something was not saved
    browser.wait(f"{READY} && {SAVED} && {TITLE} === 'good'")
    assert stored(tmp_path, "good")["note"] == "of a closed window"
    browser.console()


def test_what_was_not_saved_does_not_go_over_what_another_one_saved(browser, serve, folder, tmp_path):
    process, address = serve(folder, "--out", tmp_path)
    go_to(browser, address, "good")
    note(browser, "first")
    browser.wait(SAVED)
    kill(process)
    note(browser, "mine")
    browser.wait(STOPPED)
    theirs = stored(tmp_path, "good") | {"revision": 5, "note": "theirs"}
    (tmp_path / "good.json").write_text(json.dumps(theirs))
    serve(folder, "--out", tmp_path)
    browser.wait("document.getElementById('conflict').open")
    assert stored(tmp_path, "good")["note"] == "theirs"
    browser.run("document.getElementById('take-theirs').click()")
    browser.wait(f"document.getElementById('note').value === 'theirs' && {READY}")
    assert browser.run("return Object.keys(localStorage).filter((key) => key.includes('draft'))") == []
    browser.console()


def test_the_name_is_asked_once_and_goes_into_the_files(browser, serve, folder, tmp_path):
    _, address = serve(folder, "--out", tmp_path)
    go_to(browser, address, "good")
    asked = "document.getElementById('author').classList.contains('asked')"
    assert not browser.run(f"return {asked}")
    note(browser, "x")
    browser.wait(f"{SAVED} && {asked}")
    browser.run("const a = document.getElementById('author'); a.value = ' Ada '; a.dispatchEvent(new Event('change'))")
    note(browser, "y")
    browser.wait(f"{SAVED} && !{asked}")
    assert stored(tmp_path, "good")["author"] == "Ada"
    go_to(browser, address, "open")
    assert browser.run("return document.getElementById('author').value") == "Ada"


def test_a_wrong_name_is_told_before_anything_else_and_mended_with_one_key(browser, serve, folder, tmp_path):
    go_to(browser, serve(folder / "good.png", "--out", tmp_path)[1], "good")
    named = "[...document.querySelectorAll('#markings .pick')].find((b) => b.textContent.includes('side line top'))"
    browser.run(f"{named}.click()")
    choose_on_field(browser, "big_rect_left_top")
    browser.wait(f"{SAVED} && document.querySelector('#offers .mend')")
    told = browser.run("return document.getElementById('missing').textContent")
    assert told.startswith("The name big rect left top contradicts the rest") and "probably side line top" in told
    assert browser.run("return document.getElementById('advice').className") == "no"
    assert not browser.run("return document.getElementById('confirm')")
    browser.run("document.activeElement.blur()")
    browser.press("a")
    browser.wait(f"{SAVED} && !document.querySelector('#offers .mend')")
    assert "side_line_top" in {m["name"] for m in stored(tmp_path, "good")["markings"]}
    assert not stored(tmp_path, "good")["touched"], "it says what was measured again"


def test_markings_can_be_hidden_and_the_magnifier_shows_the_template(browser, serve, folder, tmp_path, wide_camera):
    go_to(browser, serve(folder / "good.png", "--out", tmp_path)[1], "good")
    count = "return document.querySelectorAll('#drawing .traced').length"
    assert browser.run(count) > 2
    browser.run("document.activeElement.blur()")
    browser.press("p")
    assert browser.run(count) == 0
    browser.press("p")
    assert browser.run(count) > 2
    browser.run(
        "window.drawn = 0; const before = CanvasRenderingContext2D.prototype.lineTo;"
        "CanvasRenderingContext2D.prototype.lineTo = function (...at) { window.drawn += this.canvas.id === 'magnifier';"
        "return before.apply(this, at); };"
    )

    def lines_over(template: bool) -> int:
        box = browser.run(
            "const path = document.querySelector('#drawing .traced'), p = document.getElementById('picture');"
            "const at = path.getPointAtLength(path.getTotalLength() / 2), b = p.getBoundingClientRect();"
            "const zoom = b.width / p.naturalWidth; window.drawn = 0;"
            "return [b.left + at.x * zoom, b.top + at.y * zoom]"
        )
        browser.devtools("Input.dispatchMouseEvent", type="mouseMoved", x=box[0], y=box[1], button="none")
        browser.wait("window.drawn > 0")
        return browser.run("return window.drawn")

    cross = 4
    assert lines_over(True) > cross
    browser.press("v")
    assert lines_over(False) == cross


def test_files_that_are_dropped_are_taken_in(browser, serve, folder, tmp_path):
    go_to(browser, serve(folder / "good.png", "--out", tmp_path)[1], "good")
    line = {"Side line top": [{"x": 0.0, "y": 0.5}, {"x": 1.0, "y": 0.25}]}
    content = json.dumps(json.dumps(line))
    browser.run(
        "const held = new DataTransfer();"
        f"for (const name of ['good.json', 'other.json']) held.items.add(new File([{content}], name));"
        "document.body.dispatchEvent(new DragEvent('drop', { dataTransfer: held, bubbles: true, cancelable: true }))"
    )
    browser.wait("document.getElementById('saved').textContent === '1 taken in, 1 unknown'")
    assert "imported" in {m["source"] for m in stored(tmp_path, "good")["markings"]}


def test_the_next_frame_is_measured_while_one_is_looked_at(browser, serve, folder, tmp_path):
    go_to(browser, serve(folder, "--out", tmp_path)[1], "good")
    asked = "performance.getEntriesByType('resource').map((entry) => entry.name.split('/').slice(-2).join('/'))"
    browser.wait(f"{asked}.some((name) => name.endsWith('/measured'))")
    index = browser.run(
        "return [...document.querySelectorAll('.frame')].findIndex((row) => row.ariaSelected === 'true')"
    )
    assert [name for name in browser.run(f"return {asked}") if name.endswith("/measured")] == [f"{index + 1}/measured"]


def test_a_flagged_frame_asks_for_nothing_and_the_last_frame_leads_on(browser, serve, folder, tmp_path):
    go_to(browser, serve(folder, "--out", tmp_path)[1], "keys")
    choose = "const f = document.getElementById('flag'); f.value = 'no_field'; f.dispatchEvent(new Event('change'))"
    browser.run(choose)
    browser.wait(SAVED)
    told = browser.run("return document.getElementById('missing').textContent")
    assert told.startswith("Flagged: no field.") and browser.run("return document.getElementById('why').hidden")
    assert not browser.run("return document.getElementById('offers').textContent")
    go_to(browser, browser.run("return location.href.split('#')[0]"), "good")
    browser.run("document.getElementById('search').value = 'good';")
    browser.run("document.getElementById('search').dispatchEvent(new Event('input')); document.activeElement.blur()")
    browser.press("y")
    browser.wait("document.getElementById('saved').textContent === 'no other frame to do in this list'")
    assert stored(tmp_path, "good")["confirmed"]
