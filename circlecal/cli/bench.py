"""``circlecal bench NAME``: the tables of the README."""

from __future__ import annotations

from math import isnan, nan
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from circlecal.cli import options

if TYPE_CHECKING:
    from circlecal.evaluation.bench.accuracy import Row
    from circlecal.evaluation.bench.annotations import AnnotationRow
    from circlecal.evaluation.bench.simulation import Summary
    from circlecal.evaluation.bench.track import TrackRow

app = typer.Typer(
    help="Print accuracy and speed tables, peers and statistical bounds in the same run.", no_args_is_help=True
)


@app.command()
def accuracy(
    rows: Annotated[str, typer.Option(help="Rows to run, separated by commas, e.g. 3,5,8; all when empty.")] = "",
    draws: Annotated[int, typer.Option(min=2, help="Random cameras per row.")] = 100,
    seed: Annotated[int, typer.Option(help="Seed of the draws.")] = 0,
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON instead of a table.")] = False,
) -> None:
    """Error of the camera on synthetic observations, beside the Cramer-Rao bound on the same draws."""
    from circlecal.cli.console import count_steps
    from circlecal.errors import ConfigError
    from circlecal.evaluation.bench.accuracy import all_row_names, as_records, run_rows
    from circlecal.evaluation.bench.many_frames import select_rigs
    from circlecal.evaluation.bench.scenarios import select_rows

    names = [name.strip() for name in rows.split(",") if name.strip()]
    unknown = [n for n in names if n not in all_row_names()]
    if unknown:
        raise ConfigError(f"--rows: {', '.join(unknown)} is unknown; known: {', '.join(all_row_names())}")
    with count_steps("draw", (len(select_rows(names)) + len(select_rigs(names))) * draws) as advance:
        found, closed = run_rows(names, draws, seed, advance)
    if as_json:
        _print_json({"rows": as_records(found), "closed_forms": dict(closed)})
        return
    _print_accuracy(found)
    if closed:
        _table("Closed forms (mean reprojection error, px)", ["row", "px"], [[n, f"{v:.3g}"] for n, v in closed])


@app.command()
def ransac(
    draws: Annotated[int, typer.Option(min=2, help="Draws per outlier share.")] = 200,
    seed: Annotated[int, typer.Option(help="Seed of the draws.")] = 0,
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON instead of a table.")] = False,
) -> None:
    """Robust ellipse fits under outliers, and their speed beside OpenCV and scikit-image."""
    from dataclasses import asdict

    from circlecal.cli.console import count_steps
    from circlecal.evaluation.bench.ransac import OUTLIER_SHARES, robustness, speed

    with count_steps("draw", len(OUTLIER_SHARES) * draws) as advance:
        good = robustness(draws, seed, advance)
    fast = speed(seed)
    if as_json:
        _print_json({"robustness": [asdict(r) for r in good], "speed": [asdict(s) for s in fast]})
        return
    _table(
        "Within 1.5 x of the fit on the true inliers (400 points, row 14)",
        ["outliers", "sigma px", "draws", "good"],
        [[f"{r.outliers:.0%}", f"{r.sigma_px:g}", str(r.draws), f"{r.good:.1%}"] for r in good],
    )
    _table(
        "1000 hypotheses on 800 points, one thread (row 15)",
        ["what", "ms", "times circlecal's"],
        [[s.name, f"{s.ms:.1f}", f"{s.ratio:.1f}"] for s in fast],
    )


@app.command()
def detect(
    count: Annotated[int, typer.Option(min=1, help="Rendered frames per profile.")] = 20,
    seed: Annotated[int, typer.Option(help="Seed of the frames.")] = 0,
    profiles: Annotated[str, typer.Option(help="Profiles separated by commas; all when empty.")] = "",
    width: Annotated[
        int, typer.Option(min=320, max=7680, help="Width of the rendered frames, 16:9; archive frames have their own.")
    ] = 1920,
    picture: Annotated[
        Path | None,
        typer.Option(metavar="JPEG", help="Only time the chain on this frame, e.g. samples/full_circle.jpg."),
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON instead of a table.")] = False,
) -> None:
    """Whole chain on rendered frames: completeness, errors, predicted against true error, time stage by stage."""
    from dataclasses import asdict

    if picture is not None:
        _time_picture(picture, as_json)
        return
    from circlecal.cli.console import count_steps
    from circlecal.evaluation.bench.detect import PROFILES, run_profiles

    names = [name.strip() for name in profiles.split(",") if name.strip()]
    with count_steps("frame", len(names or PROFILES) * count) as advance:
        found = run_profiles(names, count, seed, advance, width)
    if as_json:
        _print_json([asdict(r) for r in found])
        return
    _table(
        "Rendered frames, picture alone (mean reprojection error near the circle, px at 1920)",
        [
            "profile",
            "frames",
            "calibrated",
            "good",
            "wrong",
            "right",
            "median px",
            "p90 px",
            "predicted px",
            "in 90 % region",
            "x decoding",
        ],
        [
            [
                r.profile,
                str(r.frames),
                f"{r.calibrated:.0%}",
                f"{r.good:.0%}",
                f"{r.wrong:.1%}",
                f"{r.right:.0%}",
                _format_figure(r.median_px, ".2f"),
                _format_figure(r.p90_px, ".2f"),
                _format_figure(r.predicted_median_px, ".2f"),
                _format_figure(r.coverage, ".0%"),
                f"{r.times_decoding:.1f}",
            ]
            for r in found
        ],
    )
    _table(
        "What the markings in view allow at best (Cramer-Rao bound from the truth, lines named right)",
        ["profile", "bound px", "bound good", "good"],
        [[r.profile, _format_figure(r.bound_median_px, ".2f"), f"{r.bound_good:.0%}", f"{r.good:.0%}"] for r in found],
    )
    stages = list(dict.fromkeys(name for r in found for name in r.stage_ms))
    _table(
        "Median ms of each stage, one thread",
        ["profile", "decoding", *stages],
        [
            [r.profile, f"{r.decoding_ms:.1f}", *(_format_figure(r.stage_ms.get(n, nan), ".1f") for n in stages)]
            for r in found
        ],
    )


@app.command()
def sports(
    pictures: Annotated[Path, typer.Argument(metavar="FOLDER", help="Pictures of any sports.")],
    truth: Annotated[
        Path | None,
        typer.Option(metavar="FOLDER", help="A JSON file for each, with its sport. (default: truth beside FOLDER)"),
    ] = None,
    per_frame: Annotated[bool, typer.Option("--per-frame", help="Also what was tried for each frame.")] = False,
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON instead of a table.")] = False,
) -> None:
    """Real frames whose field nobody names (--field auto): is the sport recognised, and does soccer lose nothing?"""
    from dataclasses import asdict

    from circlecal.cli.console import count_steps
    from circlecal.evaluation.bench.sports import run_frames, summarise_sports
    from circlecal.pictures.files import find_frames

    folder = truth or pictures.parent / "truth"
    with count_steps("frame", len(find_frames([pictures]))) as advance:
        frames = run_frames(pictures, folder, advance)
    rows = summarise_sports(frames)
    if as_json:
        _print_json({"frames": [asdict(f) for f in frames], "sports": [asdict(r) for r in rows]})
        return
    if per_frame:
        _table(
            "Frame by frame: template, verdict, evidence in picture widths, share found, share explained",
            ["frame", "sport", "answer", "error px", "s", "tried"],
            [
                [
                    f.id,
                    f.sport,
                    f.template if f.is_answered else str(f.code),
                    "-" if f.error_px is None else f"{f.error_px:.1f}",
                    f"{f.seconds:.1f}",
                    "; ".join(f.tried),
                ]
                for f in frames
            ],
        )
    _table(
        "Fields told by the picture (--field auto)",
        [
            "sport",
            "frames",
            "answered",
            "right sport",
            "good",
            "wrong",
            "as if named",
            "median s",
            "worst s",
        ],
        [
            [
                r.sport,
                str(r.frames),
                str(r.answered),
                f"{r.right_sport} ({r.right_sport / max(r.answered, 1):.0%})",
                f"{r.good} of {r.with_reference}",
                str(r.wrong),
                f"{r.kept} of {r.frames}",
                f"{r.median_s:.1f}",
                f"{r.worst_s:.1f}",
            ]
            for r in rows
        ],
    )


def _time_picture(path: Path, as_json: bool) -> None:
    from dataclasses import asdict

    from circlecal.config import Config
    from circlecal.evaluation.bench.chain_time import time_file

    found = time_file(path, Config())
    if as_json:
        _print_json({**asdict(found), "times_decoding": found.times_decoding})
        return
    named = {
        "decoding": found.decoding_ms,
        "decoding, between chains": found.decoding_in_turn_ms,
        "chain": found.chain_ms,
    }
    _table(
        f"{found.frame}, {found.width}x{found.height}, {found.status}: best of several runs, one thread",
        ["what", "ms", "x decoding"],
        [[n, f"{ms:.2f}", f"{ms / found.decoding_ms:.2f}"] for n, ms in {**named, **found.stage_ms}.items()],
    )


@app.command()
def solvers(
    solver: Annotated[
        list[str] | None, typer.Option("--solver", metavar="NAME", help="Solver; repeatable. (default: all)")
    ] = None,
    scenario: Annotated[
        list[str] | None, typer.Option("--scenario", metavar="NAME", help="View; repeatable. (default: all)")
    ] = None,
    draws: Annotated[int, typer.Option(min=2, help="Random cameras per view.")] = 100,
    seed: Annotated[int, typer.Option(min=0, help="Seed of the draws.")] = 0,
    workers: Annotated[
        int, typer.Option(min=1, help="Processes; with more than one the times are not to be read.")
    ] = 1,
    no_statements: Annotated[
        bool, typer.Option("--no-statements", help="Leave out focal lengths and the paper's statements.")
    ] = False,
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON instead of tables.")] = False,
) -> None:
    """Every published solver on every view, and the paper's statements that the runs do not confirm."""
    from circlecal.cli.console import count_steps
    from circlecal.evaluation.bench.solvers import as_records, paper_statements, run_focals, run_solvers, scenario_count

    with count_steps("camera", scenario_count(scenario or ()) * draws) as advance:
        found = run_solvers(solver or (), scenario or (), draws, seed, workers, advance)
    focals, statements = [], []
    if not no_statements:
        with count_steps("camera", 6 * draws) as advance:
            focals = run_focals(draws, seed, advance)
            statements = paper_statements(draws, seed, workers, advance)
    if as_json:
        _print_json(as_records(found, focals, statements))
        return
    _print_solvers(found)
    if no_statements:
        return
    _table(
        "Focal length, methods that find nothing else: median relative error",
        ["method", "from", "noise px", "draws", "error", "no answer"],
        [
            [
                f.method,
                f.view,
                f"{f.noise_px:g}",
                str(f.draws),
                "-" if f.median_percent is None else f"{f.median_percent:.2g} %",
                f"{f.failed:.0%}",
            ]
            for f in focals
        ],
    )
    _table(
        "Statements of the paper that these runs do not confirm",
        ["where", "it says", "here"],
        [[s.where, s.says, s.found] for s in statements if not s.confirmed],
    )


def _print_solvers(found: list[Summary]) -> None:
    """Combinations in which nothing is answered are named below the table instead of filling it."""
    _table(
        "Mean reprojection error, px at 1920 x 1080, of the answered draws",
        ["scenario", "noise px", "solver", "draws", "median", "p90", "no answer", "bound", "ms"],
        [
            [
                s.scenario,
                f"{s.noise_px:g}",
                s.solver,
                str(s.draws),
                f"{s.median_px:.3g}",
                f"{s.p90_px:.3g}",
                f"{s.failed:.0%}",
                f"{s.bound_median_px:.3g} ({s.bound_p90_px:.3g})",
                f"{s.ms:.1f}",
            ]
            for s in found
            if s.median_px is not None and s.p90_px is not None
        ],
    )
    silent = [s for s in found if s.median_px is None]
    if silent:
        _table(
            "No answer on any draw",
            ["scenario", "solver", "reason"],
            [[s.scenario, s.solver, ", ".join(s.codes)] for s in silent],
        )


@app.command("batch")
def time_batch(
    count: Annotated[int, typer.Option(min=2, help="Rendered frames per run.")] = 24,
    workers: Annotated[int, typer.Option("--workers", "-w", min=2, help="Worker processes beside one.")] = 2,
    repeats: Annotated[int, typer.Option(min=1, help="Runs of each; the best counts.")] = 2,
    tasks: Annotated[int, typer.Option(min=0, help="Simulated frames, which take no time; 0 for none.")] = 100_000,
    seed: Annotated[int, typer.Option(min=0, help="Seed of the frames.")] = 0,
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON instead of tables.")] = False,
) -> None:
    """Throughput of a batch, what it adds to the calibrations, and how time and memory grow with the frames."""
    from dataclasses import asdict

    from circlecal.cli.console import count_steps
    from circlecal.evaluation.bench.batch import run_scaling, run_throughput

    with count_steps("run", 2 * repeats + (3 if tasks else 0)) as advance:
        rates = run_throughput(count, workers, repeats, seed, advance)
        scaling = run_scaling(tasks, workers, advance) if tasks else None
    if as_json:
        _print_json({"throughput": [asdict(r) for r in rates], "scaling": scaling and asdict(scaling)})
        return
    _table(
        "Rendered frames, steady state",
        ["workers", "frames/s", "times one worker", "time added", "CPU s a calibration", "CPU added"],
        [
            [
                str(r.workers),
                f"{r.rate:.2f}",
                f"{r.speedup:.2f}",
                f"{r.overhead:.1%}",
                f"{r.cpu_s:.3f}",
                f"{r.cpu_overhead:.1%}",
            ]
            for r in rates
        ],
    )
    if scaling is None:
        return
    early, late, taken = scaling.memory_mb
    _table(
        f"{scaling.frames} simulated frames, {scaling.megabytes:.0f} MB of results",
        ["what", "s", "MB in memory"],
        [
            ["run, first tenth", "", f"{early:.0f}"],
            ["run, whole", f"{scaling.seconds:.1f}", f"{late:.0f}"],
            ["taken up: results scanned", f"{scaling.index_seconds:.3f}", ""],
            ["taken up: every frame passed over, summary written", f"{scaling.skip_seconds:.1f}", f"{taken:.0f}"],
            ["taken up without an index", f"{scaling.rebuild_seconds:.1f}", ""],
        ],
    )


@app.command()
def track(
    path: Annotated[
        Path | None,
        typer.Argument(metavar="PATH", help="Folder of circlecal synth --video. (default: clips are rendered)"),
    ] = None,
    count: Annotated[int, typer.Option(min=1, help="Clips to render.")] = 5,
    kinds: Annotated[str, typer.Option(help="Kinds of clips separated by commas; all when empty.")] = "",
    seconds: Annotated[float, typer.Option(min=0.2, max=60.0, help="Length of a clip.")] = 10.0,
    rate: Annotated[float, typer.Option(min=1.0, max=120.0, help="Frames per second.")] = 25.0,
    width: Annotated[int, typer.Option(min=320, max=3840, help="Width of the frames, 16:9.")] = 1280,
    seed: Annotated[int, typer.Option(min=0, help="Seed of the clips.")] = 0,
    config: options.ConfigFile = None,
    settings: options.Settings = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON instead of tables.")] = False,
) -> None:
    """Every frame of rendered clips: answered, right, errors, jitter, cuts, tripods, and time beside decoding."""
    from dataclasses import asdict

    from circlecal.cli.console import count_steps
    from circlecal.errors import ConfigError
    from circlecal.evaluation.bench.track import clips_of, render_and_track, spec_of, track_folder
    from circlecal.synthetic.video import CLIP_KINDS

    wanted = [name.strip() for name in kinds.split(",") if name.strip()]
    unknown = [name for name in wanted if name not in CLIP_KINDS]
    if unknown:
        raise ConfigError(f"--kinds: {', '.join(unknown)} is unknown; known: {', '.join(CLIP_KINDS)}")
    chosen = options.choose_config(config, settings)
    known = [name for name in CLIP_KINDS if name in wanted]
    with count_steps("clip", count if path is None else len(clips_of(path))) as advance:
        if path is None:
            found = render_and_track(known, count, seed, spec_of(width, seconds, rate), chosen, advance)
        else:
            found = track_folder(path, chosen, advance)
    if as_json:
        _print_json([asdict(row) for row in found])
        return
    _print_tracking(found)


def _print_tracking(rows: list[TrackRow]) -> None:
    from circlecal.tracking.clock import STAGES

    _table(
        "Rendered clips: main camera, mean error over the pitch in view, px at 1920",
        [
            *("clip", "frames", "answered", "good", "wrong", "in cuts", "in replays", "median px", "p90 px"),
            *("jitter px", "p90 jitter px", "in 90 % region", "tripods", "frames until found again"),
        ],
        [
            [
                r.clip,
                str(r.frames),
                f"{r.answered:.1%}",
                f"{r.good:.1%}",
                f"{r.wrong:.1%}",
                str(r.in_cuts),
                str(r.in_replays),
                _format_figure(r.median_px, ".2f"),
                _format_figure(r.p90_px, ".2f"),
                _format_figure(r.jitter_median_px, ".3f"),
                _format_figure(r.jitter_p90_px, ".3f"),
                _format_figure(r.coverage, ".0%"),
                str(r.tripods),
                ", ".join(map(str, r.found_again)) or "-",
            ]
            for r in rows
        ],
    )
    _table(
        "Time on one thread, ms a frame; the survey once a clip",
        [
            "clip",
            "width",
            "survey s",
            "decoding",
            "tracking",
            *(f"- {stage}" for stage in STAGES),
            "record",
            "x decoding",
        ],
        [
            [
                r.clip,
                str(r.width),
                f"{r.time.survey_s:.1f}",
                f"{r.time.decoding_ms:.1f}",
                f"{r.time.tracking_ms:.1f}",
                *(f"{r.time.stages_ms.get(stage, 0.0):.1f}" for stage in STAGES),
                f"{r.time.record_ms:.1f}",
                f"{r.time.times_decoding:.1f}",
            ]
            for r in rows
        ],
    )


@app.command("annotations")
def score_annotations(
    path: Annotated[Path, typer.Argument(metavar="PATH", help="Folder of <set>/ground_truth, ...")],
    sets: Annotated[str, typer.Option(help="Sets separated by commas; all when empty.")] = "",
    config: Annotated[str, typer.Option("--config", "-c", help="YAML file, or a name.")] = "annotations",
    settings: options.Settings = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON instead of a table.")] = False,
) -> None:
    """Annotated real frames, official metric at 1920x1080: published peers, then circlecal on the same frames."""
    from dataclasses import asdict

    from circlecal.cli.console import count_steps
    from circlecal.evaluation.bench.annotations import run_annotations, set_names

    names = [name.strip() for name in sets.split(",") if name.strip()] or set_names(path)
    chosen = options.choose_config(config, settings)
    with count_steps("set", len(names)) as advance:
        found = run_annotations(path, chosen, names, advance)
    if as_json:
        _print_json([asdict(r) for r in found])
        return
    _print_annotations(found)


def _print_annotations(rows: list[AnnotationRow]) -> None:
    words = {"circle and halfway line": "frames with circle and halfway line", "all": "frames, all that there are"}
    for name, kind in dict.fromkeys((r.set_name, r.frames_kind) for r in rows):
        chosen = [r for r in rows if (r.set_name, r.frames_kind) == (name, kind)]
        _table(
            f"{name}: {chosen[0].frames} {words.get(kind, kind)}, 1920x1080, misses as 0",
            ["method", "input", "answered", "JaC5", "JaC10", "other lines px", "JaC5 minus the first (95 %)"],
            [
                [
                    r.method,
                    r.input_name,
                    str(r.answered),
                    f"{100 * r.jac_5:.1f}",
                    f"{100 * r.jac_10:.1f}",
                    f"{r.held_out_px:.2f}",
                    "-"
                    if r.ahead is None
                    else f"{100 * r.ahead.mean:+.1f} ({100 * r.ahead.low:+.1f} to {100 * r.ahead.high:+.1f})",
                ]
                for r in chosen
            ],
        )


@app.command("annotate")
def click_frames(
    path: Annotated[
        Path | None,
        typer.Argument(metavar="[FOLDER]", help="Real frames: images/ and truth/; rendered ones alone without."),
    ] = None,
    rendered: Annotated[int, typer.Option(min=0, help="Rendered frames of each kind.")] = 10,
    seed: Annotated[int, typer.Option(min=0, help="Seed of the rendered frames and of the hand.")] = 0,
    config: options.ConfigFile = None,
    settings: options.Settings = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON instead of tables.")] = False,
) -> None:
    """Clicks in the workbench until a refused or doubtful frame is calibrated and good, and the time of a change."""
    from dataclasses import asdict

    from circlecal.cli.console import count_steps
    from circlecal.evaluation.bench.clicks import PROFILES, count_clicks, summarise_clicks

    chosen = options.choose_config(config, settings)
    real = 0 if path is None else len(list((path / "truth").glob("*.json")))
    with count_steps("frame", real + len(PROFILES) * rendered) as advance:
        rows = count_clicks(path, rendered, seed, advance, chosen)
    summary = summarise_clicks(rows)
    if as_json:
        _print_json({"frames": [asdict(row) for row in rows], "groups": [asdict(group) for group in summary]})
        return
    _table(
        "Refused and doubtful frames, clicked until calibrated and good",
        ["frames of", "frames", "good already", "clicks: median", "90 %", "given up", "slowest change ms"],
        [
            [
                group.name,
                str(group.frames),
                str(group.good_already),
                _format_figure(group.median_clicks, "g"),
                _format_figure(group.p90_clicks, "g"),
                str(group.given_up),
                _format_figure(group.slowest_ms, ".0f"),
            ]
            for group in summary
        ],
    )
    _table(
        "Frame by frame",
        ["frame", "before", "clicks", "what was done"],
        [
            [
                row.frame,
                row.state,
                "given up" if row.clicks is None else str(row.clicks),
                ", then ".join(row.steps) or "-",
            ]
            for row in rows
        ],
    )


@app.command()
def constants(
    count: Annotated[int, typer.Option(min=1, help="Rendered frames per profile.")] = 10,
    seed: Annotated[int, typer.Option(help="Seed of the frames.")] = 0,
    profiles: Annotated[str, typer.Option(help="Profiles separated by commas; all when empty.")] = "",
    width: Annotated[int, typer.Option(min=320, max=7680, help="Width of the rendered frames, 16:9.")] = 1920,
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON instead of a table.")] = False,
) -> None:
    """What each limit of the verdict separates: its check on right and on wrong answers to rendered frames."""
    from dataclasses import asdict

    from circlecal.cli.console import count_steps
    from circlecal.evaluation.bench.constants import collect_answers, summarise_gates
    from circlecal.evaluation.bench.detect import PROFILES

    names = [name.strip() for name in profiles.split(",") if name.strip()]
    with count_steps("frame", len(names or PROFILES) * count) as advance:
        answers = collect_answers(names, count, seed, advance, width)
    rows = summarise_gates(answers)
    if as_json:
        _print_json([asdict(row) for row in rows])
        return

    def quantiles(values: tuple[float, float, float]) -> str:
        return "-" if isnan(values[1]) else " ".join(f"{value:.3g}" for value in values)

    right, wrong = sum(a.is_right for a in answers), sum(a.is_wrong for a in answers)
    _table(
        f"Checks of the verdict on {right} right (<= 5 px) and {wrong} wrong (> 20 px) answers; values at 5, 50, 95 %",
        ["check", "limit", "right", "passed", "wrong", "stopped", "by it alone"],
        [
            [
                row.name,
                f"{row.limit:.3g}",
                quantiles(row.right_quantiles),
                _format_figure(row.right_passed, ".1%"),
                quantiles(row.wrong_quantiles),
                _format_figure(row.wrong_stopped, ".1%"),
                str(row.stopped_alone),
            ]
            for row in rows
        ],
    )


def _format_figure(value: float, form: str) -> str:
    """A figure, or a dash where no frame gave one."""
    return "-" if isnan(value) else format(value, form)


def _print_accuracy(rows: list[Row]) -> None:
    if not rows:
        return
    _table(
        "Mean reprojection error, px at 1920 x 1080: median (90th percentile)",
        [
            "row",
            "scenario",
            "draws",
            "circlecal",
            "bound",
            "mean / bound",
            "wrong",
            "failed",
            "to reach",
            "H in 90 %",
            "ms",
        ],
        [
            [
                r.row,
                r.title,
                str(r.draws),
                f"{r.median_px:.2f} ({r.p90_px:.2f})",
                f"{r.bound_median_px:.2f} ({r.bound_p90_px:.2f})",
                f"{r.efficiency:.2f} +- {r.efficiency_error:.2f}",
                f"{r.wrong:.1%}",
                f"{r.failed:.1%}",
                _reach(r),
                f"{r.coverage.get('homography', float('nan')):.0%}",
                f"{r.ms:.0f}",
            ]
            for r in rows
        ],
    )
    _table(
        "Median by the camera's offset from the halfway plane",
        ["row", *rows[0].by_offset],
        [
            [r.row, *(f"{v:.2f}" for v in r.by_offset.values())]
            for r in rows
            if r.by_offset.keys() == rows[0].by_offset.keys()
        ],
    )


@app.command()
def fuzz(
    count: Annotated[int, typer.Option(min=1, help="Damaged files in all.")] = 10_000,
    seed: Annotated[int, typer.Option(min=0, help="Seed of the damage.")] = 0,
    only: Annotated[str, typer.Option(help="Part of the name of the readers that are wanted.")] = "",
    keep: Annotated[
        Path | None, typer.Option(metavar="FOLDER", help="Keep files here on which something goes wrong.")
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON instead of a table.")] = False,
) -> None:
    """Damaged files for every reader and command: tracebacks, hangs, memory and exit codes that must not be."""
    from dataclasses import asdict

    from circlecal.cli.console import count_steps
    from circlecal.cli.invoke import run_command
    from circlecal.errors import InputError
    from circlecal.evaluation.bench.fuzz import HANG_S, MOST_MB, FuzzRow, is_supported, run_fuzz

    if not is_supported():
        raise InputError("bench fuzz: needs the timers of a Unix system")
    with count_steps("file", count) as advance:
        rows = run_fuzz(count, seed, run_command, only, keep, advance)
    if as_json:
        _print_json([asdict(row) for row in rows])
    else:
        every = FuzzRow("all")
        for row in rows:
            for name in ("inputs", "read", "refused", "tracebacks", "hangs", "over_memory", "wrong_exits"):
                setattr(every, name, getattr(every, name) + getattr(row, name))
        every.slowest_s, every.most_mb = max(row.slowest_s for row in rows), max(row.most_mb for row in rows)
        _table(
            "Damaged files",
            [
                *("reader", "files", "read", "refused", "tracebacks", f"over {HANG_S:g} s", f"over {MOST_MB:g} MB"),
                *("wrong exit codes", "slowest s", "most MB"),
            ],
            [
                [
                    *(r.name, str(r.inputs), str(r.read), str(r.refused), str(r.tracebacks), str(r.hangs)),
                    *(str(r.over_memory), str(r.wrong_exits), f"{r.slowest_s:.1f}", f"{r.most_mb:.0f}"),
                ]
                for r in (*rows, every)
            ],
        )
    for row in rows:
        for example in row.examples:
            typer.echo(f"{row.name}: {example}", err=True)
    if any(row.failures for row in rows):
        raise typer.Exit(1)


@app.command()
def faults(
    kills: Annotated[int, typer.Option(min=1, help="How often a batch is killed.")] = 100,
    frames: Annotated[int, typer.Option(min=1, help="Frames of a batch.")] = 200,
    workers: Annotated[int, typer.Option("--workers", "-w", min=1, help="Worker processes.")] = 2,
    seed: Annotated[int, typer.Option(min=0, help="Seed of the moments.")] = 0,
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON instead of a table.")] = False,
) -> None:
    """A batch killed with SIGKILL at random moments and taken up again: what is lost, and what is there twice."""
    from dataclasses import asdict

    from circlecal.cli.console import count_steps
    from circlecal.evaluation.bench.faults import run_kills

    with count_steps("kill", kills) as advance:
        report = run_kills(kills, frames, workers, seed, advance)
    if as_json:
        _print_json(asdict(report))
    else:
        _table(
            f"Killed at random moments; of {report.finished_runs} runs that ended {report.wrong_ends} ended wrongly",
            ["killed", "times", "finished frames lost", "frames twice", "damaged lines"],
            [[r.phase, str(r.kills), str(r.lost), str(r.doubled), str(r.damaged)] for r in report.rows],
        )
    if report.wrong_ends or any(r.lost or r.doubled or r.damaged for r in report.rows):
        raise typer.Exit(1)


@app.command()
def soak(
    count: Annotated[int, typer.Option(min=20, help="Small frames.")] = 20_000,
    workers: Annotated[int, typer.Option("--workers", "-w", min=1, help="Worker processes.")] = 2,
    seed: Annotated[int, typer.Option(min=0, help="Seed of the frames.")] = 0,
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON instead of a table.")] = False,
) -> None:
    """A long batch of small frames: memory, open files and temporary files after a fifth of it and at its end."""
    from dataclasses import asdict

    from circlecal.cli.console import count_steps
    from circlecal.evaluation.bench.soak import run_soak

    with count_steps("frame", count) as advance:
        report = run_soak(count, workers, seed, advance)
    if as_json:
        _print_json({**asdict(report), "growth": report.growth})
        return
    (memory, later), (files, open_later) = report.memory_mb, report.files
    _table(
        f"{report.frames} small frames on {workers} workers, {report.rate:.1f} frames/s",
        ["", "after a fifth", "at the end", "growth"],
        [
            ["resident memory, MB", f"{memory:.0f}", f"{later:.0f}", f"{report.growth:+.1%}"],
            ["open files", str(files), str(open_later), f"{open_later - files:+d}"],
            ["temporary files", "", str(report.temporary), ""],
        ],
    )


def _reach(row: Row) -> str:
    if row.reach_median_px == float("inf"):
        return "-"
    return f"{row.reach_median_px:.3g}" + (f" ({row.reach_p90_px:.3g})" if row.reach_p90_px is not None else "")


def _table(title: str, columns: list[str], rows: list[list[str]]) -> None:
    from circlecal.cli.console import print_table

    print_table(title, columns, rows)


def _print_json(record: object) -> None:
    import json
    import math

    def finite(value: object) -> object:
        if isinstance(value, float) and not math.isfinite(value):
            return None
        if isinstance(value, dict):
            return {k: finite(v) for k, v in value.items()}
        return [finite(v) for v in value] if isinstance(value, list | tuple) else value

    typer.echo(json.dumps(finite(record), indent=1, allow_nan=False))
