"""``circlecal bench constants``: what the verdict's limits separate, on right and on wrong answers to rendered frames.

Wrong answers come from the pictures of the right ones: whatever else in them can be taken for the circle and its line
is tried too, also where the first answer is accepted, and each picture is calibrated once more as another sport's.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from circlecal.checks import CHECKS
from circlecal.evaluation.bench.detect import GOOD_PX, WRONG_PX, compare, profile_config
from circlecal.pipeline import field_of
from circlecal.pipeline.other_circles import take_arcs
from circlecal.pipeline.refinements import calibrate_scene
from circlecal.pipeline.setting import Scene, Setting, frame_generator, prepare_scene
from circlecal.results import Attempt, Check, Interpretation
from circlecal.synthetic.sampling import SCENE_PROFILES, SceneProfile, render_frame

MOST_OTHERS = 3
"""Other interpretations of one picture that are looked at."""
OTHER_SPORT = {"soccer": "futsal"}
"""Sport as which a picture of each sport is calibrated once more; pictures of all others are calibrated as soccer."""


@dataclass(frozen=True, slots=True)
class Answer:
    """One attempt at a rendered frame: its error (px at 1920 px width) and the checks that were made of it."""

    error_px: float
    checks: tuple[Check, ...]

    @property
    def is_right(self) -> bool:
        """Whether it is good."""
        return self.error_px <= GOOD_PX

    @property
    def is_wrong(self) -> bool:
        """Whether it must not be accepted."""
        return self.error_px > WRONG_PX


@dataclass(frozen=True, slots=True)
class GateRow:
    """One check of the verdict over all answers in which it was made.

    Attributes
    ----------
    name : str
        Of the check.
    limit : float
        Median of its limits: some grow with the width of the picture or with stated noise.
    right, wrong : int
        How many right and wrong answers it was made of.
    right_quantiles, wrong_quantiles : tuple of float
        5, 50 and 95 % of its value.
    right_passed, wrong_stopped : float
        Shares; nan where there is none.
    stopped_alone : int
        Wrong answers that no other check stops.
    """

    name: str
    limit: float
    right: int
    wrong: int
    right_quantiles: tuple[float, float, float]
    wrong_quantiles: tuple[float, float, float]
    right_passed: float
    wrong_stopped: float
    stopped_alone: int


def collect_answers(
    profiles: Sequence[SceneProfile],
    count: int,
    seed: int,
    advance: Callable[[str], None] = lambda _: None,
    width: int = 1920,
) -> list[Answer]:
    """Every answer, right or wrong, that the pipeline can give to ``count`` rendered frames of each profile."""
    found: list[Answer] = []
    for profile in profiles:
        for index in range(count):
            found += _answers_to_frame(profile, seed, index, width)
            advance(profile)
    return found


def _answers_to_frame(profile: SceneProfile, seed: int, index: int, width: int) -> list[Answer]:
    rng = np.random.default_rng([seed, index, SCENE_PROFILES.index(profile)])
    rendering = render_frame(profile, rng, width, round(width * 9 / 16))
    truth, image = rendering.truth, rendering.image
    config = profile_config(profile, truth)
    other = config.field.model_copy(update={"template": OTHER_SPORT.get(truth.field_name, "soccer")})
    found: list[Answer] = []
    for options in (config, config.model_copy(update={"field": other})):
        template, circle = field_of(options)
        height, columns = image.shape[:2]
        setting = Setting(options, template, circle, columns, height, frame_generator(seed))
        scene = prepare_scene(setting, image, None, None)
        attempts = _all_attempts(setting, scene) if options is config else [calibrate_scene(setting, scene)]
        for attempt in attempts:
            if attempt.camera is not None and attempt.verdict is not None:
                error = compare(truth, attempt.camera)[0] if options is config else float("inf")
                found.append(Answer(error, attempt.verdict.checks))
    return found


def _all_attempts(setting: Setting, scene: Scene) -> list[Attempt]:
    """The first attempt, those without what it took for the circle and its line, and those with arcs as the circle."""
    attempts = [calibrate_scene(setting, scene)]
    ruled_out: tuple[Interpretation, ...] = ()
    while len(ruled_out) < MOST_OTHERS and (mask := attempts[-1].mask) is not None and mask.conic is not None:
        ruled_out = (*ruled_out, Interpretation(mask.conic, mask.halfway))
        attempts.append(calibrate_scene(setting, scene, ruled_out))
    return [*attempts, *take_arcs(setting, scene, attempts[0])]


def summarise_gates(answers: Sequence[Answer]) -> list[GateRow]:
    """One row for each check that was made, those that alone stop the most wrong answers first."""
    rows = [_gate_row(name, answers) for name in CHECKS]
    made = [row for row in rows if row.right + row.wrong]
    return sorted(made, key=lambda row: (-row.stopped_alone, -row.right - row.wrong))


def _gate_row(name: str, answers: Sequence[Answer]) -> GateRow:
    right = [check for a in answers if a.is_right for check in a.checks if check.name == name]
    wrong = [check for a in answers if a.is_wrong for check in a.checks if check.name == name]
    alone = sum({c.name for c in a.checks if not c.passed} == {name} for a in answers if a.is_wrong)
    limits = [check.limit for check in (*right, *wrong)]
    return GateRow(
        name=name,
        limit=float(np.median(limits)) if limits else float("nan"),
        right=len(right),
        wrong=len(wrong),
        right_quantiles=_quantiles(right),
        wrong_quantiles=_quantiles(wrong),
        right_passed=_share([check.passed for check in right]),
        wrong_stopped=_share([not check.passed for check in wrong]),
        stopped_alone=alone,
    )


def _quantiles(checks: Sequence[Check]) -> tuple[float, float, float]:
    values = [check.value for check in checks if np.isfinite(check.value)]
    low, middle, high = np.percentile(values, [5, 50, 95]).tolist() if values else [float("nan")] * 3
    return low, middle, high


def _share(values: Sequence[bool]) -> float:
    return float(np.mean(values)) if values else float("nan")
