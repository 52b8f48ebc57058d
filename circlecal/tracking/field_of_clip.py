"""Which field clips show, where ``auto`` was said for it: some of their frames, each looked at alone, agree on one."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from circlecal.config import AUTO, Config, find_template, suit_config
from circlecal.errors import ConfigError
from circlecal.pictures.interlacing import join_fields
from circlecal.pictures.video import Sampling, Video, pictures_at
from circlecal.pipeline import calibrate_image

MOST_LOOKED_AT = 12
"""Frames of each clip, evenly spread, that are asked for their field: one takes some seconds where it is no pitch, and
a clip that shows its circle in less than a twelfth of its time is better named.
"""
UNKNOWN_LENGTH_S = 60.0
"""So much is looked at of a clip whose header tells no length, seconds."""


def name_field(videos: Sequence[Video], sampling: Sampling, config: Config) -> Config:
    """The configuration with the field that the clips show, in place of ``auto``.

    Parameters
    ----------
    videos : sequence of Video
        Clips of one field; the later ones are looked at where the first ones do not tell.
    sampling : Sampling
        From where to where they are tracked.
    config : Config
        Options; those that the field's template asks for go under what was set.

    Raises
    ------
    ConfigError
        Fewer frames than ``learning.least_frames`` agree on one field.
    InputError
        A clip cannot be read.
    """
    if config.field.template != AUTO:
        return config
    told: Counter[str] = Counter()
    for picture in _pictures_of(videos, sampling):
        found = calibrate_image(join_fields(picture) if config.mask.deinterlace else picture, config, frame_id="auto")
        if found.status == "calibrated":
            told[found.field_name] += 1
        if told and told.most_common(1)[0][1] >= config.learning.least_frames:
            return suit_config(config, told.most_common(1)[0][0])
    named = find_template(config, next(iter(told), "basketball"))
    seen = ", ".join(f"{name} in {count}" for name, count in told.most_common()) or "none in any"
    raise ConfigError(
        f"--field auto: fewer than {config.learning.least_frames} of the frames that were looked at agree on a field "
        f"({seen}); name it, e.g. --field {named}"
    )


def _pictures_of(videos: Sequence[Video], sampling: Sampling) -> Iterator[NDArray[np.uint8]]:
    """Pictures of each clip, evenly spread over the part that is wanted."""
    for video in videos:
        length = video.duration_s or sampling.start_s + UNKNOWN_LENGTH_S
        end = length if sampling.end_s is None else min(sampling.end_s, length)
        share = (np.arange(MOST_LOOKED_AT) + 0.5) / MOST_LOOKED_AT
        times = sampling.start_s + share * max(end - sampling.start_s, 0.0)
        yield from (picture for picture in pictures_at(video.path, times.tolist(), exact=False) if picture is not None)
