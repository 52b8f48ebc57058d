"""Where the time of tracking goes."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Literal, get_args

Stage = Literal["picture", "motion", "paint", "search", "backward", "smoothing"]
STAGES: tuple[Stage, ...] = get_args(Stage)
"""Preparing a picture; following its corners; looking at the paint and fitting the head; searching for a camera; going
back from where it was found; smoothing a shot and judging its frames.
"""


@dataclass(frozen=True, slots=True)
class StageClock:
    """Adds up the seconds that each stage takes."""

    spent_s: dict[Stage, float] = field(default_factory=lambda: dict.fromkeys(STAGES, 0.0))

    @contextmanager
    def measure(self, stage: Stage) -> Iterator[None]:
        """Count the time of the block to a stage."""
        start = time.perf_counter()
        try:
            yield
        finally:
            self.spent_s[stage] += time.perf_counter() - start
