"""The row of ``circlecal bench annotations`` in which other frames of a match tell position and lens of a frame's
camera.

The frames of a match lie one after the other in a set. Where a match ends is read off the positions in the peers'
cameras: within a match, height over distance and distance stay what they are. Of every frame the rig is estimated from
all lines of the other frames of its match; the frame itself brings circle and halfway line only.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np

from circlecal.config import Config
from circlecal.evaluation.reading import Prediction
from circlecal.evaluation.soccernet_metric import MetricCamera
from circlecal.field import Circle, FieldTemplate
from circlecal.formats.cameras import CalibratedFrame
from circlecal.geometry.projective import Array
from circlecal.observations import Observations
from circlecal.pipeline import apply_convention, run_observations
from circlecal.rig.estimation import config_with_prior, estimate_rigs
from circlecal.rig.frames import frame_of_calibration

INPUT = "circle and halfway line; camera of the match from its other frames"
LEAST_FRAMES, _MOST_FRAMES = 4, 60
"""Shorter runs of frames are no match; longer ones are not looked for, which keeps the search short."""
_RATIO, _LOG_DISTANCE, _WORST = 0.005, 0.03, 3.0
"""Scatter of height over distance and of the logarithm of the distance within a match, and the most that one frame
counts.
"""
_NEW_MATCH = 4.0
"""What a further match must explain."""
_LEAST_SHARE = 0.8
"""Of a set's frames in matches, four in five; a set of single frames has no match, but runs that look alike by chance.
"""
_TOO_DIFFERENT = 1.3
"""Mean deviation within a run from which on it is none."""


def matches(positions: Mapping[str, Array]) -> list[list[str]]:
    """Runs of frames with the same camera: the cheapest segmentation, by dynamic programming.

    Parameters
    ----------
    positions : mapping
        Positions (K, 3) of each frame's camera by the peers, in the order of the frames; K may differ and be 0.

    Returns
    -------
    list of list of str
        Frames of each match; runs shorter than ``LEAST_FRAMES`` are left out. Empty where less than four frames in
        five are in a match.
    """
    # a camera of a match stands on the side of the main camera
    positions = {name: seen[(seen[:, 1] > 1.0) & (seen[:, 2] < 0.0)] for name, seen in positions.items()}
    names = [name for name, seen in positions.items() if len(seen)]
    features = [
        np.column_stack([-seen[:, 2] / seen[:, 1] / _RATIO, np.log(seen[:, 1]) / _LOG_DISTANCE])
        for seen in (positions[name] for name in names)
    ]
    count = len(names)
    best, cut = np.full(count + 1, np.inf), np.zeros(count + 1, dtype=int)
    best[0] = 0.0
    for end in range(1, count + 1):
        for start in range(max(0, end - _MOST_FRAMES), end):
            own = np.concatenate(features[start:end])
            cost = np.minimum(np.abs(own - np.median(own, axis=0)), _WORST).sum() / (2 * len(own)) * (end - start)
            if best[start] + cost + _NEW_MATCH < best[end]:
                best[end], cut[end] = best[start] + cost + _NEW_MATCH, start
    found, end = list[list[str]](), count
    while end > 0:
        start = int(cut[end])
        own = np.concatenate(features[start:end])
        deviation = np.minimum(np.abs(own - np.median(own, axis=0)), _WORST).mean()
        if end - start >= LEAST_FRAMES and deviation < _TOO_DIFFERENT:
            found.insert(0, names[start:end])
        end = start
    return found if sum(map(len, found)) >= _LEAST_SHARE * len(positions) else []


def calibrate_with_other_frames(
    targets: Mapping[str, Observations],
    everything: Mapping[str, Observations],
    runs: Sequence[Sequence[str]],
    template: FieldTemplate,
    circle: Circle,
    config: Config,
    advance: Callable[[str], None] = lambda _: None,
) -> dict[str, Prediction]:
    """Cameras of frames of which only circle and halfway line are seen, with what their match's other frames tell.

    Parameters
    ----------
    targets : mapping
        Circle and halfway line by frame.
    everything : mapping
        All annotated lines, also of frames that are no targets.
    runs : sequence
        Frames of each match.
    template, circle, config : FieldTemplate, Circle, Config
        Field and options.
    advance : callable, optional
        Called with a frame's name when it is done.
    """
    alone = {}
    for frame in {frame for run in runs if set(run) & set(targets) for frame in run}:
        if frame in everything:
            alone[frame] = frame_of_calibration(run_observations(everything[frame], config, frame_id=frame))
            advance(frame)
    official = apply_convention(template, "official")
    run_of = {frame: run for run in runs for frame in run}
    found = {}
    for frame, seen in targets.items():
        others = [alone[name] for name in run_of.get(frame, ()) if name != frame and name in alone]
        rigs = estimate_rigs(others, official, circle, config, {other.id: "match" for other in others})
        told = config_with_prior(config, rigs[0].prior(), seen.width) if rigs else config
        answer = CalibratedFrame.of(run_observations(seen, told, frame_id=frame), template, circle)
        if answer is not None and answer.flat is not None:
            found[frame] = Prediction(MetricCamera.from_camera(answer.flat))
    return found
