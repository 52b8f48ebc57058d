"""The folder that is written: whole, escaped, readable in both themes, and without an address outside of it."""

import json
import re
import shutil
from html.parser import HTMLParser
from importlib import resources
from pathlib import Path

import cv2
import numpy as np
import pytest

from circlecal.pictures.files import OVERLAY_SUFFIX, REPORT_FOLDER, find_frames
from circlecal.report import ReportOptions, read_run, write_report
from circlecal.report.pictures import Media
from tests.report.conftest import refused, write_run

NASTY = "<img src=x onerror=alert(1)>&\"'</script>"


def listing(report: Path) -> dict:
    text = (report / "frames.js").read_text()
    return json.loads(text.removeprefix("circlecalFrames(").removesuffix(");\n"))


def details(report: Path, block: int = 0) -> list[dict]:
    text = (report / "details" / f"{block:05d}.js").read_text()
    return json.loads(text.removeprefix(f"circlecalDetails({block},").removesuffix(");\n"))


def media(report: Path) -> list[Media]:
    return [Media(value) for value in listing(report)["columns"]["media"]]


def written(folder: Path, records: list[dict], **options) -> Path:
    return write_report(read_run(write_run(folder, records)), None, ReportOptions(**options)).page.parent


class Tags(HTMLParser):
    """Every start tag with its attributes."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.found: list[tuple[str, dict]] = []
        self.feed(text)

    def handle_starttag(self, tag, attrs):
        self.found.append((tag, dict(attrs)))


def test_a_frame_with_its_picture(tmp_path, named, picture_file, frame_image):
    report = written(tmp_path / "run", [named("good", path=str(picture_file))])
    (has,) = media(report)
    assert has == Media.THUMBNAIL | Media.FRAME | Media.TEMPLATE | Media.POINTS | Media.RADAR | Media.PLAN
    frame = cv2.imread(str(report / "frames" / "000" / "000000.jpg"))
    assert np.abs(frame.astype(int) - frame_image).mean() < 6
    thumbnail = cv2.imread(str(report / "thumbnails" / "000" / "000000.jpg"))
    assert thumbnail.shape == (180, 320, 3)
    radar = cv2.imread(str(report / "radar" / "000" / "000000.jpg"))
    size = re.search(r'viewBox="\S+ \S+ (\S+) (\S+)"', (report / "plan" / "000" / "000000.svg").read_text())
    assert radar.shape[1] / radar.shape[0] == pytest.approx(float(size[1]) / float(size[2]), rel=0.01)


def test_width_limits_the_picture(tmp_path, named, picture_file):
    report = written(tmp_path / "run", [named("good", path=str(picture_file))], width=480)
    assert cv2.imread(str(report / "frames" / "000" / "000000.jpg")).shape == (270, 480, 3)


@pytest.mark.parametrize(("aspect", "seen"), [(4 / 3, (270, 640)), (0.5, (540, 480)), (1e-9, (360, 640))])
def test_pictures_of_other_pixels_are_shown_as_they_are_seen(tmp_path, named, picture_file, aspect, seen):
    image = {"width": 960, "height": 540, "aspect": aspect}
    report = written(tmp_path / "run", [named("good", path=str(picture_file), image=image)], width=640)
    shown = cv2.imread(str(report / "frames" / "000" / "000000.jpg"))
    assert shown.shape[:2] == seen
    thumbnail = cv2.imread(str(report / "thumbnails" / "000" / "000000.jpg"))
    assert thumbnail.shape[1] / thumbnail.shape[0] == pytest.approx(seen[1] / seen[0], rel=0.01)
    template = (report / "template" / "000" / "000000.svg").read_text()
    assert 'viewBox="0 0 960 540"' in template and 'preserveAspectRatio="none"' in template
    size = re.search(r' width="(\S+)" height="(\S+)"', template)
    assert float(size[1]) / float(size[2]) == pytest.approx(seen[1] / seen[0], rel=0.01)


def test_pictures_that_moved(tmp_path, named, picture_file):
    report = written(tmp_path / "run", [named("good", path="elsewhere/good.png")], frames=picture_file.parent)
    assert Media.FRAME in media(report)[0]


def test_the_picture_of_an_annotation(tmp_path, named, picture_file):
    records = [
        named("x", path=str(picture_file.with_suffix(".json"))),
        named("good", path=str(picture_file.with_name("coco.json"))),
    ]
    assert all(Media.FRAME in has for has in media(written(tmp_path / "run", records)))


def test_without_the_picture_the_overlay_then_the_drawing(tmp_path, named, frame_image):
    folder = write_run(tmp_path, [named("a"), named("b")])
    cv2.imwrite(str(folder / f"a{OVERLAY_SUFFIX}"), frame_image)
    report = write_report(read_run(folder)).page.parent
    assert media(report) == [
        Media.THUMBNAIL | Media.FRAME | Media.DRAWN | Media.PLAN,
        Media.TEMPLATE | Media.POINTS | Media.PLAN,
    ]


@pytest.mark.parametrize("content", [b"", b"no picture", "small"])
def test_a_picture_that_is_none_any_more(tmp_path, named, content):
    path = tmp_path / "good.png"
    if content == "small":  # another picture of the same name would put the template beside its field
        cv2.imwrite(str(path), np.zeros((100, 100, 3), np.uint8))
    else:
        path.write_bytes(content)
    assert Media.FRAME not in media(written(tmp_path / "run", [named("good", path=str(path))]))[0]


def test_unreadable_frames_have_nothing_to_show(tmp_path):
    report = written(tmp_path, [refused("a") | {"image": None}])
    assert media(report) == [Media(0)]


def test_everything_from_outside_is_escaped(tmp_path, named):
    records = [
        refused(NASTY, code=NASTY, reason=NASTY, stage=NASTY),
        named("v", source={"path": f"{NASTY}.mp4", "time_s": 1.0}, config_digest=NASTY),
        refused("w", code=NASTY) | {"source": {"path": f"{NASTY}.mp4", "time_s": 2.0}},
        refused("lone \ud800 surrogate"),
    ]
    folder = write_run(tmp_path / "<b>run", records)
    report = write_report(read_run(folder), None, ReportOptions(title=NASTY)).page.parent
    page = (report / "index.html").read_text()
    assert "<img" not in page
    assert "<b>" not in page
    assert "onerror" not in {name for _, attributes in Tags(page).found for name in attributes}
    assert page.count("</script>") == page.count("<script")
    assert listing(report)["columns"]["id"].count(NASTY) == 1


def test_the_page_tells_of_the_run(tmp_path, named):
    report = written(tmp_path / "evening", [named("a"), refused("b"), refused("c"), refused("d", code="too_uncertain")])
    page = (report / "index.html").read_text()
    words = " ".join(re.sub(r"<[^>]+>", " ", page).split())
    record = named("a")
    for said in ("evening", "25.0 %", record["version"], record["config_digest"], "no_field", "too_uncertain"):
        assert said in words
    assert "different configurations" in words
    assert "hardly any playing surface is seen" in words
    assert "circlecal rig or --camera-prior bring in what other frames" in words


def test_the_page_of_a_tracked_clip_has_no_empty_figures(tmp_path, named):
    alone = (written(tmp_path / "alone", [named("a")]) / "index.html").read_text()
    record = named("a") | {"ellipses": None, "timings_ms": {}}
    tracked = (written(tmp_path / "tracked", [record]) / "index.html").read_text()
    assert "median residual" in alone and "median time" in alone
    assert "median residual" not in tracked and "median time" not in tracked


def test_what_the_rig_gained(tmp_path, named):
    rig = {"camera": "camera-1", "reason": None, "alone": {"status": "refused", "code": "rotation_free"}}
    kept = {"camera": None, "reason": "x", "alone": {"status": "refused", "code": "no_field"}}
    report = written(tmp_path, [named("a", rig=rig), refused("b") | {"rig": kept}, named("c")])
    columns = listing(report)["columns"]
    assert (columns["camera"], columns["gained"]) == ([0, -1, -1], [1, 0, 0])
    assert "1 thanks to other frames" in (report / "index.html").read_text()
    assert ["tripod", "camera-1, refused alone (rotation_free)"] in details(report)[0]["facts"]


def test_no_address_leaves_the_folder(tmp_path, named):
    report = written(tmp_path, [named("a"), refused("b")])
    for path in report.rglob("*"):
        if path.suffix in (".html", ".css", ".js", ".svg"):
            text = path.read_text().replace("http://www.w3.org/2000/svg", "").replace(r"http:\/\/127\.0\.0\.1:", "")
            assert not re.search(r"https?:|//[a-z]+\.|@import|url\(", text), path
    for tag, attributes in Tags((report / "index.html").read_text()).found:
        for name in ("src", "href"):
            target = attributes.get(name, "#")
            assert target.startswith(("#", "data:,")) or (report / target).is_file(), (tag, target)


def test_the_page_is_accessible_as_written(tmp_path, named):
    tags = Tags((written(tmp_path, [named("a"), refused("b")]) / "index.html").read_text()).found
    assert [tag for tag, _ in tags].count("h1") == 1
    assert {"main", "nav", "header", "footer", "h2", "dialog"} <= {tag for tag, _ in tags}
    assert next(attributes for tag, attributes in tags if tag == "html")["lang"] == "en"
    identifiers = [attributes["id"] for _, attributes in tags if "id" in attributes]
    assert len(identifiers) == len(set(identifiers))
    for tag, attributes in tags:
        assert tag != "svg" or attributes.get("role") != "img" or attributes["aria-label"]
        assert attributes.get("aria-labelledby", identifiers[0]) in identifiers


def test_its_pictures_are_no_frames(tmp_path, named, picture_file):
    report = written(picture_file.parent / "run", [named("a", path=str(picture_file))])
    assert (report / "frames" / "000" / "000000.jpg").is_file()
    assert [frame.id for frame in find_frames([picture_file.parent])] == ["good"]


def test_written_again_without_leftovers(tmp_path, named):
    report = written(tmp_path, [named(str(k)) for k in range(3)])
    assert len(list(report.glob("template/*/*.svg"))) == 3
    written(tmp_path, [named("0")])
    assert len(list(report.glob("template/*/*.svg"))) == 1


def test_another_folder_is_not_overwritten(tmp_path, named, run_circlecal):
    folder, out = write_run(tmp_path / "run", [named("a")]), tmp_path / "out"
    out.mkdir()
    (out / "index.html").write_text("mine")
    outcome = run_circlecal("report", folder, "--out", out)
    assert (outcome.code, outcome.err.count("\n")) == (2, 1)
    assert "holds other files" in outcome.err
    assert (out / "index.html").read_text() == "mine"


def test_many_frames_are_split_into_blocks(tmp_path, named):
    report = written(tmp_path, [refused(f"f{k}") for k in range(120)])
    assert [len(details(report, block)) for block in range(3)] == [50, 50, 20]
    assert len(listing(report)["columns"]["id"]) == 120


def test_command(tmp_path, named, picture_file, run_circlecal):
    folder = write_run(tmp_path / "run", [named("a", path=str(picture_file)), refused("b")])
    outcome = run_circlecal("report", folder, "--title", "Cup final")
    assert outcome.code == 0
    assert (
        outcome.out.strip()
        == f"{folder / REPORT_FOLDER / 'index.html'}: 2 frames, 1 without a picture (has it moved? --frames FOLDER)"
    )
    assert "<title>Cup final" in (folder / REPORT_FOLDER / "index.html").read_text()
    assert run_circlecal("report", folder / "results.jsonl", "--quiet").out == ""
    assert run_circlecal("report", folder, "--frames", tmp_path / "absent").code == 2


def test_results_of_calibrate(tmp_path, frame_file, blank_file, run_circlecal):
    out = tmp_path / "out"
    run_circlecal("calibrate", frame_file, blank_file, "--out", out)
    assert run_circlecal("report", out).code == 0
    shutil.rmtree(frame_file.parent)
    columns = listing(out / REPORT_FOLDER)["columns"]
    assert (columns["id"], columns["code"]) == (["blank", "good"], [0, -1])
    assert all(Media.FRAME in has for has in media(out / REPORT_FOLDER))


def luminance(color: str) -> float:
    digits = color[1:] if len(color) == 7 else "".join(2 * c for c in color[1:])
    channels = np.array([int(digits[k : k + 2], 16) / 255 for k in (0, 2, 4)])
    linear = np.where(channels <= 0.04045, channels / 12.92, ((channels + 0.055) / 1.055) ** 2.4)
    return float(linear @ [0.2126, 0.7152, 0.0722])


def contrast(a: str, b: str) -> float:
    high, low = sorted((luminance(a), luminance(b)), reverse=True)
    return (high + 0.05) / (low + 0.05)


def test_contrast_itself():
    assert contrast("#ffffff", "#000000") == pytest.approx(21.0)
    assert contrast("#777777", "#fff") == pytest.approx(4.48, abs=0.01)


@pytest.mark.parametrize("theme", [0, 1], ids=["light", "dark"])
def test_colours_have_contrast(theme):
    css = resources.files("circlecal.report").joinpath("assets", "report.css").read_text()
    colors = {m[0]: m[1 + theme] for m in re.findall(r"--([\w-]+): light-dark\((#\w+), (#\w+)\);", css)}
    assert len(colors) > 15
    for ground in ("page", "panel"):
        for name in ("text", "note", "link", "calibrated", "refused"):
            assert contrast(colors[name], colors[ground]) >= 4.5, (name, ground)
        for name in ("strong-line", "focus", "sigma", *(f"r{k}" for k in range(6))):
            assert contrast(colors[name], colors[ground]) >= 3.0, (name, ground)
    for k in range(6):  # refused stretches against the calibrated ground of the timeline
        assert contrast(colors[f"r{k}"], colors["quiet"]) >= 3.0, k
    assert contrast("#ffffff", colors["turf"]) >= 4.5
