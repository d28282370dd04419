"""From the path, the opacity along it and the streak's ends to the ball's motion in time."""

import math
from dataclasses import dataclass, replace

import numpy as np
import torch
from torch import Tensor

from toolkit.alpha import AlphaEstimator
from toolkit.axis_curve import AxisFit, graze_residual, to_centre, whitening
from toolkit.camera import Camera
from toolkit.contours import length_in_widths
from toolkit.ends import Ends, Surroundings, locate_ends, rough_ends
from toolkit.errors import ConfigError
from toolkit.flight import (
    SIZE,
    STRAIGHT,
    FlightFit,
    Sightings,
    fit_flight,
    levelled,
    see_ends,
    start_flight,
    with_known_opacity,
)
from toolkit.flight_camera import answer_to_camera
from toolkit.motion import (
    DURATION,
    RATE_SIZES,
    Motion,
    OpacityData,
    Pace,
    describe_motion,
    fit_pace,
    make_clock,
    noise_covariance,
    pace_samples,
)
from toolkit.reconstruction import along_axis, edges_of, middle_points
from toolkit.splines import up_to
from toolkit.types import Contours, ProfileFit
from toolkit.view import StreakView

FLIGHT_SIZE = 8
"""What profiles tell of a flight and the duration: when it began and ended, only the ends tell."""
END_ROUNDS = 2
"""How often the ends are located on a flight, and it is fitted to them."""
CLOCK_MARGIN = 4.0
"""Half widths beyond the rough ends up to which time along the path is followed."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Reconstruction:
    """What the streak says about the motion, in the order it was found."""

    fit: ProfileFit
    contours: Contours
    axis: AxisFit
    opacity: OpacityData
    pace: Pace
    ends: Ends
    motion: Motion
    flight: FlightFit | None = None  # where the motion is one of constant acceleration, or none
    opacity_std: float = 0.0  # relative, shared by all opacities and not yet in `flight`


def follow_motion(
    view: StreakView,
    estimator: AlphaEstimator,
    camera: Camera,
    ball_radius: float,
    fit: ProfileFit,
    contours: Contours,
    axis: AxisFit,
) -> Reconstruction:
    """Find how fast the ball went along its path, and where the exposure began and ended."""
    opacity = opacity_data(fit, along_axis(fit, camera), camera)
    pace_sizes = up_to(1 + length_in_widths(fit) / 1.5, RATE_SIZES)
    pace = fit_pace(axis.curve, opacity, ball_radius, pace_sizes)
    half_width = float(fit.half_width[fit.good].median())
    s, position = opacity.s.numpy(), fit.position[0].numpy()
    first, last = (float(np.interp(end, position, s)) for end in rough_ends(fit))
    reach = CLOCK_MARGIN * half_width
    clock, rate = make_clock(axis.curve, pace, first - reach, last + reach)
    pixels = surroundings(view, estimator)
    ends = locate_ends((first, last), axis.curve, clock, rate, pixels, camera, ball_radius)
    found = Reconstruction(
        fit=fit,
        contours=contours,
        axis=axis,
        opacity=opacity,
        pace=pace,
        ends=ends,
        motion=describe_motion(axis.curve, pace, ends.s),
    )
    found = follow_flight(found, pixels, camera, ball_radius)
    return found if found.flight or fit.appearance is None else scale_opacity(found, ball_radius)


def scale_opacity(found: Reconstruction, ball_radius: float) -> Reconstruction:
    """Let the distance between the ends correct opacities whose scale was found in the fit.

    Wherever the ball's colour is unknown all opacities share an error, and so do all speeds told by
    them; but the way between the ends took one exposure. Both weigh by their variances. [derived]
    """
    covariance = noise_covariance(
        found.axis, found.opacity, found.pace, found.ends.s, found.ends.std, ball_radius
    )
    by_ends, by_colour = float(covariance[DURATION, DURATION]), opacity_doubt(found.fit) ** 2
    trust = by_colour / (by_colour + by_ends)
    scale = 1 + trust * (float(found.motion.duration) - 1)
    pace = replace(found.pace, coefficients=found.pace.coefficients / scale)
    opacity = replace(found.opacity, opacity=found.opacity.opacity / scale)
    return replace(
        found,
        opacity=opacity,
        pace=pace,
        motion=describe_motion(found.axis.curve, pace, found.ends.s),
        opacity_std=(trust * by_ends) ** 0.5,
    )


def opacity_doubt(fit: ProfileFit) -> float:
    """Give the relative standard deviation that all opacities share by what was open in the fit."""
    return 0.0 if fit.appearance is None else fit.appearance.opacity_std


def follow_flight(
    found: Reconstruction, pixels: Surroundings, camera: Camera, ball_radius: float
) -> Reconstruction:
    """Take the motion for a free flight where that explains all profiles as well.

    "As well" by the Bayesian information criterion. The ends are then located anew, since the
    flight tells better than the splines how path and pace go on there.
    """
    curve, pace = found.axis.curve, found.pace
    seen = _sightings(found, camera, ball_radius)
    if curve.is_line and pace.basis.size == 1:
        return _follow_straight_flight(found, seen, camera, ball_radius)
    spline_chi2 = _spline_chi2(found, seen, camera, ball_radius)
    spline_size = len(curve.parameters) + pace.basis.size
    scale = max(spline_chi2 / seen.count, 1.0)

    def explains(fit: FlightFit) -> bool:
        gain = (fit.chi2 - spline_chi2) / scale
        return fit.converged and gain < math.log(seen.count) * (spline_size - FLIGHT_SIZE)

    fit = fit_flight(start_flight(found.motion), seen, camera, ball_radius)
    for _ in range(END_ROUNDS):
        if not explains(fit):
            return found
        ends = locate_ends(
            (-0.5, 0.5), fit.flight, _flight_clock, torch.ones_like, pixels, camera, ball_radius
        )
        end, along, std = see_ends(fit.flight, ends, camera)
        seen = replace(seen, end=end, end_along=along, end_std=std)
        fit = fit_flight(fit.flight, seen, camera, ball_radius)
    if not explains(fit):
        return found
    fit = levelled(with_known_opacity(fit, opacity_doubt(found.fit)))
    return replace(found, motion=fit.motion(), flight=fit)


def _follow_straight_flight(
    found: Reconstruction, seen: Sightings, camera: Camera, ball_radius: float
) -> Reconstruction:
    """Fit a line passed at constant speed to contours and opacity at once.

    How the opacity changes along the streak tells its tilt as well as the contours do.
    """
    fit = fit_flight(start_flight(found.motion), seen, camera, ball_radius, size=STRAIGHT)
    if not fit.converged:
        return found
    fit = with_known_opacity(fit, opacity_doubt(found.fit))
    return replace(found, motion=fit.motion(), flight=fit)


def flight_answer(found: Reconstruction, camera: Camera, ball_radius: float) -> Tensor:
    """Give how the flight's coefficients and duration follow the camera's parameters [10, 4 + K].

    Raises:
        ConfigError: when the motion found is no flight.
    """
    if found.flight is None:
        raise ConfigError("the motion is no flight; refit its path through another camera instead")
    size = STRAIGHT if found.axis.curve.is_line else SIZE
    return answer_to_camera(found.flight, camera, ball_radius, opacity_doubt(found.fit), size)


def surroundings(view: StreakView, estimator: AlphaEstimator) -> Surroundings:
    """Give the pixels about the streak such that their opacity is without bias.

    The ground is that of the neighbours: with its own noise in both contrast and signal a pixel
    would look covered a little, by noise over contrast, squared.
    """
    seen, around = view.observation, view.smooth_ground
    return Surroundings(
        estimator=estimator,
        signal=(seen.signal - seen.ground + around)[0],
        ground=around[0],
        variance=seen.variance[0],
        corner=view.corner,
    )


def opacity_data(fit: ProfileFit, s: Tensor, camera: Camera) -> OpacityData:
    """Gather what the pace is found from."""
    return OpacityData(
        s=s,
        rays=camera.unproject(middle_points(fit)),
        opacity=fit.opacity[0],
        covariance=fit.covariance[0],
        weight=fit.good[0].to(torch.float64),
    )


def _sightings(found: Reconstruction, camera: Camera, ball_radius: float) -> Sightings:
    """Gather what tells of a flight; profiles whose opacity lies far off the pace count less."""
    data, ends = found.opacity, found.ends
    _, factor = pace_samples(found.axis.curve, data, ball_radius)
    variance = data.covariance[:, 2, 2] * factor**2
    weight = torch.where(data.weight > 0, found.pace.weight * variance, 0)
    end, along, std = see_ends(found.axis.curve, ends, camera)
    return Sightings(
        edges=edges_of(found.fit, data.s),
        opacity=replace(data, weight=weight),
        time=(data.s - ends.s[0]) / (ends.s[1] - ends.s[0]) - 0.5,
        end=end,
        end_along=along,
        end_std=std,
    )


def _spline_chi2(
    found: Reconstruction, seen: Sightings, camera: Camera, ball_radius: float
) -> float:
    """Chi-square of the profiles about path and pace, counted as for a flight."""
    rays, swing = seen.edges.rays(camera)
    sides, _ = graze_residual(found.axis.curve, seen.edges.s, rays, swing, ball_radius)
    samples, factor = pace_samples(found.axis.curve, seen.opacity, ball_radius)
    exposures = found.pace.basis(seen.edges.s) @ found.pace.coefficients
    dimmer = (samples - exposures) / factor
    profiles = torch.cat([to_centre(sides), dimmer[:, None]], dim=1)[..., None]
    whiten = whitening(seen.opacity.covariance, seen.opacity.weight)
    return float(((whiten @ profiles) ** 2).sum())


def _flight_clock(time: Tensor) -> Tensor:
    return time + 0.5
