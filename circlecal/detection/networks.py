"""Networks in ONNX format in the place of the built-in detector: class masks and heat maps of keypoints.

No weights come with circlecal and none are fetched. Any network of the layouts described in ``configs/networks`` runs
on onnxruntime (extra ``onnx``); one session per model is kept for all frames of a run.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar

import cv2
import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field

from circlecal.errors import ConfigError, MissingExtraError
from circlecal.geometry.projective import Array

CLASS_LIMIT = 28
"""Largest SoccerNet class id."""
_RANK = 4

Scores = NDArray[np.float32]
Three = tuple[float, float, float]
Positive = Annotated[float, Field(gt=0)]
Side = Annotated[int, Field(ge=16, le=16384)]
T = TypeVar("T")


class NetworkInput(BaseModel):
    """How a picture is brought into the form that a network was trained with."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    size: tuple[Side, Side] | None = Field(
        None, description="Width and height of the network's input; null takes what the model file says."
    )
    channels: Literal["rgb", "bgr"] = Field("rgb", description="Order of the colour channels.")
    mean: Three = Field((0.0, 0.0, 0.0), description="Subtracted from each channel (0 to 1), in the order of channels.")
    std: tuple[Positive, Positive, Positive] = Field((1.0, 1.0, 1.0), description="Divides each channel afterwards.")
    interpolation: Literal["linear", "area"] = Field(
        "area", description="How the picture is made smaller: linear aliases, as some networks were trained."
    )
    output: str | None = Field(None, description="Name of the model's output; null: the first with height and width.")
    provider: Literal["auto", "cpu", "cuda", "tensorrt", "openvino", "coreml", "directml"] = Field(
        "auto", description="Where it runs; auto takes CUDA where the installed onnxruntime has it, else the CPU."
    )


class SegmentationNetwork(NetworkInput):
    """Semantic segmentation: one score per class and pixel, or class numbers."""

    classes: dict[int, int] = Field(
        {}, description="SoccerNet class id by channel of the network; empty: the channel is the id, 0 the background."
    )


@dataclass(frozen=True, slots=True)
class Peaks:
    """Highest places of heat maps.

    Attributes
    ----------
    points_px : (C, K, 2) array
        Per channel and rank, in pixels of the picture (``x W``: column 0 of the map is x = 0).
    confidence : (C, K) array
        Height of each.
    """

    points_px: Array
    confidence: Array


@dataclass(frozen=True, slots=True)
class _Loaded:
    session: Any
    input_name: str
    input_type: type
    size: tuple[int, int] | None
    outputs: tuple[str, ...]
    path: str


def load_network(model: str | None, provider: str, key: str) -> _Loaded:
    """The network of a model file, ready to run; kept for the next call.

    Parameters
    ----------
    model : str or None
        The model file.
    provider : str
        As in :class:`NetworkInput`.
    key : str
        The key of the configuration that names the file, for messages.

    Raises
    ------
    ConfigError
        No file, no such provider, or no ONNX model with a picture as its one input.
    MissingExtraError
        No onnxruntime.
    """
    if model is None:
        raise ConfigError(f"{key}: a network is wanted, and no model file is named; set {key} to an .onnx file")
    path = Path(model)
    try:
        status = path.stat()
    except OSError as error:
        raise ConfigError(f"{key}: {model}: no such model file") from error
    return _named(key, lambda: _load(str(path), status.st_mtime_ns, provider, cv2.getNumThreads()))


def _named(key: str, action: Callable[[], T]) -> T:
    """Name the key of the configuration in front of an error's message."""
    try:
        return action()
    except ConfigError as error:
        raise ConfigError(f"{key}: {error}") from error


@lru_cache(maxsize=4)
def _load(path: str, changed: int, provider: str, threads: int) -> _Loaded:
    try:
        import onnxruntime
    except ImportError as error:
        raise MissingExtraError("onnxruntime", "onnx") from error
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = threads
    options.log_severity_level = 3
    try:
        session = onnxruntime.InferenceSession(path, options, providers=_providers(provider, onnxruntime))
    except ConfigError:
        raise
    except Exception as error:  # onnxruntime's errors have no common base
        raise ConfigError(f"{path}: is no usable ONNX model: {_first_line(error)}") from error
    inputs = session.get_inputs()
    if len(inputs) != 1 or len(inputs[0].shape) != _RANK:
        raise ConfigError(f"{path}: the model must have one input of 4 axes (batch, 3 channels, height, width)")
    batch, channels, height, width = inputs[0].shape
    if (isinstance(channels, int) and channels != 3) or (isinstance(batch, int) and batch != 1):
        raise ConfigError(f"{path}: the input has the axes {inputs[0].shape}; wanted are 1, 3, height, width")
    fixed = (width, height) if isinstance(width, int) and isinstance(height, int) else None
    kind = np.float16 if "float16" in inputs[0].type else np.float32
    return _Loaded(session, inputs[0].name, kind, fixed, tuple(o.name for o in session.get_outputs()), path)


_PROVIDERS = {
    "cpu": "CPUExecutionProvider",
    "cuda": "CUDAExecutionProvider",
    "tensorrt": "TensorrtExecutionProvider",
    "openvino": "OpenVINOExecutionProvider",
    "coreml": "CoreMLExecutionProvider",
    "directml": "DmlExecutionProvider",
}


def _providers(wanted: str, onnxruntime: Any) -> list[str]:
    available = onnxruntime.get_available_providers()
    if wanted == "auto":
        return [p for p in (_PROVIDERS["cuda"], _PROVIDERS["cpu"]) if p in available]
    if _PROVIDERS[wanted] not in available:
        known = ", ".join(name for name, provider in _PROVIDERS.items() if provider in available)
        raise ConfigError(f"provider {wanted}: the installed onnxruntime does not have it; it has {known}")
    return [_PROVIDERS[wanted], *([] if wanted == "cpu" else [_PROVIDERS["cpu"]])]


def segment(image: NDArray[np.uint8], model: str | None, network: SegmentationNetwork, key: str) -> NDArray[np.uint8]:
    """Class ids (H, W) of a picture.

    Scores are enlarged to the picture's size before the best class is taken, so that the masks of small networks have
    smooth borders.

    Parameters
    ----------
    image : (H, W, 3) uint8
        BGR picture.
    model, network, key : str, SegmentationNetwork, str
        Model file, its layout, and the key of the configuration that names the file.

    Raises
    ------
    ConfigError
        As :func:`load_network`, or the output is no map of classes.
    """
    loaded = load_network(model, network.provider, key)
    output = _named(key, lambda: _run(loaded, image, network))
    height, width = image.shape[:2]
    if output.ndim == _RANK and output.shape[1] > 1:
        return _best_class(output[0], network.classes, (width, height), f"{key}: {loaded.path}")
    labels = output.reshape(output.shape[-2:]).round()
    table = _class_table(int(labels.max(initial=0)) + 1, network.classes, f"{key}: {loaded.path}")
    return cv2.resize(table[labels.astype(np.intp)], (width, height), interpolation=cv2.INTER_NEAREST)  # type: ignore[return-value]


def _best_class(scores: Scores, classes: dict[int, int], size: tuple[int, int], source: str) -> NDArray[np.uint8]:
    table = _class_table(len(scores), classes, source)
    present = np.unique(scores.argmax(axis=0))
    best = cv2.resize(np.ascontiguousarray(scores[present[0]], dtype=np.float32), size)
    found = np.full(best.shape, table[present[0]], dtype=np.uint8)
    for channel in present[1:]:
        score = cv2.resize(np.ascontiguousarray(scores[channel], dtype=np.float32), size)
        better = score > best
        found[better] = table[channel]
        np.maximum(best, score, out=best)
    return found


def _class_table(count: int, classes: dict[int, int], source: str) -> NDArray[np.uint8]:
    """Class id by channel."""
    wrong = sorted(i for i in classes.values() if not 0 <= i <= CLASS_LIMIT)
    if wrong:
        raise ConfigError(f"{source}: classes: {wrong[0]} is no SoccerNet class id (0 to {CLASS_LIMIT})")
    if not classes and count > CLASS_LIMIT + 1:
        raise ConfigError(
            f"{source}: has {count} classes, not SoccerNet's {CLASS_LIMIT + 1}; give `classes` (id by channel)"
        )
    table = np.zeros(count, dtype=np.uint8)
    if not classes:
        return np.arange(count, dtype=np.uint8)
    for channel, label in classes.items():
        if 0 <= channel < count:
            table[channel] = label
    return table


def heat_map_peaks(
    image: NDArray[np.uint8], model: str | None, network: NetworkInput, key: str, *, channels: int, count: int
) -> Peaks:
    """The highest places of each heat map but the last, which is the background.

    Parameters
    ----------
    image : (H, W, 3) uint8
        BGR picture.
    model, network, key : str, NetworkInput, str
        As for :func:`segment`.
    channels : int
        Number of heat maps without the background.
    count : int
        Places per map.

    Raises
    ------
    ConfigError
        As :func:`load_network`, or the output is not ``channels`` + 1 maps.
    """
    loaded = load_network(model, network.provider, key)
    output = _named(key, lambda: _run(loaded, image, network))
    if output.ndim != _RANK or output.shape[1] != channels + 1:
        raise ConfigError(f"{key}: {loaded.path}: its output has the axes {list(output.shape)}; "
                          f"wanted are 1, {channels + 1}, height, width")  # fmt: skip
    maps = output[0, :-1].astype(np.float64)
    cells, confidence = _peaks(maps, count)
    scale = np.array([image.shape[1] / maps.shape[2], image.shape[0] / maps.shape[1]])
    return Peaks(cells * scale, confidence)


PEAK_DISTANCE = 10
"""Cells around a peak in which no second one is looked for."""


def _peaks(maps: Array, count: int) -> tuple[Array, Array]:
    """Places (C, K, 2) in cells and heights (C, K), highest first, refined to parts of a cell."""
    channels, height, width = maps.shape
    rows, columns = np.arange(height), np.arange(width)
    left = maps.copy()
    places, heights = np.empty((channels, count, 2)), np.empty((channels, count))
    for rank in range(count):
        flat = left.reshape(channels, -1).argmax(axis=1)
        y, x = np.divmod(flat, width)
        heights[:, rank] = np.maximum(left[np.arange(channels), y, x], 0.0)
        places[:, rank] = _refined(maps, x, y)
        near = (np.abs(rows - y[:, None]) <= PEAK_DISTANCE)[:, :, None]
        left[near & (np.abs(columns - x[:, None]) <= PEAK_DISTANCE)[:, None, :]] = -np.inf
    return places, heights


def _refined(maps: Array, x: NDArray[np.intp], y: NDArray[np.intp]) -> Array:
    """Tops (C, 2) of the Gaussians through a peak and its neighbours along each axis."""
    channel = np.arange(len(maps))
    logs = np.pad(np.log(np.maximum(maps, 1e-9)), ((0, 0), (1, 1), (1, 1)))
    places = []
    for step, position, size in (((0, 1), x, maps.shape[2]), ((1, 0), y, maps.shape[1])):
        inside = (position > 0) & (position < size - 1)
        before, top, after = (logs[channel, y + k * step[0] + 1, x + k * step[1] + 1] for k in (-1, 0, 1))
        curvature = before - 2 * top + after
        usable = inside & (curvature < -1e-9)
        offset = np.where(usable, 0.5 * (before - after) / np.where(usable, curvature, 1.0), 0.0)
        places.append(position + np.clip(offset, -0.5, 0.5))
    return np.stack(places, axis=-1)


def _run(loaded: _Loaded, image: NDArray[np.uint8], network: NetworkInput) -> Scores:
    """The chosen output of a network for a picture."""
    size = network.size or loaded.size
    if size is None:
        raise ConfigError(f"{loaded.path}: takes pictures of any size; name the one it was trained with: size: [W, H]")
    if loaded.size is not None and size != loaded.size:
        raise ConfigError(f"{loaded.path}: takes {loaded.size[0]}x{loaded.size[1]} pictures, "
                          f"but size is {size[0]}x{size[1]}")  # fmt: skip
    if network.output is not None and network.output not in loaded.outputs:
        known = ", ".join(loaded.outputs)
        raise ConfigError(f"{loaded.path}: has no output {network.output!r}; it has {known}")
    blob = _blob(image, size, network, loaded.input_type)
    names = None if network.output is None else [network.output]
    try:
        outputs = loaded.session.run(names, {loaded.input_name: blob})
    except Exception as error:  # onnxruntime's errors have no common base
        raise ConfigError(f"{loaded.path}: fails on a picture of {size[0]}x{size[1]}: {_first_line(error)}") from error
    maps = next((o for o in outputs if o.ndim in (_RANK - 1, _RANK) and len(o) == 1), None)
    if maps is None or min(maps.shape[-2:]) < 2:
        raise ConfigError(f"{loaded.path}: has no output with height and width")
    if not np.isfinite(maps).all():
        raise ConfigError(f"{loaded.path}: its output holds NaN or infinity")
    return np.asarray(maps)


def _blob(image: NDArray[np.uint8], size: tuple[int, int], network: NetworkInput, kind: type) -> NDArray[Any]:
    """A picture as (1, 3, height, width)."""
    shrinks = size[0] < image.shape[1]
    method = cv2.INTER_AREA if network.interpolation == "area" and shrinks else cv2.INTER_LINEAR
    resized = cv2.resize(image, size, interpolation=method)
    if network.channels == "rgb":
        resized = cv2.cvtColor(resized, cv2.COLOR_BGR2RGB)
    mean, std = np.array(network.mean, dtype=np.float32), np.array(network.std, dtype=np.float32)
    scaled = (resized.astype(np.float32) / np.float32(255.0) - mean) / std
    return np.ascontiguousarray(scaled.transpose(2, 0, 1)[None], dtype=kind)


def _first_line(error: Exception) -> str:
    return (str(error).strip().splitlines() or [type(error).__name__])[0]
