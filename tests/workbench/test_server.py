import errno
import json
import os
import urllib.error
import urllib.request
from pathlib import Path
from urllib.parse import urlsplit

import pytest

from circlecal.config import Config
from circlecal.errors import InputError
from circlecal.formats.annotation import parse_annotation
from circlecal.formats.registry import read_annotations
from circlecal.tracking import stretches
from circlecal.workbench.address import PageAddress, keep_address, make_address, recall_address
from circlecal.workbench.session import Session
from tests.tracking import scripted


class Client:
    """Asks a server, past any proxy."""

    def __init__(self, address: str) -> None:
        self.address = address
        self._opener = urllib.request.build_opener(urllib.request.ProxyHandler({}))

    def ask(self, path: str, method: str = "GET", body: object = None, **headers: str) -> tuple[int, bytes, dict]:
        content = body if isinstance(body, bytes | None) else json.dumps(body).encode()
        request = urllib.request.Request(self.address + path, content, headers, method=method)
        try:
            with self._opener.open(request, timeout=120) as answer:
                return answer.status, answer.read(), dict(answer.headers)
        except urllib.error.HTTPError as error:
            return error.code, error.read(), dict(error.headers)

    def json(self, path: str, method: str = "GET", body: object = None):
        status, content, _ = self.ask(path, method, body)
        assert status == 200, content
        return json.loads(content)


@pytest.fixture(scope="module")
def out(tmp_path_factory) -> Path:
    return tmp_path_factory.mktemp("annotations")


@pytest.fixture(scope="module")
def client(serve, folder, out) -> Client:
    return Client(serve(folder, "--out", out)[1])


def number_of(client: Client, name: str) -> int:
    return [row[0] for row in client.json("frames.json")["frames"]].index(name)


def test_strangers_are_refused(client):
    parts = urlsplit(client.address)
    stranger = Client(f"http://{parts.netloc}/")
    assert stranger.ask("")[0] == 404
    assert stranger.ask("guessed/")[0] == 404
    assert client.ask("", Host="evil.example")[0] == 403
    assert client.ask("frames.json", Origin="http://evil.example")[0] == 403
    assert client.ask("frames.json", **{"Sec-Fetch-Site": "cross-site"})[0] == 403
    link = {"Sec-Fetch-Site": "cross-site", "Sec-Fetch-Mode": "navigate", "Sec-Fetch-Dest": "document"}
    assert client.ask("", **link)[0] == 200  # a person follows the link of a report
    assert client.ask("frames.json", **link)[0] == 403
    assert client.ask("", **link | {"Sec-Fetch-Dest": "iframe"})[0] == 403
    assert parts.hostname == "127.0.0.1" and len(parts.path) > 30


@pytest.mark.parametrize(
    "path", ["../pyproject.toml", "..%2f..%2fpyproject.toml", "frames/..%2f0.jpg", "%2fetc%2fpasswd"]
)
def test_no_path_leads_out(client, path):
    assert client.ask(path)[0] in (400, 404)


def test_the_page_keeps_to_itself(client):
    status, content, headers = client.ask("")
    assert status == 200 and b"circlecal workbench" in content
    policy = headers["content-security-policy"]
    assert "default-src 'none'" in policy and "unsafe" not in policy
    assert headers["referrer-policy"] == "no-referrer"


def test_a_change_is_saved_and_another_window_does_not_overwrite_it(client, out):
    index = number_of(client, "open")
    shown = client.json(f"frames/{index}.json")
    annotation = shown["annotation"]
    assert shown["answer"]["status"] == "refused" and not (out / "open.json").exists()
    line = next(m for m in annotation["markings"] if m["kind"] == "line" and len(m["points_px"]) > 100)
    line["name"] = "side_line_top"
    saved = client.json(f"frames/{index}.json", "PUT", {"base": 0, "annotation": annotation})
    assert saved["answer"]["status"] == "calibrated" and saved["annotation"]["revision"] == 1
    assert saved["row"][1] in ("calibrated", "doubtful") and saved["row"][5]
    stored = parse_annotation(out / "open.json", (out / "open.json").read_bytes())
    assert "side_line_top" in {m.name for m in stored.markings}
    status, content, _ = client.ask(
        f"frames/{index}.json", "PUT", {"base": 0, "annotation": annotation | {"note": "later"}}
    )
    assert status == 409 and json.loads(content)["current"]["revision"] == 1
    assert parse_annotation(out / "open.json", (out / "open.json").read_bytes()).note == ""


@pytest.mark.parametrize(
    "change",
    [
        {"id": "good"},
        {"width": 10},
        {"markings": [{"kind": "line", "points_px": [[1, 2]], "sigma_px": []}]},
        {"settings": {"seed": 1}},
    ],
)
def test_what_is_no_annotation_of_the_frame_is_refused_in_one_line(client, change):
    index = number_of(client, "open")
    annotation = client.json(f"frames/{index}.json")["annotation"]
    status, content, _ = client.ask(
        f"frames/{index}.json", "PUT", {"base": annotation["revision"], "annotation": annotation | change}
    )
    assert status == 400
    assert "\n" not in json.loads(content)["error"]


def test_clicks_are_answered(client):
    index = number_of(client, "good")
    assert client.json(f"frames/{index}/mark", "POST", {"mode": "exact", "points": [[5, 6]]})["points"] == [[5, 6]]
    assert client.ask(f"frames/{index}/mark", "POST", {"mode": "exact", "points": [[5, 6000]]})[0] == 400
    assert client.ask("frames/99.json")[0] == 400
    assert client.ask(f"frames/{index}.jpg")[1][:2] == b"\xff\xd8"


def test_annotations_go_out_and_come_back(client, tmp_path):
    name, content = "labelstudio", client.ask("export/labelstudio")[1]
    path = tmp_path / "labelstudio.json"
    path.write_bytes(content)
    _, frames = read_annotations(path, (960, 540), name)
    labels = {shape.label for frame in frames for shape in frame.shapes}
    assert {"Circle central", "Side line top"} <= labels
    told = client.json("import?name=labelstudio.json", "POST", content)
    assert told == {"taken": len(frames), "unknown": 0, "warnings": []}
    assert client.ask("import?name=x.json", "POST", b"nonsense")[0] == 400
    assert client.ask("export/nothing")[0] == 400


def labelme(size: tuple[int, int], *labels: str) -> dict[str, object]:
    points = [[100.0, 100.0], [400.0, 120.0]]
    shapes = [{"label": label, "shape_type": "line", "points": points} for label in labels]
    return {"shapes": shapes, "imagePath": "keys.png", "imageWidth": size[0], "imageHeight": size[1]}


@pytest.mark.parametrize(
    ("content", "told"),
    [
        (labelme((960, 540), "goose"), "keys: nothing in it is a marking of this field: keys: goose"),
        (labelme((540, 540), "Side line top"), "keys: the annotation is of 540x540, the picture 960x540"),
    ],
    ids=["label", "aspect"],
)
def test_a_file_that_cannot_be_used_changes_nothing(client, out, content, told):
    status, answer, _ = client.ask("import?name=keys.json", "POST", content)
    assert status == 400 and told in json.loads(answer)["error"]
    assert not (out / "keys.json").exists()
    assert not client.json("frames.json")["frames"][number_of(client, "keys")][5]


def test_an_imported_frame_is_judged_anew_and_what_was_left_out_is_told(client):
    keys = number_of(client, "keys")
    shown = client.json(f"frames/{keys}.json")
    line = next(m for m in shown["annotation"]["markings"] if m["kind"] == "line" and len(m["points_px"]) > 100)
    half = [[(x + 0.5) / 2, (y + 0.5) / 2] for x, y in line["points_px"][::20]]
    content = labelme((480, 270), "Side line top", "goose")
    content["shapes"][0] |= {"shape_type": "linestrip", "points": half}
    told = client.json("import?name=keys.json", "POST", content)
    assert (told["taken"], told["unknown"]) == (1, 0)
    assert len(told["warnings"]) == 1 and "goose" in told["warnings"][0]
    after = client.json("frames.json")["frames"][keys]
    assert shown["row"][1] == "refused" and after[1] in ("calibrated", "doubtful") and after[5]


def test_a_file_without_a_size_is_read_in_that_of_its_frame(client, out):
    line = {"Side line top": [{"x": 0.0, "y": 0.5}, {"x": 1.0, "y": 0.25}]}
    assert client.json("import?name=keys.json", "POST", line)["taken"] == 1
    stored = parse_annotation(out / "keys.json", (out / "keys.json").read_bytes())
    (imported,) = [m for m in stored.markings if m.source == "imported"]
    assert imported.points_px == [[0.0, 269.5], [959.0, 134.75]]


@pytest.mark.parametrize("name", ["", "..", "a/", "%00"])
def test_a_file_without_a_name_does_not_hinder_later_ones(client, out, name):
    line = {"Side line top": [{"x": 0.0, "y": 0.5}, {"x": 1.0, "y": 0.25}]}
    assert client.ask(f"import?name={name}", "POST", line)[0] in (200, 400)
    assert client.json("import?name=keys.json", "POST", line)["taken"] == 1
    assert (out / "imported").is_dir()


def test_a_picture_whose_name_is_no_text_is_annotated_like_any_other(serve, folder, run_circlecal, tmp_path):
    name, out = os.fsdecode(b"caf\xe9"), tmp_path / "out"
    picture = tmp_path / f"{name}.png"
    picture.write_bytes((folder / "good.png").read_bytes())
    client = Client(serve(picture, "--out", out)[1])
    annotation = client.json("frames/0.json")["annotation"]
    assert annotation["source"] == str(picture)
    told = client.json("frames/0.json", "PUT", {"base": 0, "annotation": annotation | {"note": "mine"}})
    assert told["annotation"]["source"] == str(picture)
    assert client.json("frames/0.json")["annotation"]["note"] == "mine"
    for kind in ("coco", "cvat", "labelme"):
        assert client.ask(f"export/{kind}")[0] == 200
    command = ("calibrate", picture, "--annotations", out, "--out", tmp_path / "result", "--json", "--no-overlay")
    outcome = run_circlecal(*command)
    assert outcome.code == 0 and json.loads(outcome.out)["annotation"]


def test_a_frame_to_begin_with_must_be_there(folder, run_circlecal):
    outcome = run_circlecal("annotate", folder / "good.png", "--frame", "nobody", "--no-browser")
    assert (outcome.code, outcome.err.count("\n")) == (2, 1)
    assert "--frame nobody: no such frame" in outcome.err


@pytest.mark.parametrize("command", [("annotate", "--no-browser"), ("debug",)])
def test_a_venue_is_read(folder, run_circlecal, command, tmp_path):
    (tmp_path / "venue.yaml").write_text("tripods: []\n")
    outcome = run_circlecal(*command, folder / "good.png", "--venue", tmp_path / "venue.yaml")
    assert (outcome.code, outcome.err.count("\n")) == (2, 1)
    assert "venue.yaml: is no venue" in outcome.err


def test_a_run_whose_pictures_are_gone_and_an_address_are_one_line(folder, run_circlecal, in_this_process, tmp_path):
    picture = tmp_path / "moved.png"
    picture.write_bytes((folder / "good.png").read_bytes())
    out = tmp_path / "run"
    assert run_circlecal("batch", picture, "--out", out, "--no-overlay", "--workers", 1, "-q").code == 0
    picture.unlink()
    outcome = run_circlecal("annotate", out, "--no-browser")
    assert (outcome.code, outcome.err.count("\n")) == (2, 1)
    assert "its pictures are not where they were" in outcome.err and "moved.png" in outcome.err
    outcome = run_circlecal("annotate", "http://127.0.0.1:1/picture.jpg", "--no-browser")
    assert (outcome.code, outcome.err.count("\n")) == (2, 1)
    assert "http://127.0.0.1:1/picture.jpg: is a URL" in outcome.err


@pytest.fixture
def opened(monkeypatch) -> list[Session]:
    """Sessions that would have been served."""
    found: list[Session] = []
    monkeypatch.setattr("circlecal.workbench.server.serve", lambda session, port, tell, part: found.append(session))
    return found


def test_a_run_is_opened_on_its_own_field_with_its_own_sizes(folder, run_circlecal, in_this_process, tmp_path, opened):
    run, other = tmp_path / "run", tmp_path / "other"
    command = ("batch", folder / "good.png", "--no-overlay", "--workers", 1, "-q", "--out")
    assert run_circlecal(*command, run, "--set", "field.sizes.length=104").code == 0
    outcome = run_circlecal("annotate", run, "--no-browser")
    assert outcome.code == 0 and opened[-1].template.length_m == 104 and "other options" not in outcome.err
    outcome = run_circlecal("annotate", run, "--no-browser", "--field", "futsal")
    assert (outcome.code, outcome.err.count("\n")) == (2, 1)
    assert f"{run}: is of the field soccer, not of futsal; name its field with --field, or none" in outcome.err
    setting = ("--set", "verdict.max_sigma_px=63")
    assert run_circlecal(*command, other, *setting).code == 0
    assert "other options than these" in run_circlecal("annotate", other, "--no-browser").err
    assert "other options" not in run_circlecal("annotate", other, "--no-browser", *setting).err
    results = other / "results.jsonl"
    results.write_text(results.read_text().replace('"template":"soccer"', '"template":"futsal"'))
    assert run_circlecal("annotate", other, "--no-browser", "-q").code == 0
    assert opened[-1].template.name == "futsal"
    results.write_text(results.read_text().replace('"template":"futsal"', '"template":"somebody\'s"'))
    outcome = run_circlecal("annotate", other, "--no-browser")
    assert outcome.code == 2 and "give the file of its field with --field" in outcome.err
    assert run_circlecal("annotate", run, folder / "good.png", "--no-browser", "-q").code == 0
    assert len(opened[-1].frames) == 1, "a frame that is given twice is listed once"
    outcome = run_circlecal("annotate", run, other, "--no-browser")
    assert outcome.code == 2 and "give one run at a time, or --out FOLDER here" in outcome.err


def test_the_cameras_that_a_run_found_are_known_to_the_page(run_circlecal, tmp_path, opened, monkeypatch):
    monkeypatch.setattr(stretches, "survey_clip", scripted.survey_clip)
    monkeypatch.setattr(stretches, "track_frames", scripted.track_frames)
    clip, out = scripted.write_clip(tmp_path / "clip.mp4"), tmp_path / "out"
    assert run_circlecal("track", clip, "--out", out, "--every", "10", "-q").code == 0
    told = run_circlecal("annotate", out, "--no-browser").err
    assert f"{out / 'venue.yaml'}: frames are calibrated by its cameras; name another one with --venue" in told
    known, plain = opened[-1].config.camera, Config().camera
    assert known != plain and "other options" not in told
    run_circlecal("annotate", out, "--no-browser", "--venue", out / "venue.yaml")
    assert opened[-1].config.camera == known
    (out / "venue.yaml").rename(out / "clip.venue.yaml")
    assert "name another one" not in run_circlecal("annotate", out, "--no-browser").err
    assert opened[-1].config.camera == plain


def test_two_pictures_of_one_id_and_a_file_as_folder_are_refused_in_one_line(
    folder, run_circlecal, in_this_process, tmp_path
):
    run, picture = tmp_path / "run", tmp_path / "good.png"
    picture.write_bytes((folder / "open.png").read_bytes())
    assert run_circlecal("batch", folder / "good.png", "--no-overlay", "--workers", 1, "-q", "--out", run).code == 0
    outcome = run_circlecal("annotate", run, picture, "--no-browser")
    assert (outcome.code, outcome.err.count("\n")) == (2, 1)
    assert f"good: is the id of {folder / 'good.png'} and of {picture}" in outcome.err
    outcome = run_circlecal("annotate", picture, "--out", picture, "--no-browser")
    assert (outcome.code, outcome.err.count("\n")) == (2, 1)
    assert "good.png: is a file, not a folder; choose another --out" in outcome.err


def test_a_folder_that_cannot_be_written_to_is_told_before_the_page_is_served(
    folder, run_circlecal, in_this_process, tmp_path, monkeypatch
):
    def refuse(*_, **__):
        raise OSError(errno.EROFS, "Read-only file system")

    monkeypatch.setattr("circlecal.workbench.server.serve", lambda *_: pytest.fail("is served"))
    monkeypatch.setattr(Path, "touch", refuse)
    outcome = run_circlecal("annotate", folder / "good.png", "--out", tmp_path, "--no-browser")
    assert (outcome.code, outcome.err.count("\n")) == (2, 1)
    assert "cannot be written: Read-only file system; choose another --out" in outcome.err


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (("annotate", "results.jsonl", "--no-browser"), "results of a run, not a picture; give its folder"),
        (("calibrate", "good.png", "--venue", "results.jsonl"), "holds results, not a venue; give the venue.yaml"),
        (("debug", "day.zip"), "day.zip: is a ZIP; debug takes pictures"),
        (("calibrate", "results.jsonl"), "not an annotation; give its pictures instead"),
        (("calibrate", "day.zip"), "day.zip: is no ZIP archive that can be read"),
    ],
)
def test_results_and_archives_in_the_place_of_other_files_are_one_line(
    folder, run_circlecal, in_this_process, tmp_path, monkeypatch, arguments, told
):
    monkeypatch.chdir(tmp_path)
    Path("good.png").write_bytes((folder / "good.png").read_bytes())
    Path("results.jsonl").write_text('{"schema_version": 1, "id": "good", "status": "refused", "image": null}\n')
    Path("day.zip").write_bytes(b"PK")
    outcome = run_circlecal(*arguments)
    assert (outcome.code, outcome.err.count("\n")) == (2, 1), outcome
    assert told in outcome.err


def test_the_report_of_a_run_is_told_of_the_workbench_while_it_runs(
    folder, run_circlecal, in_this_process, tmp_path, monkeypatch
):
    out = tmp_path / "run"
    assert run_circlecal("batch", folder / "good.png", "--out", out, "--no-overlay", "--workers", 1, "-q").code == 0
    assert run_circlecal("report", out, "-q").code == 0
    told = out / "circlecal-report" / "annotate.js"
    seen = []

    def serve(session, port, on_ready, part):
        on_ready("http://127.0.0.1:4711/t0ken/")
        seen.append((told.read_text(), told.stat().st_mode & 0o777))

    monkeypatch.setattr("circlecal.workbench.server.serve", serve)
    outcome = run_circlecal("annotate", out, "--frame", "good", "--no-browser", "-q")
    assert outcome.out == "http://127.0.0.1:4711/t0ken/#good\n"
    assert seen == [('circlecalAnnotate("http://127.0.0.1:4711/t0ken/");\n', 0o600)]
    assert told.read_text() == "circlecalAnnotate(null);\n"

    def serve_beside(session, port, on_ready, part):
        on_ready("http://127.0.0.1:4712/other/")
        told.write_text('circlecalAnnotate("http://127.0.0.1:4713/later/");\n')

    monkeypatch.setattr("circlecal.workbench.server.serve", serve_beside)
    assert run_circlecal("annotate", out, "--no-browser", "-q").code == 0
    assert "later" in told.read_text(), "a workbench that goes on keeps its link"

    def refuse(path, content):
        raise InputError(f"{path}: cannot be written: Read-only file system")

    monkeypatch.setattr("circlecal.report.pages.write_file", refuse)
    outcome = run_circlecal("annotate", out, "--no-browser")
    assert outcome.code == 0 and "4712" in outcome.out
    assert "Read-only file system; the report has no link to this page" in " ".join(outcome.err.split())


def test_the_address_of_a_folder_is_kept_between_starts(serve, folder, tmp_path):
    first, address = serve(folder, "--out", tmp_path)
    beside, other = serve(folder, "--out", tmp_path)
    assert other.split("/")[2:4] != address.split("/")[2:4], "the first one is still served"
    _, of_part = serve(folder, "--out", tmp_path, "--part", "1/1")
    assert of_part.split("/")[3] != address.split("/")[3]
    for process in (first, beside):
        process.kill()
        process.wait()
    assert serve(folder, "--out", tmp_path)[1] == address
    assert not any(path.name.startswith("workbench") for path in tmp_path.rglob("*")), "a token is nobody else's"


def test_an_address_of_an_earlier_start_says_what_to_do(serve, folder, tmp_path):
    old = urlsplit(serve(folder, "--out", tmp_path)[1])
    for accept, kind in (("text/html", "text/html"), ("*/*", "application/json")):
        request = urllib.request.Request(f"http://{old.netloc}/another-token/", headers={"Accept": accept})
        with pytest.raises(urllib.error.HTTPError) as caught:
            urllib.request.build_opener(urllib.request.ProxyHandler({})).open(request)
        assert caught.value.code == 404 and caught.value.headers["content-type"].startswith(kind)
        assert "Open the address that it printed last" in caught.value.read().decode()


def test_an_address_that_is_damaged_or_cannot_be_kept_is_another_one(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    kept = PageAddress(4711, make_address().token)
    keep_address(Path("a"), None, kept)
    assert recall_address(Path("a"), None) == kept
    assert recall_address(Path("a"), "1/2") is None and recall_address(Path("b"), None) is None
    (file,) = (tmp_path / "circlecal").iterdir()
    assert file.stat().st_mode & 0o777 == 0o600
    for damaged in ("{", "[]", '{"port": 70000, "token": "x"}', f'{{"port": 1, "token": "{"x" * 31}/"}}'):
        file.write_text(damaged)
        assert recall_address(Path("a"), None) is None
    monkeypatch.setenv("XDG_STATE_HOME", str(file))
    keep_address(Path("a"), None, kept)
    assert recall_address(Path("a"), None) is None
