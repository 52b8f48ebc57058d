"""How far the survey of a clip is, for whoever waits for it."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from typing import TypeVar

from circlecal.tracking.first_look import PicturesAt

OnStep = Callable[[str, int, int], None]
"""Told what is done, how many pictures are done with, and how many there are; 0 where they are not counted."""
T = TypeVar("T")


@dataclass(frozen=True, slots=True)
class SurveySteps:
    """Tells the steps of a survey; nobody, as it stands."""

    on_step: OnStep = lambda stage, done, total: None

    def count(self, stage: str, items: Iterable[T], total: int) -> Iterator[T]:
        """The items, of which there are so many, each told when the next one is asked for."""
        self.on_step(stage, 0, total)
        for done, item in enumerate(items, start=1):
            yield item
            self.on_step(stage, done, total)

    def decode(self, stage: str, pictures_at: PicturesAt) -> PicturesAt:
        """Decodes pictures, each told when the next one is asked for."""

        return lambda times: self.count(stage, pictures_at(times), len(times))

    def begin(self, stage: str) -> None:
        """Say what is done with all pictures at once."""
        self.on_step(stage, 0, 0)


UNTOLD = SurveySteps()
"""Of a survey that nobody waits for."""
