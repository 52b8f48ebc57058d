"""Options of the passes over a picture: a quick one, a thorough one, one for flat ellipses."""

from __future__ import annotations

from circlecal.detection.options import DetectorConfig

__all__ = ["flat", "quick", "thorough"]


def quick(config: DetectorConfig) -> DetectorConfig:
    """Options of the first pass: a smaller picture and fewer hypotheses."""
    first, drawn = config.first_pass, config.hypotheses
    draws, scored = max(100, int(first.effort * drawn.draws)), max(10, int(first.effort * drawn.scored))
    return config.model_copy(
        update={
            "detection_width_px": min(first.width_px, config.detection_width_px),
            "hypotheses": drawn.model_copy(update={"draws": draws, "scored": scored}),
        }
    )


def thorough(config: DetectorConfig) -> DetectorConfig:
    """Options of the second pass: fainter ridges, and more and more patient search among more of them."""
    second = config.second_pass
    ridges = config.ridges.model_copy(update={"threshold": min(config.ridges.threshold, second.threshold)})
    drawn = config.hypotheses
    hypotheses = drawn.model_copy(
        update={
            "draws": second.effort * drawn.draws,
            "scored": second.effort * drawn.scored,
            "kept": second.effort * drawn.kept,
        }
    )
    candidates = second.effort * config.candidates
    return config.model_copy(
        update={"ridges": ridges, "hypotheses": hypotheses, "candidates": candidates, "near_points": True}
    )


def flat(config: DetectorConfig) -> DetectorConfig:
    """Options of the last pass: more pixels, and flatter ellipses."""
    second = thorough(config)
    lowest = min(config.second_pass.flattest, config.hypotheses.axis_ratio[0])
    hypotheses = second.hypotheses.model_copy(update={"axis_ratio": (lowest, config.hypotheses.axis_ratio[1])})
    width = max(config.second_pass.flat_width_px, config.detection_width_px)
    return second.model_copy(update={"hypotheses": hypotheses, "detection_width_px": width, "near_points": False})
