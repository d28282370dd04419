"""The streak's surroundings in shot and background, in the same light, with their noise."""

from dataclasses import dataclass

import torch
from torch import Tensor

from toolkit.alpha import AlphaEstimator, Observation, observe_colours
from toolkit.background import estimate_noise, sample_pair, scale_background
from toolkit.box_filter import ring_mean
from toolkit.clear_pixels import around, clear_light, is_changed, is_lit_otherwise
from toolkit.errors import StreakError
from toolkit.overview import Overview
from toolkit.scene_match import check_light, check_same_scene
from toolkit.streak import ROI, find_streak
from toolkit.types import LinearImage, NoiseModel, Streak

FIRST_SAMPLES = 10_000
"""Pixels a channel whose noise and light are looked at to find the streak."""
WINDOW = 2.5
"""Half widths around the axis that the window holds, and 8 px more."""


@dataclass(frozen=True, slots=True, kw_only=True)
class StreakView:
    """The streak and the window about it, as the estimator sees it."""

    streak: Streak
    observation: Observation  # on the window
    smooth_ground: Tensor  # of the observation, about each pixel and without it
    shot: LinearImage  # the window itself
    background: LinearImage  # in the shot's light
    noise: NoiseModel
    clipped: Tensor  # [1, 1, h, w] bool, on the window
    corner: tuple[int, int]  # of the window in the picture, (x, y) px
    drift: Tensor  # [3] light of the shot over that of the background; 1 where it was left alone

    def colours(self) -> Observation:
        """Give what was observed in R,G,B, whatever the estimator looks at."""
        return observe_colours(self.shot, self.background, self.noise)


def observe_streak(
    image: LinearImage,
    background: LinearImage,
    estimator: AlphaEstimator,
    roi: ROI | None = None,
) -> StreakView:
    """Find the streak, match the background's light to the shot's, and observe the surroundings.

    Noise and light are looked at twice: roughly to find the streak, then without the pixels it
    covers.

    Raises:
        MismatchError: when the two pictures do not show the same scene from the same place.
        StreakError: when there is no streak, or it leaves the picture.
        ConfigError: when the region lies outside the picture.
    """
    overview = Overview.of(image, background)
    streak = _roughly_lit_streak(image, background, overview, estimator, roi)
    ignore = around(streak)
    samples = sample_pair(image, background, ignore)
    drift, std = samples.drift_and_std()
    if is_changed(drift, std):
        background, overview = scale_background(background, drift), overview.lit(drift)
        noise = estimate_noise(image, background, ignore)
        streak = find_streak(image, background, noise, estimator, roi, overview)
    else:
        drift = torch.ones_like(drift)
        noise = samples.noise()
    _check_inside(streak, image)
    left, top, width, height = _window(streak, image)
    shot, ground = (picture.window(left, top, width, height) for picture in (image, background))
    observation = estimator.observe(shot, ground, noise)
    return StreakView(
        streak=streak,
        observation=observation,
        smooth_ground=ring_mean(observation.ground),
        shot=shot,
        background=ground,
        noise=noise,
        clipped=shot.clipped | ground.clipped,
        corner=(left, top),
        drift=drift,
    )


def _roughly_lit_streak(
    image: LinearImage,
    background: LinearImage,
    overview: Overview,
    estimator: AlphaEstimator,
    roi: ROI | None,
) -> Streak:
    """Find the streak in the light that most of the picture tells, with the noise of all of it."""
    samples = sample_pair(image, background, least=FIRST_SAMPLES)
    check_light(samples.drift())
    light, std = clear_light(overview.image, overview.background)
    if is_lit_otherwise(overview.image, overview.background, light, std):
        background, overview = scale_background(background, light), overview.lit(light)
        samples = sample_pair(image, background)
    check_same_scene(overview.image, overview.background, overview.factor)
    return find_streak(image, background, samples.noise(), estimator, roi, overview)


def _check_inside(streak: Streak, image: LinearImage) -> None:
    """Raise `StreakError` when a tip reaches the picture's border, where an end is not seen."""
    tips = streak.axis[0, [0, -1]]
    size = torch.tensor([image.width - 1, image.height - 1], dtype=tips.dtype)
    room = torch.minimum(tips, size - tips).amin(-1)
    if bool((room < 2).any()):
        x, y = tips[int(room.argmin())].tolist()
        raise StreakError(
            f"the streak leaves the picture near ({x:.0f}, {y:.0f}) px, so that its end is "
            "not seen; aim so that the whole streak is inside, or expose less long"
        )


def _window(streak: Streak, image: LinearImage) -> ROI:
    reach = WINDOW * float(streak.half_width) + 8
    low = (streak.axis[0].amin(0) - reach).floor().clamp_min(0).long().tolist()
    high = (streak.axis[0].amax(0) + reach).ceil().long().tolist()
    right, bottom = min(high[0], image.width), min(high[1], image.height)
    return low[0], low[1], right - low[0], bottom - low[1]
