"""The last word on a camera: it weighs what was seen by painters' errors, and what these leave open comes on top.

Which marking is which, and whether a frame is believed, is decided before, by what was seen.
"""

from __future__ import annotations

from dataclasses import replace

from circlecal.camera.report import weigh_painters
from circlecal.pipeline.setting import Setting
from circlecal.results import Attempt
from circlecal.stages.verdict import renew_sigmas


def cover_painters(setting: Setting, attempt: Attempt) -> Attempt:
    """The attempt with the camera that weighs painters' errors, refused where that is too uncertain."""
    camera, template = attempt.camera, setting.template
    if camera is None or camera.painters is None:
        return attempt
    circle = template.circle_by_name.get(attempt.circle_name or setting.circle.name, setting.circle)
    weighed = weigh_painters(camera, circle, template)
    verdict = None if attempt.verdict is None else renew_sigmas(attempt.verdict, weighed)
    return replace(attempt, camera=weighed, verdict=verdict)
