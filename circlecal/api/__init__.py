"""Calibrating pictures and points from Python."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from circlecal.config import Config
from circlecal.formats.inputs import observe_network
from circlecal.pictures.files import as_bgr, read_image
from circlecal.pictures.masks import as_class_ids, read_mask
from circlecal.pipeline import field_of, run
from circlecal.results import Calibration


def calibrate(
    image: NDArray[Any] | str | Path,
    mask: NDArray[Any] | str | Path | None = None,
    config: Config | None = None,
    *,
    frame_id: str | None = None,
) -> Calibration:
    """Calibrate the camera of one frame.

    Parameters
    ----------
    image : array or path
        Picture file, or array (H, W), (H, W, 3) BGR or (H, W, 4) BGRA of 8 or 16 bit.
    mask : array or path, optional
        Where the markings are: binary, SoccerNet class ids or SoccerNet palette, any size. Without one the built-in
        detector looks for them (a mask file beside the picture is not looked for).
    config : Config, optional
        The defaults when None.
    frame_id : str, optional
        Name of the frame; with the seed it fixes the random draws. The file's stem, or ``"image"``.

    Returns
    -------
    Calibration
        The verdict and every intermediate. A frame that cannot be calibrated is refused, not an exception.

    Raises
    ------
    InputError
        The picture or the mask is unusable.
    ConfigError
        The configuration's field template or a network is unusable.
    """
    config = Config() if config is None else config
    source = None if isinstance(image, np.ndarray) else str(image)
    picture = as_bgr(image, "image") if isinstance(image, np.ndarray) else read_image(image)
    height, width = picture.shape[:2]
    if mask is None:
        classes = None
    elif isinstance(mask, np.ndarray):
        classes = as_class_ids(mask, width, height, "mask")
    else:
        classes = read_mask(Path(mask), width, height)
    name = frame_id or ("image" if source is None else Path(source).stem)
    extra = observe_network(picture, config.keypoints, field_of(config)[0], config.sources)
    return run(picture, config, mask=classes, extra=extra, frame_id=name, source=source)
