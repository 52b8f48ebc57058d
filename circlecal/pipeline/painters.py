"""The last word on a camera: what painters' errors leave open comes on top of what the picture does.

Which marking is which, and whether a frame is believed, is decided before, by what was seen.
"""

from __future__ import annotations

from dataclasses import replace

from circlecal.camera.report import widen_camera
from circlecal.pipeline.setting import Setting
from circlecal.results import Attempt
from circlecal.stages.verdict import renew_sigmas


def cover_painters(setting: Setting, attempt: Attempt) -> Attempt:
    """The attempt with painters' errors in its uncertainty, refused where that then is too large."""
    camera, template = attempt.camera, setting.template
    if camera is None or camera.painters_covariance is None:
        return attempt
    circle = template.circle_by_name.get(attempt.circle_name or setting.circle.name, setting.circle)
    wider = widen_camera(camera, circle, template)
    verdict = None if attempt.verdict is None else renew_sigmas(attempt.verdict, wider)
    return replace(attempt, camera=wider, verdict=verdict)
