"""Networks in ONNX format: loading them, running them, and class masks in the place of the built-in detector.

No weights come with circlecal and none are fetched. Any network of the layouts described in ``configs/networks`` runs
on onnxruntime (extra ``onnx``); one session per model is kept for all frames of a run. Keypoints from heat maps are in
:mod:`circlecal.detection.keypoints`.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar

import cv2
import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field

from circlecal.errors import ConfigError, InputError, MissingExtraError
from circlecal.files import open_regular

CLASS_LIMIT = 28
"""Largest SoccerNet class id."""
MAPS_AXES = 4
"""Of pictures and maps in a network: batch, channels, height, width."""

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
class _Network:
    session: Any
    input_name: str
    input_type: type
    size: tuple[int, int] | None
    outputs: tuple[str, ...]
    path: str


def load_network(model: str | None, provider: str, key: str) -> _Network:
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
        with open_regular(path) as descriptor:
            status = os.fstat(descriptor)
    except InputError as error:
        raise ConfigError(f"{key}: no such model file: {error}") from error
    return _name_key(key, lambda: _load(str(path), status.st_mtime_ns, provider, cv2.getNumThreads()))


def _name_key(key: str, action: Callable[[], T]) -> T:
    """Name the key of the configuration in front of an error's message."""
    try:
        return action()
    except ConfigError as error:
        raise ConfigError(f"{key}: {error}") from error


@lru_cache(maxsize=4)
def _load(path: str, changed: int, provider: str, threads: int) -> _Network:
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
    if len(inputs) != 1 or len(inputs[0].shape) != MAPS_AXES:
        raise ConfigError(f"{path}: the model must have one input of 4 axes (batch, 3 channels, height, width)")
    batch, channels, height, width = inputs[0].shape
    if (isinstance(channels, int) and channels != 3) or (isinstance(batch, int) and batch != 1):
        raise ConfigError(f"{path}: the input has the axes {inputs[0].shape}; wanted are 1, 3, height, width")
    fixed = (width, height) if isinstance(width, int) and isinstance(height, int) else None
    kind = np.float16 if "float16" in inputs[0].type else np.float32
    return _Network(session, inputs[0].name, kind, fixed, tuple(o.name for o in session.get_outputs()), path)


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
    output = run_network(image, model, network, key)
    height, width = image.shape[:2]
    if output.ndim == MAPS_AXES and output.shape[1] > 1:
        return _choose_class(output[0], network.classes, (width, height), f"{key}: {model}")
    labels = output.reshape(output.shape[-2:]).round()
    table = _tabulate_classes(int(labels.max(initial=0)) + 1, network.classes, f"{key}: {model}")
    return cv2.resize(table[labels.astype(np.intp)], (width, height), interpolation=cv2.INTER_NEAREST)  # type: ignore[return-value]


def _choose_class(scores: Scores, classes: dict[int, int], size: tuple[int, int], source: str) -> NDArray[np.uint8]:
    table = _tabulate_classes(len(scores), classes, source)
    present = np.unique(scores.argmax(axis=0))
    best = cv2.resize(np.ascontiguousarray(scores[present[0]], dtype=np.float32), size)
    found = np.full(best.shape, table[present[0]], dtype=np.uint8)
    for channel in present[1:]:
        score = cv2.resize(np.ascontiguousarray(scores[channel], dtype=np.float32), size)
        better = score > best
        found[better] = table[channel]
        np.maximum(best, score, out=best)
    return found


def _tabulate_classes(count: int, classes: dict[int, int], source: str) -> NDArray[np.uint8]:
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


def run_network(image: NDArray[np.uint8], model: str | None, network: NetworkInput, key: str) -> Scores:
    """The chosen output of a network for a picture: (1, C, h, w) or (1, h, w).

    Parameters
    ----------
    image : (H, W, 3) uint8
        BGR picture.
    model, network, key : str, NetworkInput, str
        Model file, its layout, and the key of the configuration that names the file.

    Raises
    ------
    ConfigError
        As :func:`load_network`, or the network fails on the picture.
    """
    loaded = load_network(model, network.provider, key)
    return _name_key(key, lambda: _run(loaded, image, network))


def _run(loaded: _Network, image: NDArray[np.uint8], network: NetworkInput) -> Scores:
    size = network.size or loaded.size
    if size is None:
        raise ConfigError(f"{loaded.path}: takes pictures of any size; name the one it was trained with: size: [W, H]")
    if loaded.size is not None and size != loaded.size:
        raise ConfigError(f"{loaded.path}: takes {loaded.size[0]}x{loaded.size[1]} pictures, "
                          f"but size is {size[0]}x{size[1]}")  # fmt: skip
    if network.output is not None and network.output not in loaded.outputs:
        known = ", ".join(loaded.outputs)
        raise ConfigError(f"{loaded.path}: has no output {network.output!r}; it has {known}")
    prepared = _prepare_input(image, size, network, loaded.input_type)
    names = None if network.output is None else [network.output]
    try:
        outputs = loaded.session.run(names, {loaded.input_name: prepared})
    except Exception as error:  # onnxruntime's errors have no common base
        raise ConfigError(f"{loaded.path}: fails on a picture of {size[0]}x{size[1]}: {_first_line(error)}") from error
    maps = next((o for o in outputs if o.ndim in (MAPS_AXES - 1, MAPS_AXES) and len(o) == 1), None)
    if maps is None or min(maps.shape[-2:]) < 2:
        raise ConfigError(f"{loaded.path}: has no output with height and width")
    if not np.isfinite(maps).all():
        raise ConfigError(f"{loaded.path}: its output holds NaN or infinity")
    return np.asarray(maps)


def _prepare_input(image: NDArray[np.uint8], size: tuple[int, int], network: NetworkInput, kind: type) -> NDArray[Any]:
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
