"""What the frames of each camera share: groups of frames, the joint fit of each, and what it says of any frame."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import chdtri

from circlecal.camera.field_evidence import half_log_determinant
from circlecal.camera.noise import rescale_sigmas
from circlecal.camera.observed import curves_from_observations, points_from_observations
from circlecal.camera.options import noise_model, priors_of, relief_of
from circlecal.camera.priors import SharedPrior, SharedPriorConfig
from circlecal.camera.problem import WIDE_LOSS, Problem, evaluate
from circlecal.camera.residuals import curve_residuals, line_curve, sample_feet
from circlecal.camera.rig_options import RigConfig
from circlecal.camera.spike_and_slab import shares_of_all_sizes
from circlecal.camera.world import BREADTH, FLAT_RELIEF_SHARE, FLAT_SD_M, LENGTH, Size, World
from circlecal.config import Config, suit_pixels
from circlecal.field import Circle, FieldTemplate
from circlecal.geometry.camera_parameters import PARAMETERS, POSITION, ProjectionModel
from circlecal.geometry.homography import side_of_place
from circlecal.geometry.projective import Array
from circlecal.geometry.surface import Surface
from circlecal.observations import Observations
from circlecal.rig.frames import RigFrame
from circlecal.rig.information import deletion_gains, estimate_common, frame_information, shared_prior
from circlecal.rig.joint import JointProblem, JointState, Turning, joint_problem, minimise_joint, start_state
from circlecal.rig.positions import group_positions

SAME_POSITION_M = 0.8
"""How far the positions of one camera may differ beyond their own uncertainty, metres: the lens lies up to 1.3 m before
the axis about which it turns.
"""
SAME_PLACE_M = 0.2
"""How far what lies at the other end of the field may be from its place there, metres: fields are drawn alike at both
ends to a centimetre.
"""
SAME_LINE_PX = 6.0
"""A recognised line is the seen one that lies this near to where the camera puts it, pixels at 1920 px width."""
ZOOM_BINS = 5
"""Frames are taken from so many parts of the range of zooms in turn: a change by zoom shows between them only."""
SAME_CAMERA = 0.99
"""Share of cameras within which two estimates of one position lie."""
UNUSUAL_SIGMAS, UNUSUAL_SHARE = 3.0, 0.25
"""By how many standard deviations of the usual sizes a field that a frame alone shows must differ from them, and the
share of frames that show such a field, for other sizes to be compared. Of 85 frames of four real pitches none does, of
58 of four rendered ones of other sizes all do. What all real frames repeat, of the surface and of painters, adds up,
and one frame that is wrong must not open the size to it.
"""
LARGEST_LEVER_M = 3.0
"""Twice the longest lever arm that standing cameras have shown: further apart two frames are of two cameras."""


@dataclass(frozen=True, slots=True)
class Rig:
    """One camera and its frames.

    Attributes
    ----------
    name : str
        Of the camera.
    size : (int, int)
        Width and height of its pictures.
    members : tuple of str
        Frames that agree on where it stands.
    used : tuple of str
        Frames that were estimated together.
    left_out : tuple of str
        Frames that fitted the others much worse than alone.
    problem, state : JointProblem, JointState
        The joint fit.
    """

    name: str
    size: tuple[int, int]
    members: tuple[str, ...]
    used: tuple[str, ...]
    left_out: tuple[str, ...]
    problem: JointProblem
    state: JointState

    def prior(self, frame_id: str | None = None, theta: Array | None = None) -> SharedPrior:
        """What the other frames say of a frame; of any other picture of this camera when None. A camera (P,) that was
        found for the frame alone tells where it points.
        """
        if frame_id in self.used:
            return shared_prior(self.problem, self.state, self.used.index(frame_id))
        # a camera elsewhere, or on the other side of the field, does not tell how this one points
        if theta is not None and np.linalg.norm(theta[POSITION] - self.state.theta[0, POSITION]) > LARGEST_LEVER_M:
            theta = None
        return shared_prior(self.problem, self.state, None, theta)


@dataclass(frozen=True, slots=True)
class _Group:
    """Frames that one camera may have taken.

    Attributes
    ----------
    name : str
        Of the camera.
    frames : tuple of RigFrame
        The frames.
    turned : tuple of bool
        Whether each has to be turned by 180 degrees to agree with the others.
    beside : int or None
        Place of the rig that left these frames out; None for frames that were in no rig before.
    """

    name: str
    frames: tuple[RigFrame, ...]
    turned: tuple[bool, ...]
    beside: int | None = None


def estimate_rigs(
    frames: Sequence[RigFrame],
    template: FieldTemplate,
    circle: Circle,
    config: Config,
    cameras: Mapping[str, str] | None = None,
    read_frames: Callable[[Collection[str]], Mapping[str, RigFrame]] | None = None,
) -> list[Rig]:
    """The cameras that several frames share, those with the most frames first where ``cameras`` names none.

    Parameters
    ----------
    frames : sequence of RigFrame
        All frames of a run; those without a camera of their own are left alone here.
    template, circle : FieldTemplate, Circle
        In the convention in which the frames were calibrated.
    config : Config
        Of the run; the sections ``camera`` and ``rig`` count.
    cameras : mapping, optional
        Name of the camera by frame, where it is known; otherwise frames are grouped by where their cameras stand.
    read_frames : callable, optional
        Gives the frames with these ids together with what was seen of them; None where ``frames`` hold it already.
    """
    known = [f for f in frames if f.theta is not None and f.covariance is not None and f.observations is not None]
    rigs: list[Rig] = []
    groups = _group_frames(known, config, cameras)
    while groups:
        best = [_select_best(group, config) for group in groups]
        wanted = {frame.id for group in best for frame in group.frames}
        full = read_frames(wanted) if read_frames is not None else {frame.id: frame for frame in known}
        estimates = [_estimate_rig(_fill_group(group, full), template, circle, config) for group in best]
        rigs, rest = _join_rigs(rigs, groups, estimates, config)
        # cameras that stand side by side were one group; those that were left out may be another one
        groups = rest if cameras is None else []
    return _number_rigs(rigs) if cameras is None else rigs


def _fill_group(group: _Group, full: Mapping[str, RigFrame]) -> _Group:
    """A group whose frames have what was seen of them."""
    return replace(group, frames=tuple(full[frame.id] for frame in group.frames))


def _join_rigs(
    rigs: Sequence[Rig], groups: Sequence[_Group], estimates: Sequence[Rig | None], config: Config
) -> tuple[list[Rig], list[_Group]]:
    """The rigs with those that were estimated of groups, and the groups of frames that these left out, where there are
    enough of them; of two rigs of one camera the larger one stays.
    """
    joined, rest = list(rigs), list[_Group]()
    for group, rig in zip(groups, estimates, strict=True):
        if rig is None:
            continue
        if group.beside is not None and _stand_together(rig, joined[group.beside]):
            joined[group.beside] = _choose_larger(joined[group.beside], rig)
            continue
        left_out = [k for k, frame in enumerate(group.frames) if frame.id in rig.left_out]
        if len(left_out) >= config.rig.least_frames:
            members = _choose_members(group.name, group.frames, group.turned, left_out)
            rest.append(replace(members, beside=len(joined)))
        joined.append(replace(rig, members=tuple(frame.id for frame in group.frames)))
    return joined, rest


def _number_rigs(rigs: Sequence[Rig]) -> list[Rig]:
    """Rigs with the most frames first, named in this order."""
    ordered = sorted(rigs, key=lambda rig: len(rig.members) - len(rig.left_out), reverse=True)
    return [replace(rig, name=f"camera-{number}") for number, rig in enumerate(ordered, start=1)]


def _choose_larger(first: Rig, rest: Rig) -> Rig:
    """Of two rigs of one camera, of which the second holds what the first left out, the one with more frames; those of
    the other one are left out.
    """
    if len(rest.used) <= len(first.used):
        return first
    return replace(rest, members=first.members, left_out=(*first.used, *rest.left_out))


def _stand_together(first: Rig, second: Rig) -> bool:
    """Whether two rigs stand where one camera may stand: then the frames of one of them do not fit it."""
    (place, spread), (other_place, other_spread) = (_locate(rig) for rig in (first, second))
    apart = place - other_place
    spread = spread + other_spread + SAME_POSITION_M**2 * np.eye(3)
    return bool(apart @ np.linalg.solve(spread, apart) < chdtri(3, 1.0 - SAME_CAMERA))


def _locate(rig: Rig) -> tuple[Array, Array]:
    """Where a rig's camera or its pan axis stands (3,), metres, and the covariance of that, 0 along what is fixed."""
    mean, covariance = estimate_common(rig.state)
    shared, count = rig.problem.shared, len(rig.problem.shared)
    theta, spread = rig.problem.base, np.zeros((len(PARAMETERS), len(PARAMETERS)))
    theta[shared] = mean[:count]
    spread[np.ix_(shared, shared)] = covariance[:count, :count]
    return theta[POSITION], spread[POSITION, POSITION]


def _select_best(group: _Group, config: Config) -> _Group:
    """The frames of a group that are estimated together: of the usual size."""
    sizes = [frame.size for frame in group.frames]
    size = max(set(sizes), key=sizes.count)
    alike = [k for k, own in enumerate(sizes) if own == size]
    best = [alike[k] for k in select_frames([group.frames[k] for k in alike], config.rig.maximum_frames)]
    return _choose_members(group.name, group.frames, group.turned, best)


def _choose_members(name: str, frames: Sequence[RigFrame], turned: Sequence[bool], chosen: Iterable[int]) -> _Group:
    """The group of the frames with these places."""
    members = [(frames[k], turned[k]) for k in chosen]
    return _Group(name, tuple(frame for frame, _ in members), tuple(turn for _, turn in members))


def _group_frames(frames: Sequence[RigFrame], config: Config, cameras: Mapping[str, str] | None) -> list[_Group]:
    """Every group that is large enough, by the names of cameras where they are known, or else by where these stand."""
    least = config.rig.least_frames
    if cameras is not None:
        places_by_name: dict[str, list[int]] = {}
        for place, frame in enumerate(frames):
            if frame.id in cameras:
                places_by_name.setdefault(cameras[frame.id], []).append(place)
        unturned = [False] * len(frames)
        named = [(name, places) for name, places in places_by_name.items() if len(places) >= least]
        return [_choose_members(name, frames, unturned, places) for name, places in named]
    if not frames:
        return []
    theta = np.array([f.theta for f in frames])
    covariance = np.array([f.covariance for f in frames])[:, POSITION, POSITION]
    numbers, turned = group_positions(theta[:, POSITION], covariance + SAME_POSITION_M**2 * np.eye(3), least)
    return [
        _choose_members(f"camera-{number + 1}", frames, turned.tolist(), np.flatnonzero(numbers == number).tolist())
        for number in range(numbers.max() + 1)
    ]


def _estimate_rig(group: _Group, template: FieldTemplate, circle: Circle, config: Config) -> Rig | None:
    """The joint fit of frames of a camera, without those that do not fit; None where too few are left.

    The field has the size for which there is the most evidence. Of a field that they show to be flat, the marks lie on
    even ground, unless too few of them agree there.
    """
    frames, turned = group.frames, group.turned
    thetas = np.array([frame.turn_field() if turn else frame.theta for frame, turn in zip(frames, turned, strict=True)])

    def fit(options: Config, size: Size) -> Rig | None:
        seen = zip(frames, thetas, turned, strict=True)
        problems = [
            problem_of_frame(f, theta, template, circle, options, turned=turn, field_size=size)
            for f, theta, turn in seen
        ]
        return _fit_problems(group.name, frames, problems, thetas, options)

    shares = _possible_sizes(thetas, template, config)
    found = {size: rig for size in shares if (rig := fit(config, size)) is not None}
    if not found:
        return None
    cameras = dict(zip((frame.id for frame in frames), thetas, strict=True))
    size = max(found, key=lambda size: _log_evidence(found[size], cameras, config) + np.log(shares[size]))
    told = with_told_relief(config, found[size].prior())
    return found[size] if told is config else fit(told, size) or found[size]


def _possible_sizes(thetas: Array, template: FieldTemplate, config: Config) -> dict[Size, float]:
    """Sizes that the field may have, and the share of fields with each: others than the usual one where enough of the
    cameras (F, P) that were found alone have a field that is clearly longer or wider, or less so.
    """
    usual_sd = np.array([template.length_sd_m, template.width_sd_m])
    is_other = (np.abs(thetas[:, [LENGTH, BREADTH]]) > UNUSUAL_SIGMAS * usual_sd).any(axis=1)
    shares = shares_of_all_sizes(config.camera.usual_size_share, config.camera.other_length_share)
    possible = {size: share for size, share in shares.items() if share > 0.0}
    return possible if np.mean(is_other) >= UNUSUAL_SHARE else {"usual": 1.0}


def _log_evidence(rig: Rig, cameras: Mapping[str, Array], config: Config) -> float:
    """Logarithm of the evidence for the size of the field with which frames were fitted, in Laplace's approximation as
    of :mod:`circlecal.camera.field_evidence`, up to what all sizes have in common.

    What is each frame's own counts alike for all sizes; a frame that was left out counts as much as it may at most fit
    worse than alone, by its camera (P,).
    """
    problem, state = rig.problem, rig.state
    alone = sum(_cost_alone(p, cameras[name]) for p, name in zip(problem.frames, rig.used, strict=True))
    worse = float(state.cost[0]) - alone + len(rig.left_out) * config.rig.maximum_chi_square_increase
    precision, _ = frame_information(state)
    sd = problem.priors.sd[[LENGTH, BREADTH]]
    volume = half_log_determinant(state.H_common + precision.sum(axis=0))
    volume += np.log(sd[(sd > 0) & np.isfinite(sd)]).sum()
    return float(-0.5 * worse - volume)


def _fit_problems(
    name: str, frames: Sequence[RigFrame], problems: Sequence[Problem], thetas: Array, config: Config
) -> Rig | None:
    """The joint fit of frames of a camera, without those that do not fit, from their cameras (F, P)."""
    kept, left_out = list(range(len(frames))), list[str]()
    problem: JointProblem | None = None
    while len(kept) >= config.rig.least_frames:
        problem = _combine_problems(
            [problems[k] for k in kept], config, frames[0].size[0], float(np.median(thetas[kept, 0]))
        )
        alone = np.array([_cost_alone(p, thetas[k]) for p, k in zip(problem.frames, kept, strict=True)])
        wide = problem.with_loss(WIDE_LOSS * config.camera.loss_scale)
        state = minimise_joint(wide, start_state(wide, thetas[kept]), config.camera.iterations // 2)
        state = minimise_joint(problem, start_state(problem, state.theta), config.camera.iterations)
        chi_square_increase = state.costs - alone
        if chi_square_increase.max() <= config.rig.maximum_chi_square_increase:
            used = tuple(frames[k].id for k in kept)
            return Rig(name, frames[0].size, (), used, tuple(left_out), problem, state)
        # not the frame that fits worst, but the one without which everything fits best: the fewer must go
        worst = int(np.argmax(chi_square_increase + deletion_gains(state)))
        left_out.append(frames[kept[worst]].id)
        del kept[worst]
    return None


def _combine_problems(problems: Sequence[Problem], config: Config, width: int, log_focal: float) -> JointProblem:
    rig, unit = config.rig, width / 1920.0
    position, point = rig.position_deviation_m, rig.principal_point_deviation_px * unit
    return joint_problem(
        problems,
        slope_sd={
            "pp_x": rig.principal_point_by_zoom_px * unit,
            "pp_y": rig.principal_point_by_zoom_px * unit,
            "kappa_1": rig.k1_by_zoom,
        },
        deviation_sd={
            "x": position,
            "y": position,
            "z": position,
            "roll": float(np.radians(rig.roll_deviation_deg)),
            "pp_x": point,
            "pp_y": point,
            "kappa_1": rig.k1_deviation,
        },
        log_focal=log_focal,
        turning=turning_of(rig),
    )


def turning_of(config: RigConfig) -> Turning:
    """What the options assume of how a camera turns."""
    lean_sd = np.radians(config.lean_sd_deg)
    return Turning(np.array([0.0, 0.0, config.lever_m]), np.array([lean_sd, lean_sd, config.lever_sd_m]))


def _cost_alone(problem: Problem, theta: Array) -> float:
    """Cost of a frame's observations where the frame is calibrated alone."""
    feet = sample_feet(problem.curves, theta[None], problem.model)
    return float(evaluate(problem, theta[None], feet, updates=4).cost[0])


def select_frames(frames: Sequence[RigFrame], maximum: int) -> list[int]:
    """Indices of the best determined frames, from the whole range of zooms in turn."""
    precision = np.array([-np.trace(f.covariance[4:7, 4:7]) for f in frames if f.covariance is not None])
    zoom = np.array([f.theta[0] for f in frames if f.theta is not None])
    low, high = zoom.min(), zoom.max()
    bins = np.minimum((ZOOM_BINS * (zoom - low) / max(high - low, 1e-9)).astype(int), ZOOM_BINS - 1)
    order = np.argsort(-precision, kind="stable")
    place = np.zeros(len(frames), dtype=int)
    for k in range(ZOOM_BINS):
        own = order[bins[order] == k]
        place[own] = np.arange(len(own))
    # the best of every zoom first, then every second best
    chosen = np.lexsort((-precision, place))[:maximum]
    return [int(k) for k in np.sort(chosen)]


def problem_of_frame(
    frame: RigFrame,
    theta: Array,
    template: FieldTemplate,
    circle: Circle,
    config: Config,
    *,
    turned: bool = False,
    grown: bool = True,
    field_size: Size = "usual",
) -> Problem:
    """A frame's observations with the standard deviations that its residuals at ``theta`` ask for.

    Parameters
    ----------
    frame : RigFrame
        What was seen.
    theta : (P,) array
        Its camera.
    template, circle, config : FieldTemplate, Circle, Config
        As for :func:`estimate_rigs`.
    turned : bool
        Whether ``theta`` sees the field turned by 180 degrees against the frame's named lines.
    grown : bool
        False: the stated standard deviations, with the model's own.
    field_size : str
        Which size the field is taken to have.
    """
    if frame.observations is None:
        raise ValueError(f"frame {frame.id} came without its observations")
    options = suit_pixels(config, frame.aspect).camera
    model = ProjectionModel(*frame.size, Surface(options.usual_crown, circle.radius_m))
    observations, names, rejected = frame.observations, frame.named_lines, frame.rejected
    if turned:
        observations = turn_names(observations, template)
        names = tuple(find_opposite_line(name, template) for name in names)
        rejected = tuple(replace(key, name=find_opposite(key.name, template)) for key in rejected)
    seen = restore_names(observations, names, theta, template, model).without(rejected)
    noise = noise_model(options, frame.size[0])
    priors = priors_of(options, template, circle, model)
    problem = Problem(
        curves_from_observations(seen, template, noise),
        points_from_observations(seen, template, relief_of(options, template)),
        World(field_size, is_flat=False, share=1.0).priors(priors, priors, template),
        model,
        options.loss_scale,
    )
    if not grown or not options.noise_from_residuals:
        return problem
    feet = sample_feet(problem.curves, theta[None], model)
    state = evaluate(problem, theta[None], feet, updates=4)
    return rescale_sigmas(problem, state)[0]


def restore_names(
    observations: Observations, names: Sequence[str], theta: Array, template: FieldTemplate, model: ProjectionModel
) -> Observations:
    """Give recognised lines back their names: each to the seen line without one that lies where the camera puts it."""
    lines = list(observations.lines)
    for name in names:
        drawn = template.line_by_name[name]
        best, where = SAME_LINE_PX * model.width / 1920.0, -1
        for k, line in enumerate(lines):
            if line.line is not None or len(line.points_px) == 0:
                continue
            curve = line_curve(
                name,
                line.points_px,
                np.ones(len(line.points_px)),
                template.line_ends(drawn),
                template.line_shift(drawn),
            )
            feet = sample_feet(curve, theta[None], model)
            seen = curve_residuals(curve, theta[None], feet, model, updates=4)
            rms = float(np.sqrt(np.mean(seen.values**2)))
            if rms < best and not seen.behind.any():
                best, where = rms, k
        if where >= 0:
            lines[where] = replace(lines[where], line=name)
    return replace(observations, lines=tuple(lines))


def turn_names(observations: Observations, template: FieldTemplate) -> Observations:
    """What was seen, as it is called and where it lies after the field is turned by 180 degrees."""
    circles = (replace(c, circle=find_opposite(c.circle, template)) for c in observations.circles)
    named = (s if s.line is None else replace(s, line=find_opposite(s.line, template)) for s in observations.lines)
    marks = (replace(m, mark=find_opposite(m.mark, template)) for m in observations.marks)
    points = (
        replace(k, field_m=-k.field_m, shift=None if k.shift is None else -k.shift) for k in observations.keypoints
    )
    return replace(
        observations, circles=tuple(circles), lines=tuple(named), marks=tuple(marks), keypoints=tuple(points)
    )


def find_opposite(name: str, template: FieldTemplate) -> str:
    """The marking or mark that lies where another one does after the field is turned by 180 degrees; the name itself
    where none does.
    """
    if name in template.line_by_name:
        return find_opposite_line(name, template)
    centers = {circle.name: circle.center for circle in template.circle_by_name.values()}
    for places in (centers, {mark.name: mark.position for mark in template.marks}):
        for other, place in places.items() if name in places else ():
            if np.abs(np.add(place, places[name])).max() < SAME_PLACE_M:
                return other
    return name


def find_opposite_line(name: str, template: FieldTemplate) -> str:
    """The line that lies where another one does after the field is turned by 180 degrees."""
    ends = -template.line_ends(template.line_by_name[name])
    for line in template.lines:
        other = template.line_ends(line)
        if min(np.abs(other - ends).max(), np.abs(other[::-1] - ends).max()) < SAME_PLACE_M:
            return line.name
    return name


def with_told_relief(config: Config, prior: SharedPrior) -> Config:
    """The configuration with marks on even ground, where other frames show that the field is flat; else the one given.

    A flat field is the crowned one's narrow special case, so the odds are the ratio of what the frames and the priors
    say of no crown at all (Savage-Dickey density ratio: Dickey 1971, Annals of Mathematical Statistics 42, 204).
    """
    camera = config.camera
    if "crown" not in prior.parameters or camera.crown_sd_m == 0.0:
        return config
    place = prior.parameters.index("crown")
    sd = float(np.hypot(np.sqrt(prior.covariance[place, place]), FLAT_SD_M))
    told = _normal_log_density(float(prior.mean[place]), sd) - _normal_log_density(camera.crown_m, camera.crown_sd_m)
    if camera.flat_share * np.exp(told) <= 1.0 - camera.flat_share:
        return config
    even = camera.model_copy(update={"relief_m": FLAT_RELIEF_SHARE * camera.relief_m})
    return config.model_copy(update={"camera": even})


def _normal_log_density(value: float, sd: float) -> float:
    """Logarithm of the density of a normal distribution about 0, without the constant that all have in common."""
    return -0.5 * (value / sd) ** 2 - float(np.log(sd))


def config_with_prior(config: Config, prior: SharedPrior, width: int) -> Config:
    """The configuration for a frame of which other frames say something."""
    config = with_told_relief(config, prior)
    known = {name: k for k, name in enumerate(prior.parameters)}
    # what the configuration fixes is no part of the prior
    position, spread = np.array(config.camera.position_m or np.zeros(3)), np.array(config.camera.position_sd_m)
    free = [axis for axis, name in enumerate("xyz") if name in known]
    place = [known["xyz"[axis]] for axis in free]
    position[free] = prior.mean[place]
    spread[free] = prior.frame_sd[place]
    side = side_of_place(position)
    camera = config.camera.model_copy(
        update={
            "shared": SharedPriorConfig.of(prior, width),
            "position_m": tuple(float(v) for v in position),
            "position_sd_m": tuple(float(v) for v in spread),
            "others": (),
        }
    )
    correspondences = config.correspondences.model_copy(update={"camera_side": side})
    return config.model_copy(update={"camera": camera, "correspondences": correspondences})


def prior_chi_square(prior: SharedPrior, theta: Array) -> float:
    """How far a camera lies from what the others say: squared, in standard deviations, over all shared parameters."""
    values, _ = prior.residuals(theta[None])
    return float(values[0] @ values[0])


def summarise_shared(rig: Rig) -> dict[str, tuple[float, float]]:
    """Means and standard deviations of the shared parameters, and of their changes with the zoom."""
    prior = rig.prior()
    names = (*prior.parameters, *(f"{name} by zoom" for name in prior.zoomed))
    sigma = np.sqrt(np.diag(prior.covariance))
    return {name: (float(m), float(s)) for name, m, s in zip(names, prior.mean, sigma, strict=True)}
