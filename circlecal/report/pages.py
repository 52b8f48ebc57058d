"""Writes the folder of the report: one page, its style and script, the list of frames, details and pictures."""

from __future__ import annotations

import contextlib
import json
import os
import re
import shutil
from collections import Counter, deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from typing import Any

from circlecal import __version__
from circlecal.checks import CHECKS
from circlecal.errors import InputError
from circlecal.files import is_file, is_folder, prepare_folder, read_file, real_path
from circlecal.overlay.canvas import Picture
from circlecal.overlay.quality import SCALE
from circlecal.pictures.files import REPORT_FOLDER, natural_order
from circlecal.records.json_text import result_line
from circlecal.refusals import explain
from circlecal.report.comparison import WORDS, Change, Comparison, compare, count_changes
from circlecal.report.details import frame_details, words
from circlecal.report.drawings import scene_of
from circlecal.report.figures import Histogram, clock, count_refusals, histogram, median_known, short, timelines
from circlecal.report.originals import Originals
from circlecal.report.pictures import KINDS, PER_FOLDER, Media, write_file, write_media
from circlecal.report.reading import FrameRow, StoredRun
from circlecal.report.tripods import HEADS, plan_of

PAGE_NAME = "index.html"
MARKER = '<meta name="generator" content="circlecal report'
ANNOTATE_NAME = "annotate.js"
"""Tells the page where the workbench of the run is served, if it is."""
DETAILS_PER_FILE = 50
_CODE = re.compile(r"circlecal (?!not)[a-z]+|--[a-z-]+(?: FOLDER)?|\b[a-z]+\.[a-z_]+(?:=\w+|\.\w+)?|\b[a-z]+\.\*")
_ASSETS = ("report.css", "base.js", "camera.js", "stage.js", "timeline.js", "report.js")
_COLUMNS = ("id", "stage", "reason", "case", "sigma_px", "sigma_m", "rms_px", "time_ms", "time_s")


@dataclass(frozen=True, slots=True)
class ReportOptions:
    """How a report is written.

    Attributes
    ----------
    frames : path or None
        Folder that the frames' pictures moved to since the run.
    width : int
        Largest width of the pictures in the report, pixels.
    title : str or None
        Title of the page; the name of the results' folder when None.
    """

    frames: Path | None = None
    width: int = 1280
    title: str | None = None


@dataclass(frozen=True, slots=True)
class WrittenReport:
    """The page, and how many of its frames have a picture."""

    page: Path
    frames: int
    pictures: int


def write_report(
    run: StoredRun,
    out: Path | None = None,
    options: ReportOptions | None = None,
    on_frame: Callable[[str], None] = lambda name: None,
    against: StoredRun | None = None,
) -> WrittenReport:
    """Write the report of a run.

    Parameters
    ----------
    run : StoredRun
        What :func:`circlecal.report.read_run` found.
    out : path, optional
        Folder of the report; an older report in it is replaced. ``circlecal-report`` in the results' folder when None.
    options : ReportOptions, optional
        The defaults when None.
    on_frame : callable
        Called with the id after each frame, in this thread.
    against : StoredRun, optional
        Another run of the same frames, to compare with.

    Raises
    ------
    InputError
        The results changed meanwhile, or the folder cannot be written or holds something else.
    """
    options = options or ReportOptions()
    if options.frames is not None and not is_folder(options.frames):
        raise InputError(f"{options.frames}: no such folder; give the one that the frames' pictures lie in")
    out = _clear(run.folder / REPORT_FOLDER if out is None else out)
    media: list[int] = []
    details: list[dict[str, Any]] = []
    compared: list[Comparison] = []
    for row, (written, told, comparison) in zip(run.rows, _write_frames(run, out, options, against), strict=True):
        media.append(int(written))
        details.append(told)
        if comparison is not None:
            compared.append(comparison)
        on_frame(row.id)
        if len(details) == DETAILS_PER_FILE or len(media) == len(run.rows):
            block = (len(media) - 1) // DETAILS_PER_FILE
            write_file(out / "details" / f"{block:05d}.js", _script(f"circlecalDetails({block},", details, ")"))
            details.clear()
    write_file(out / "frames.js", _script("circlecalFrames(", _listing(run, media, compared), ")"))
    write_file(out / ANNOTATE_NAME, _script("circlecalAnnotate(", None, ")"))
    for name in _ASSETS:
        write_file(out / name, resources.files("circlecal.report").joinpath("assets", name).read_bytes())
    write_file(out / PAGE_NAME, _page(run, options, compared, against).encode("utf-8", "replace"))
    pictures = sum(bool(m & Media.FRAME) for m in media)
    return WrittenReport(out / PAGE_NAME, len(run.rows), pictures)


def _clear(out: Path) -> Path:
    """Make the report's folder, take away what an older report left in it, and mark it as a report's."""
    prepare_folder(out)
    page = out / PAGE_NAME
    ours = is_file(page) and MARKER.encode() in read_file(page)
    if not ours and any(out.iterdir()):
        raise InputError(f"{out}: holds other files; choose another --out")
    write_file(page, f'<!DOCTYPE html><title>unfinished</title>{MARKER}">The report is being written.\n'.encode())
    for folder in ("details", "records", *(name for name, _ in KINDS.values())):
        shutil.rmtree(out / folder, ignore_errors=True)
    return out


_Written = tuple[Media, dict[str, Any], Comparison | None]
"""Which pictures of a frame were written, its details, and its comparison with the other run, if there is one."""


def _write_frames(run: StoredRun, out: Path, options: ReportOptions, against: StoredRun | None) -> Iterator[_Written]:
    """Write the files of every frame, in order: videos decoded here, one frame after the other, the rest in threads."""
    originals = Originals(run.folder, options.frames)
    workers = os.cpu_count() or 1
    waiting: deque[Future[_Written]] = deque()

    def write(index: int, decoded: Picture | None) -> _Written:
        row = run.rows[index]
        record = run.record(row)
        scene = scene_of(record)
        other = None if against is None else against.row(row.id)
        other_scene = None if against is None or other is None else scene_of(against.record(other))
        compared = None if against is None else compare(row, scene, other, other_scene)
        picture, drawn = originals.picture(row, decoded, None if scene is None else (scene.width, scene.height))
        written = write_media(out, index, scene, picture, drawn=drawn, width=options.width, other=other_scene)
        name = out / "records" / f"{index // PER_FOLDER:03d}" / f"{index:06d}.js"
        write_file(name, f"circlecalRecord({index},{result_line(record)});\n".encode("utf-8", "replace"))
        return written, frame_details(record, row, scene, compared), compared

    with ThreadPoolExecutor(workers) as pool:
        for index, decoded in enumerate(originals.decode(run.rows)):
            waiting.append(pool.submit(write, index, decoded))
            if len(waiting) > 2 * workers:
                yield waiting.popleft().result()
        while waiting:
            yield waiting.popleft().result()


def tell_workbench(run: Path, address: str | None, ended: str | None = None) -> None:
    """Tell the report of a run where its workbench is served, so that frames link to it; None when it has ended.

    What the report was told since by another workbench than the ``ended`` one stays. Without a report in its usual
    place nothing is written. Only the user who runs the workbench may read the file, since the address holds its token.
    """
    path = run / REPORT_FOLDER / ANNOTATE_NAME
    if not is_file(path) or (ended is not None and path.read_bytes() != _address_script(ended)):
        return
    with contextlib.suppress(OSError):
        path.chmod(0o600)
    write_file(path, _address_script(address))


def _address_script(address: str | None) -> bytes:
    return _script("circlecalAnnotate(", address, ")")


def _script(before: str, content: Any, after: str) -> bytes:
    """JSON as a script, since pages opened from a folder may load scripts but no JSON."""
    return (
        f"{before}{json.dumps(content, ensure_ascii=True, allow_nan=False, separators=(',', ':'))}{after};\n".encode()
    )


def _listing(run: StoredRun, media: list[int], compared: list[Comparison]) -> dict[str, Any]:
    """The list of frames by columns, for the page's script."""
    rows, reasons = run.rows, list(_reasons(run.rows))
    cameras = _cameras(rows)
    videos = [path for path in dict.fromkeys(map(_video, rows)) if path is not None]
    columns: dict[str, list[Any]] = {name: [_round(getattr(row, name)) for row in rows] for name in _COLUMNS}
    columns |= {
        "code": _places([row.refusal_code for row in rows], [reason["code"] for reason in reasons]),
        "media": media,
        "camera": _places([row.camera for row in rows], cameras),
        "gained": [int(row.gained) for row in rows],
        "change": [int(one.change) for one in compared] or [-1] * len(rows),
        "apart_px": [_round(one.apart_px) for one in compared] or [None] * len(rows),
        "video": _places([_video(row) for row in rows], videos),
    }
    return {
        "codes": [[reason["code"], reason["meaning"], reason["mend"]] for reason in reasons],
        "videos": [Path(path).name for path in videos],
        "cameras": cameras,
        "changes": [WORDS[change][0] for change in Change],
        "folder": str(run.folder),
        "checks": {words(name): [gate.measures, int(gate.at_least)] for name, gate in CHECKS.items()},
        "perFile": DETAILS_PER_FILE,
        "perFolder": PER_FOLDER,
        "columns": columns,
    }


def _places(values: Sequence[str | None], known: Sequence[str]) -> list[int]:
    """Where each value stands among the known ones; -1 for None."""
    place_by_value = {value: place for place, value in enumerate(known)}
    return [-1 if value is None else place_by_value[value] for value in values]


def _video(row: FrameRow) -> str | None:
    """Path of the video that a frame was decoded from, empty where the record has none; None of a picture."""
    return None if row.time_s is None else row.path or ""


def _cameras(rows: list[FrameRow]) -> list[str]:
    return sorted({row.camera for row in rows if row.camera is not None}, key=natural_order)


def _round(value: Any) -> Any:
    return float(f"{value:.5g}") if isinstance(value, float) else value


def _page(run: StoredRun, options: ReportOptions, compared: list[Comparison], against: StoredRun | None) -> str:
    import jinja2

    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("circlecal.report"),
        autoescape=True,
        trim_blocks=True,
        lstrip_blocks=True,
        undefined=jinja2.StrictUndefined,
    )
    environment.filters.update(short=short, clock=clock, thousands=_thousands, coded=_mark_code)
    template = environment.get_template("index.html.j2")
    return template.render(
        title=options.title or real_path(run.folder).name,
        circlecal_version=__version__,
        run=run,
        summary=_summary(run.rows),
        reasons=list(_reasons(run.rows)),
        histograms=_histograms(run.rows),
        timelines=timelines(run.rows),
        cameras=_cameras(run.rows),
        changes=count_changes(compared),
        against="" if against is None else real_path(against.folder).name,
        plan=plan_of(run.folder, run.rows, run.fields.most_common(1)[0][0]),
        plan_heads=HEADS,
        sigma_scale=SCALE,
        rows=run.rows,
    )


def _thousands(count: int) -> str:
    return f"{count:,}".replace(",", "\N{NO-BREAK SPACE}")


def _mark_code(text: str) -> str:
    """Escaped text with commands, options and settings set as code."""
    import markupsafe

    return markupsafe.Markup(_CODE.sub(r"<code>\g<0></code>", str(markupsafe.escape(text))))


def _summary(rows: list[FrameRow]) -> dict[str, Any]:
    calibrated = [row for row in rows if row.calibrated]
    return {
        "frames": len(rows),
        "calibrated": len(calibrated),
        "refused": len(rows) - len(calibrated),
        "share": 100.0 * len(calibrated) / len(rows),
        "sigma_px": median_known(row.sigma_px for row in calibrated),
        "sigma_m": median_known(row.sigma_m for row in calibrated),
        "rms_px": median_known(row.rms_px for row in calibrated),
        "time_ms": median_known(row.time_ms for row in rows),
        "gained": sum(row.gained for row in rows),
        "cases": sorted(Counter(row.case for row in calibrated if row.case is not None).items()),
    }


def _reasons(rows: list[FrameRow]) -> Iterator[dict[str, Any]]:
    """Each reason for which frames were refused, the most frequent first: what it means, what helps, and how often."""
    stages = {row.refusal_code: row.stage for row in rows}
    counts = count_refusals(rows)
    refused = sum(count for _, count in counts)
    for code, count in counts:
        refusal = explain(code, stages[code])
        yield {
            "code": code,
            "count": count,
            "share": 100.0 * count / refused,
            "stage": stages[code],
            "meaning": refusal.meaning,
            "mend": refusal.help,
        }


def _histograms(rows: list[FrameRow]) -> list[tuple[str, str, str, Histogram, str]]:
    at = "at 1920 px width"
    wanted = (
        (
            "Predicted sigma",
            "px",
            f"Largest predicted standard deviation of the field near what is seen, {at}.",
            "sigma_px",
        ),
        ("Residual", "px", f"Rms distance of the circle's points from the fitted ellipse, {at}.", "rms_px"),
        ("Time", "ms", "Calibration time per frame, all stages; median of all frames.", "time_ms"),
    )
    found = []
    for name, unit, meaning, column in wanted:
        values = {
            accepted: [
                v for row in rows if row.calibrated == accepted and (v := _round(getattr(row, column))) is not None
            ]
            for accepted in (True, False)
        }
        drawn = histogram(values[True], values[False], () if column == "time_ms" else values[True])
        if drawn is not None:
            found.append((name, unit, meaning, drawn, column))
    return found
