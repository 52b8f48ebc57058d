"""Networks in the place of the detector: tiny ONNX models that put known classes and peaks at known places."""

from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from circlecal.api import calibrate
from circlecal.batch.frames import require_networks
from circlecal.config import config_digest, load_config
from circlecal.detection.keypoints import KeypointsConfig, find_peaks
from circlecal.detection.networks import NetworkInput, SegmentationNetwork, segment
from circlecal.errors import ConfigError, MissingExtraError
from circlecal.field import load_field
from circlecal.formats.inputs import observe_network
from circlecal.formats.meaning import SourcesConfig
from circlecal.formats.pnlcalib import WRONG_RIGHT_END, keypoint_table, tangency_points
from circlecal.geometry.camera import Camera
from circlecal.observations import MarkingKey

onnx = pytest.importorskip("onnx")
pytest.importorskip("onnxruntime")

SIZE = (96, 54)
KEY = "mask.model"


def _write(path: Path, nodes: list[Any], output: str, initializers: list[Any], size: tuple[Any, Any] = SIZE) -> str:
    wanted = onnx.helper.make_tensor_value_info("picture", onnx.TensorProto.FLOAT, [1, 3, size[1], size[0]])
    given = onnx.helper.make_tensor_value_info(output, onnx.TensorProto.FLOAT, None)
    graph = onnx.helper.make_graph(nodes, "tiny", [wanted], [given], initializers)
    model = onnx.helper.make_model(graph, opset_imports=[onnx.helper.make_opsetid("", 17)], ir_version=9)
    path.write_bytes(model.SerializeToString())
    return str(path)


def _tensor(name: str, value: np.ndarray) -> Any:
    return onnx.numpy_helper.from_array(value.astype(np.float32), name)


def constant_network(path: Path, maps: np.ndarray, size: tuple[Any, Any] = SIZE) -> str:
    """A network that answers every picture with the same maps (C, h, w), or (h, w)."""
    node = onnx.helper.make_node
    nodes = [
        node("ReduceMean", ["picture"], ["mean"], keepdims=1, axes=[1, 2, 3]),
        node("Mul", ["mean", "zero"], ["nothing"]),
        node("Add", ["nothing", "maps"] if maps.ndim == 3 else ["flat", "maps"], ["out"]),
    ]
    initializers = [_tensor("zero", np.zeros(1)), _tensor("maps", maps[None])]
    if maps.ndim == 2:
        nodes.insert(2, node("Squeeze", ["nothing", "axis"], ["flat"]))
        initializers.append(onnx.numpy_helper.from_array(np.array([1]), "axis"))
    return _write(path, nodes, "out", initializers, size)


def whiteness_network(path: Path, size: tuple[int, int]) -> str:
    """29 classes; the circle's wins where a pixel is bright: a network that knows markings, but not which."""
    weights, bias = np.zeros((29, 3, 1, 1)), np.full(29, -10.0)
    weights[7], bias[7], bias[0] = 1 / 3, -0.55, 0.0
    node = onnx.helper.make_node("Conv", ["picture", "weights", "bias"], ["out"])
    return _write(path, [node], "out", [_tensor("weights", weights), _tensor("bias", bias)], size)


def gaussians(points: np.ndarray, size: tuple[int, int], sigma: float = 2.0, height: float = 0.8) -> np.ndarray:
    """Heat maps (C, h, w) with their tops at ``points`` (C, K, 2), in cells; the background last."""
    x, y = np.arange(size[0]), np.arange(size[1])[:, None]
    distance = (x - points[..., 0, None, None]) ** 2 + (y - points[..., 1, None, None]) ** 2
    maps = height * np.exp(-distance / (2 * sigma**2)).max(axis=1)
    return np.concatenate([maps, 1 - maps.max(axis=0, keepdims=True)])


def _picture(size: tuple[int, int] = SIZE) -> np.ndarray:
    return np.random.default_rng(0).integers(0, 255, (size[1], size[0], 3)).astype(np.uint8)


def test_classes_come_out_where_the_network_puts_them(tmp_path: Path) -> None:
    maps = np.zeros((29, 54, 96))
    maps[0] = 0.5
    maps[7, 10:30, 20:50] = 1.0
    maps[18, :, 60:64] = 1.0
    found = segment(_picture(), constant_network(tmp_path / "n.onnx", maps), SegmentationNetwork(), KEY)
    expected = np.zeros((54, 96), np.uint8)
    expected[10:30, 20:50] = 7
    expected[:, 60:64] = 18
    np.testing.assert_array_equal(found, expected)


def test_small_maps_are_enlarged_with_smooth_borders(tmp_path: Path) -> None:
    x, y = np.meshgrid(np.arange(96), np.arange(54))
    distance = np.hypot(x - 47.5, y - 26.5)
    maps = np.full((29, 54, 96), -100.0)
    maps[0], maps[7] = 0.0, 15.0 - distance
    found = segment(_picture((960, 540)), constant_network(tmp_path / "n.onnx", maps), SegmentationNetwork(), KEY)
    x, y = np.meshgrid(np.arange(960), np.arange(540))
    disc = np.hypot(x - 479.5, y - 269.5) < 150
    assert found.shape == (540, 960)
    assert ((found == 7) != disc).sum() < 300, "a border of 942 px that is nowhere a whole cell (10 px) off"


@pytest.mark.parametrize("axes", ["scores", "numbers"])
def test_class_map_of_another_network(tmp_path: Path, axes: str) -> None:
    numbers = np.zeros((54, 96))
    numbers[5:10], numbers[20:30] = 1, 2
    maps = np.eye(3)[numbers.astype(int)].transpose(2, 0, 1) if axes == "scores" else numbers
    network = SegmentationNetwork(classes={1: 18, 2: 7})
    found = segment(_picture(), constant_network(tmp_path / "n.onnx", maps), network, KEY)
    np.testing.assert_array_equal(found, np.array([0, 18, 7])[numbers.astype(int)])


def test_picture_is_normalised_as_configured(tmp_path: Path) -> None:
    """A network that looks at one channel alone: its threshold tells order, mean and std."""
    weights, bias = np.zeros((2, 3, 1, 1)), np.array([0.0, 0.0])
    weights[1, 0] = 1.0
    node = onnx.helper.make_node("Conv", ["picture", "weights", "bias"], ["out"])
    path = _write(tmp_path / "n.onnx", [node], "out", [_tensor("weights", weights), _tensor("bias", bias)])
    picture = np.zeros((54, 96, 3), np.uint8)
    picture[:20, :, 2] = 255  # red
    picture[30:, :, 0] = 255  # blue
    mean = (0.5, 0.5, 0.5)
    for channels, expected in (("rgb", slice(0, 20)), ("bgr", slice(30, 54))):
        network = SegmentationNetwork(channels=channels, mean=mean, classes={1: 7})
        found = segment(picture, path, network, KEY)
        assert (found[expected] == 7).all()
        assert (found == 7).sum() == found[expected].size


def test_calibrates_with_a_network_as_with_the_detector(tmp_path: Path, frame_image: np.ndarray) -> None:
    model = whiteness_network(tmp_path / "white.onnx", (960, 540))
    config = load_config(None, ["mask.source=onnx", f"mask.model={model}"])
    by_network = calibrate(frame_image, config=config)
    by_detector = calibrate(frame_image)
    assert by_network.attempt.mask is not None and by_network.attempt.mask.source == "network"
    assert by_network.status == by_detector.status == "calibrated"
    assert by_network.camera is not None and by_detector.camera is not None
    x, y = np.meshgrid(np.linspace(-12, 12, 7), np.linspace(-9, 9, 7))
    field_m = np.stack([x, y, np.zeros_like(x)], axis=-1).reshape(-1, 3)
    shift = by_network.camera.project(field_m) - by_detector.camera.project(field_m)
    assert np.median(np.linalg.norm(shift, axis=1)) < 2.0, "the detector has named touchlines, the network none"


def test_peaks_are_found_between_cells(tmp_path: Path) -> None:
    rng = np.random.default_rng(3)
    places = rng.uniform([3, 3], [92, 50], (57, 1, 2))
    places[0, 0], places[1, 0] = [0.0, 20.0], [95.0, 53.0]  # at the border
    path = constant_network(tmp_path / "n.onnx", gaussians(places, SIZE))
    found = find_peaks(_picture((960, 540)), path, NetworkInput(size=SIZE), KEY, channels=57, count=1)
    np.testing.assert_allclose(found.points_px, places * 10, atol=0.05)
    np.testing.assert_allclose(found.confidence[2:, 0], 0.8, atol=0.06)


def test_two_ends_per_line(tmp_path: Path) -> None:
    places = np.stack([np.stack([np.full(23, 10.3), np.arange(23) * 2.0], -1), np.full((23, 2), [80.6, 30.4])], 1)
    path = constant_network(tmp_path / "n.onnx", gaussians(places, SIZE))
    found = find_peaks(_picture(), path, NetworkInput(), KEY, channels=23, count=2)
    order = np.argsort(found.points_px[..., 0], axis=1)
    np.testing.assert_allclose(np.take_along_axis(found.points_px, order[..., None], 1), places, atol=0.02)


def _keypoint_model(path: Path, camera: Camera, moved: dict[int, float]) -> str:
    """Heat maps of the keypoints that a camera sees; keypoints that it does not see have flat maps."""
    template = load_field("soccer")
    table = keypoint_table(template) | tangency_points(9.15)
    places, height = np.zeros((57, 1, 2)), np.zeros((57, 1, 1))
    for number in range(1, 58):
        if number not in table:
            continue
        pixel = camera.project(np.r_[table[number], 0.0][None])[0] + [moved.get(number, 0.0), 0.0]
        if (pixel > 4).all() and (pixel < np.array([camera.width, camera.height]) - 4).all():
            places[number - 1, 0], height[number - 1] = pixel / 2, 1.0
    maps = gaussians(places, (480, 270))
    maps[:-1] *= height
    return constant_network(path, maps, (960, 540))


def test_keypoints_of_a_network_mean_what_they_mean_in_files(tmp_path: Path, frame_camera: Camera) -> None:
    model = _keypoint_model(tmp_path / "kp.onnx", frame_camera, {})
    network = KeypointsConfig(source="onnx", model=model)
    observations = observe_network(_picture((960, 540)), network, load_field("soccer"), SourcesConfig())
    assert observations is not None
    by_name = {k.name: k for k in observations.keypoints}
    assert by_name["kp_52"].field_m == pytest.approx([9.15 * WRONG_RIGHT_END - 0.055, 0], abs=0.06)
    for keypoint in observations.keypoints:
        expected = frame_camera.project(np.r_[keypoint.field_m, 0.0][None])[0]
        np.testing.assert_allclose(keypoint.point_px, expected, atol=0.1)
    assert [m.mark for m in observations.marks] == ["centre_mark"]


def test_keypoints_are_used_beside_the_picture_and_a_wrong_one_is_named(
    tmp_path: Path, frame_camera: Camera, frame_image: np.ndarray
) -> None:
    model = _keypoint_model(tmp_path / "kp.onnx", frame_camera, {49: 60.0})
    config = load_config(None, ["keypoints.source=onnx", f"keypoints.model={model}"])
    found = calibrate(frame_image, config=config).attempt
    assert found.is_calibrated and found.camera is not None
    assert MarkingKey("kp_49") in found.camera.rejected
    assert MarkingKey("kp_48") not in found.camera.rejected
    assert {k.name for k in found.observations.keypoints} > {"kp_48", "kp_53", "kp_54"}


def _no_file(tmp_path: Path) -> str:
    return str(tmp_path / "none.onnx")


def _no_model(tmp_path: Path) -> str:
    (tmp_path / "text.onnx").write_text("hello")
    return str(tmp_path / "text.onnx")


def _nan(tmp_path: Path) -> str:
    return constant_network(tmp_path / "n.onnx", np.full((29, 54, 96), np.nan))


def _many_classes(tmp_path: Path) -> str:
    return constant_network(tmp_path / "n.onnx", np.zeros((150, 54, 96)))


def _any_size(tmp_path: Path) -> str:
    return constant_network(tmp_path / "n.onnx", np.zeros((29, 54, 96)), ("w", "h"))


def _vector(tmp_path: Path) -> str:
    node = onnx.helper.make_node("ReduceMean", ["picture"], ["out"], keepdims=0, axes=[2, 3])
    return _write(tmp_path / "n.onnx", [node], "out", [])


@pytest.mark.parametrize(
    ("make", "network", "words"),
    [
        (_no_file, {}, "no such model file"),
        (_no_model, {}, "no usable ONNX model"),
        (_nan, {}, "NaN"),
        (_many_classes, {}, "150 classes"),
        (_many_classes, {"classes": {3: 99}}, "99 is no SoccerNet class id"),
        (_any_size, {}, "any size"),
        (_nan, {"size": (640, 360)}, "takes 96x54 pictures, but size is 640x360"),
        (_nan, {"output": "probabilities"}, "no output 'probabilities'; it has out"),
        (_nan, {"provider": "coreml"}, "provider coreml"),
        (_vector, {}, "no output with height and width"),
    ],
)
def test_unusable_networks(tmp_path: Path, make: Any, network: dict[str, Any], words: str) -> None:
    with pytest.raises(ConfigError, match=words) as caught:
        segment(_picture(), make(tmp_path), SegmentationNetwork(**network), KEY)
    assert str(caught.value).startswith(KEY)
    assert "\n" not in str(caught.value)


def test_heat_maps_of_another_layout(tmp_path: Path) -> None:
    path = constant_network(tmp_path / "n.onnx", np.zeros((33, 54, 96)))
    with pytest.raises(ConfigError, match=r"keypoints.model: .*wanted are 1, 58, height, width"):
        find_peaks(_picture(), path, NetworkInput(), "keypoints.model", channels=57, count=1)


def test_missing_extra(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    model = constant_network(tmp_path / "n.onnx", np.zeros((29, 54, 96)))
    monkeypatch.setitem(__import__("sys").modules, "onnxruntime", None)
    with pytest.raises(MissingExtraError, match=r"\[onnx\]"):
        require_networks(load_config(None, ["mask.source=onnx", f"mask.model={model}"]))


def test_digest_follows_the_content_of_the_model(tmp_path: Path) -> None:
    model = tmp_path / "n.onnx"
    settings = ["mask.source=onnx", f"mask.model={constant_network(model, np.zeros((29, 54, 96)))}"]
    config = load_config(None, settings)
    before = config_digest(config)
    (tmp_path / "moved.onnx").write_bytes(model.read_bytes())
    moved = load_config(None, [settings[0], f"mask.model={tmp_path / 'moved.onnx'}"])
    assert config_digest(moved) == before
    constant_network(model, np.ones((29, 54, 97)))
    assert config_digest(config) != before


def test_model_file_lies_relative_to_the_configuration(tmp_path: Path) -> None:
    constant_network(tmp_path / "n.onnx", np.zeros((29, 54, 96)))
    file = tmp_path / "mine.yaml"
    file.write_text("mask: {source: onnx, model: n.onnx}\n")
    require_networks(load_config(file))


@pytest.mark.parametrize("name", ["soccernet-baseline", "tvcalib", "pnlcalib"])
def test_presets_name_what_is_missing(name: str) -> None:
    with pytest.raises(ConfigError, match=r"(mask|keypoints)\.model: a network is wanted"):
        require_networks(load_config(f"networks/{name}"))


def test_command_line(tmp_path: Path, run_circlecal: Any, frame_image: np.ndarray) -> None:
    picture = tmp_path / "frame.png"
    cv2.imwrite(str(picture), frame_image)
    outcome = run_circlecal("calibrate", picture, "--out", tmp_path / "out", "--set", "mask.source=onnx")
    assert outcome.code == 2
    assert outcome.err.strip().splitlines() == [
        "circlecal: error: mask.model: a network is wanted, and no model file is named; set mask.model to an .onnx file"
    ]
    assert not (tmp_path / "out").exists()
