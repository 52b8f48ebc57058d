"""The answers to golden frames stay what they are: samples, rendered frames, annotations, solvers and a rig.

A change that is meant to alter answers writes them anew, and its diff shows which, and by how much:

    python -m tests.golden.test_golden --update

from the root of the checkout; with names of cases behind it (``rendered-easy_0``) only these. Without ``--update`` it
prints whatever differs in nine digits, which on one machine nothing should do that leaves answers as they are.

Other kernels of linear algebra and of picture filters round otherwise, and where a rounded score chooses between
observations that are as good, the answer moves: by a few hundredths of its standard deviation at most in these frames,
and by less than a millionth in most. The verdict, the checks passed and the lines recognised stay the same.
"""

from __future__ import annotations

import json
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from circlecal.geometry.projective import apply_homography, normalise_line, transform_lines

from .cases import Case, cases

CASES = cases()
EXPECTED = Path(__file__).parent / "expected"
RELATIVE = 1e-5
SHARE = 0.1
"""Of the predicted standard deviation, within which an answer is the same."""
DIGITS = 9


@pytest.mark.parametrize("case", CASES, ids=str)
def test_the_answer_is_the_kept_one_and_agrees_with_itself(case, tmp_path):
    records = case.calibrate(tmp_path)
    found = {name: summary(record) for name, record in records.items()}
    assert differences(kept_answers(case), found, RELATIVE, SHARE) == []
    assert [name for name, record in records.items() if not is_consistent(record)] == []


def is_consistent(record: dict[str, Any]) -> bool:
    """Whether points, tangents, homography and camera of a record see the field from the same side."""
    held = record if record["status"] == "calibrated" else record.get("rejected_estimate") or {}
    H, found = held.get("H_image_field"), record.get("correspondences")
    if H is None or found is None:
        return True
    ellipse = record["ellipses"][record["ellipses"]["primary"]]
    field, image = (np.array([p[key] for p in found["points"]]) for key in ("field_m", "image_px"))
    lines, seen = (np.array([t[key] for t in found["tangents"]]) for key in ("field_line", "image_line"))
    off = np.linalg.norm(apply_homography(H, field) - image, axis=1)
    drawn = normalise_line(transform_lines(H, lines))
    # a line and its negative are one line; turned by 180 degrees a tangent is the opposite one
    apart = np.minimum(np.abs(drawn - seen)[:, 2], np.abs(drawn + seen)[:, 2])
    size = max(ellipse["semi_axes_px"])
    return bool(np.median(off) < 0.5 * size and np.median(apart) < 0.5 * size)


def test_what_is_kept_belongs_to_a_case():
    kept = {f"{path.stem}-{name}" for path in EXPECTED.glob("*.json") for name in json.loads(path.read_text())}
    assert kept == set(map(str, CASES))


def test_differences_are_told_with_their_place():
    kept = {"status": "calibrated", "focal_px": {"is": [2000.0, 2000.0], "sd": [10.0, 10.0]}}
    found = {"status": "refused", "focal_px": {"is": [2000.5, 2002.0], "sd": [10.5, 12.0]}}
    assert differences(kept, kept, 0.0, 0.0) == []
    assert differences(kept, found, RELATIVE, SHARE) == [
        ".status: calibrated -> refused",
        ".focal_px: 2000.0 +- 10.0 -> 2002.0 +- 12.0",
    ]
    assert len(differences(kept, found, 0.0, 0.0)) == 3
    assert differences(kept, {}, RELATIVE, SHARE) == [": ['focal_px', 'status'] -> []"]


def kept_answers(case: Case) -> dict[str, Any]:
    return json.loads((EXPECTED / f"{case.group}.json").read_text())[case.name]


def answers(case: Case, folder: Path) -> dict[str, Any]:
    """What is kept of each result of a case, by the id of its frame."""
    return {name: summary(record) for name, record in case.calibrate(folder).items()}


def summary(record: dict[str, Any]) -> dict[str, Any]:
    """The answer of a result file; every number of nine digits, with its standard deviation where there is one."""
    kept = {
        "status": record["status"],
        "code": record["code"],
        "checks": {check["name"]: check["passed"] for check in record["checks"]},
    }
    if record["status"] != "calibrated":
        return kept
    kept["case"] = record["case"]
    kept["H_image_field"] = _numbers(np.ravel(record["H_image_field"])[:8], _spread(record["H_covariance"]))
    if record["imaged_center"] is not None:
        kept["imaged_center"] = _numbers(record["imaged_center"], _spread(record["imaged_center_covariance"]))
    camera = record["camera"]
    if camera is None or camera["covariance"] is None:
        points = (record["correspondences"] or {}).get("points", [])
        return kept | {"points_px": {point["label"]: _numbers(point["image_px"]) for point in points}}
    fit = camera["covariance"]
    sd = dict(zip(fit["parameters"], _spread(fit["matrix"]), strict=True))
    estimate = dict(zip(fit["parameters"], fit["estimate"], strict=True))
    focal = np.array([camera["x_focal_length"], camera["y_focal_length"]])
    angles = ("pan", "tilt", "roll")
    shape = ("kappa_1", "kappa_2", "crown")
    return kept | {
        "focal_px": _numbers(focal, focal * sd["log_focal"]),
        "angles_degrees": _numbers([camera[f"{a}_degrees"] for a in angles], np.degrees([sd[a] for a in angles])),
        "position_m": _numbers(camera["position_meters"], [sd[axis] for axis in "xyz"]),
        "principal_point": _numbers(camera["principal_point"], [sd["pp_x"], sd["pp_y"]]),
        "lens_and_crown": _numbers([estimate[name] for name in shape], [sd[name] for name in shape]),
        "crown_shape": camera["crown_shape"],
        "max_sigma_px": _numbers([camera["max_sigma_px"]], [camera["max_sigma_px"]]),
        "max_sigma_m": _numbers([camera["max_sigma_m"]], [camera["max_sigma_m"]]),
        "named_lines": camera["named_lines"],
        "rejected_observations": camera["rejected_observations"],
        "points_px": {
            point["label"]: _numbers(point["image_px"], _spread(point["covariance"]))
            for point in camera["derived_points"]
        },
    }


def differences(kept: Any, found: Any, relative: float, share: float, path: str = "") -> list[str]:
    """Each place where two answers differ, with both: numbers by more than that and that share of their deviation."""
    if isinstance(kept, dict) and isinstance(found, dict):
        if kept.keys() != found.keys():
            return [f"{path}: {sorted(kept.keys() - found.keys())} -> {sorted(found.keys() - kept.keys())}"]
        if kept.keys() == {"is", "sd"}:
            return _moved(kept, found, relative, share, path)
        return [told for key in kept for told in differences(kept[key], found[key], relative, share, f"{path}.{key}")]
    return [] if kept == found else [f"{path}: {kept} -> {found}"]


def _moved(kept: dict[str, Any], found: dict[str, Any], relative: float, share: float, path: str) -> list[str]:
    told = []
    for old, new, old_sd, new_sd in zip(kept["is"], found["is"], kept["sd"], found["sd"], strict=True):
        near = abs(old - new) <= relative * abs(old) + share * old_sd
        if not near or abs(old_sd - new_sd) > relative * old_sd + share * old_sd:
            told.append(f"{path}: {old} +- {old_sd} -> {new} +- {new_sd}")
    return told


def _spread(covariance: Any) -> Any:
    return None if covariance is None else np.sqrt(np.diagonal(covariance))


def _numbers(values: Any, sd: Any = None) -> dict[str, list[float]]:
    """Values and their standard deviation; where nothing states one, a hundredth of the value stands for it."""
    sd = np.abs(values) / 100 if sd is None else sd
    return {"is": [float(f"{v:.{DIGITS}g}") for v in values], "sd": [float(f"{v:.{DIGITS}g}") for v in sd]}


def update(names: list[str]) -> None:
    """Write the answers of the named cases anew, or of all, one line for each thing that is kept."""
    for group in dict.fromkeys(case.group for case in CASES):
        path = EXPECTED / f"{group}.json"
        kept = json.loads(path.read_text()) if path.exists() else {}
        of_group = {case.name: case for case in CASES if case.group == group}
        for name, case in of_group.items():
            if not names or str(case) in names:
                with tempfile.TemporaryDirectory() as folder:
                    kept[name] = answers(case, Path(folder))
        path.write_text(_text({name: kept[name] for name in of_group if name in kept}))


def show(names: list[str]) -> int:
    """Print what differs at all in the named cases, or in all; how many do."""
    count = 0
    for case in CASES:
        if not names or str(case) in names:
            with tempfile.TemporaryDirectory() as folder:
                told = differences(kept_answers(case), answers(case, Path(folder)), 0.0, 0.0)
            count += bool(told)
            sys.stdout.writelines(f"{case}{line}\n" for line in told)
    return count


def _text(content: Any, depth: int = 0) -> str:
    """JSON with a line for each key of the first three levels."""
    if depth == 3:
        return json.dumps(content)
    indent = " " * depth
    lines = [f"{indent} {json.dumps(key)}: {_text(inner, depth + 1)}" for key, inner in content.items()]
    return "{\n" + ",\n".join(lines) + f"\n{indent}}}" + ("\n" if depth == 0 else "")


if __name__ == "__main__":
    if sys.argv[1:2] == ["--update"]:
        update(sys.argv[2:])
    else:
        sys.exit(min(1, show(sys.argv[1:])))
