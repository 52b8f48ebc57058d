"""Calibrate a sports camera from circular field markings.

>>> import circlecal
>>> frame = circlecal.calibrate("frame.jpg")  # doctest: +SKIP

Whether, and where the camera stands:

>>> frame.ok, frame.reason, frame.help, frame.checks  # doctest: +SKIP
>>> frame.K, frame.R, frame.t, frame.dist, frame.position_m  # as OpenCV takes them  # doctest: +SKIP

Between pixels and metres, with standard deviations or covariances:

>>> frame.to_field([[640, 360]], sigma=True), frame.field_covariance([[640, 360]])  # doctest: +SKIP
>>> frame.to_image([[0, 0], [52.5, 0]]), frame.image_covariance([[0, 0]])  # doctest: +SKIP

What it was made of: the circle's conic in the picture, the paper's eight points and tangents, the case that gave them;
``set={"correspondences.case": 3}`` asks for one of the three:

>>> frame.attempt.ellipses.primary.conic  # doctest: +SKIP
>>> frame.attempt.correspondences.points, frame.attempt.correspondences.tangents  # doctest: +SKIP
>>> frame.attempt.correspondences.case, frame.attempt.correspondences.imaged_center  # doctest: +SKIP

To files, and to other programs:

>>> frame.save("frame.json"), frame.export("soccernet", "cameras")  # doctest: +SKIP
>>> circlecal.load("frame.json") == frame  # doctest: +SKIP

Pixels count from the centre of the top-left one. Field points are metres from the centre mark: x to the right along the
length, y towards the main camera, z down. :func:`calibrate_points` needs clicked points and no picture,
:func:`calibrate_video` and :func:`track` go through videos, :func:`calibrate_batch` calibrates many frames into a
folder, :func:`calibrate_rig` again with what those of each camera share, :func:`load` opens results,
:func:`load_cameras` what is known of the cameras, :func:`export` writes several frames for another program.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

__version__ = "0.1.0"

__all__ = [
    "Calibration",
    "CirclecalError",
    "Config",
    "ConfigError",
    "InputError",
    "MissingExtraError",
    "Run",
    "SurePoints",
    "ViewTransformer",
    "__version__",
    "calibrate",
    "calibrate_batch",
    "calibrate_points",
    "calibrate_rig",
    "calibrate_video",
    "export",
    "load",
    "load_cameras",
    "load_config",
    "track",
]

if TYPE_CHECKING:
    from circlecal.api import (
        Calibration,
        Run,
        SurePoints,
        ViewTransformer,
        calibrate,
        calibrate_points,
        calibrate_video,
        export,
        load,
    )
    from circlecal.batch.calls import calibrate_batch
    from circlecal.config import Config, load_config
    from circlecal.errors import CirclecalError, ConfigError, InputError, MissingExtraError
    from circlecal.rig.calls import calibrate_rig, load_cameras
    from circlecal.tracking.calls import track

ONE_THREAD = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")
"""Environment variables that libraries of linear algebra read when they are loaded. The systems here are small, and
threads that wait for each other only cost time.
"""
_HOMES = {
    **dict.fromkeys(("CirclecalError", "ConfigError", "InputError", "MissingExtraError"), "circlecal.errors"),
    **dict.fromkeys(("Config", "load_config"), "circlecal.config"),
    **dict.fromkeys(("Calibration", "Run", "SurePoints", "ViewTransformer", "load"), "circlecal.api"),
    **dict.fromkeys(("calibrate", "calibrate_points", "calibrate_video", "export"), "circlecal.api"),
    "calibrate_batch": "circlecal.batch.calls",
    **dict.fromkeys(("calibrate_rig", "load_cameras"), "circlecal.rig.calls"),
    "track": "circlecal.tracking.calls",
}


if not TYPE_CHECKING:  # type checkers find a misspelt name

    def __getattr__(name: str) -> Any:
        """Import the public names when they are first used, so that ``import circlecal`` costs nothing."""
        if name not in _HOMES:
            raise AttributeError(f"module 'circlecal' has no attribute {name!r}")
        from importlib import import_module

        return getattr(import_module(_HOMES[name]), name)


def __dir__() -> list[str]:
    """The public names and those of the module itself (``__file__``, ...): what a shell offers to complete."""
    return sorted({*__all__, *(name for name in globals() if name.startswith("__"))})
