"""Which of the names that a person gave is wrong, where a frame is refused with all of them.

The camera of a refused frame may follow the wrong name, so that everything contradicts it. Each name is left out in
turn; the one without which the frame is calibrated, with nothing that contradicts, is wrong, and that camera says what
it should be.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace

from circlecal.config import Config
from circlecal.formats.annotation import Annotation
from circlecal.workbench.answers import Answer, WrongName, answer, find_contradicting, judge_name, see_markings

MOST_TRIED = 12
"""So many names are left out in turn, with a second each."""


def find_wrong_name(
    annotation: Annotation, begun: Annotation, config: Config, *, is_wanted: Callable[[], bool] = lambda: True
) -> WrongName | None:
    """The name that must be another one for a refused frame to be calibrated; None where no single one is.

    Parameters
    ----------
    annotation : Annotation
        Of a frame that is refused.
    begun : Annotation
        As it was measured; only names that a person gave are doubted.
    config : Config
        Options of every stage.
    is_wanted : callable
        Asked after each name; where the answer is no, nothing is found.
    """
    for index in list(_find_given(annotation, begun))[-1 : -MOST_TRIED - 1 : -1]:  # the last one first
        without = answer(_leave_out(annotation, index), config, nameless=False)
        if not is_wanted():
            return None
        if without.is_calibrated and not find_contradicting(without):
            return _judge(index, annotation, without)
    return None


def _find_given(annotation: Annotation, begun: Annotation) -> Iterator[int]:
    """Which markings have a name that was not measured, in their order."""
    measured = {(marking.name, tuple(marking.points_px[0])) for marking in begun.markings}
    for index, marking in enumerate(annotation.markings):
        if marking.used and marking.name is not None and (marking.name, tuple(marking.points_px[0])) not in measured:
            yield index


def _leave_out(annotation: Annotation, index: int) -> Annotation:
    """The annotation with one marking not used."""
    markings = list(annotation.markings)
    markings[index] = markings[index].model_copy(update={"used": False})
    return annotation.model_copy(update={"markings": markings})


def _judge(index: int, annotation: Annotation, without: Answer) -> WrongName:
    """What the camera that was found without a marking says of its name."""
    told = replace(without, annotation=annotation)
    drawn = see_markings(told.found.view, told.template)
    return judge_name(told, drawn, index)
