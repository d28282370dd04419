"""What each stage hands to the next: frozen dataclasses, shapes in the field comments.

path -> LinearImage -> Streak -> Profiles -> ProfileFit -> Contours -> CrossSections -> Trajectory

Axis letters: B image, P profile, S sample along it, Q signal channel, N point, H row, W column.
Pixels are (x, y) with (0, 0) at the CENTRE of the top-left pixel; the camera frame is x right, y
down, z forward with its origin at the viewpoint; metres, seconds, radians; light is linear, sensor
white = 1.
"""

from dataclasses import dataclass, replace
from enum import IntFlag
from typing import cast, overload

import torch
from torch import Tensor

from toolkit.box_filter import box_mean
from toolkit.demosaicing import Pattern, demosaic, reach
from toolkit.errors import ShapeError
from toolkit.response import CurveDoubt


class ProfileFlag(IntFlag):
    """Why a single profile is not used; 0 means it is good."""

    GOOD = 0
    NOT_CONVERGED = 1
    """The fit did not settle."""
    CLIPPED = 2
    """The profile meets saturated pixels or leaves the picture."""
    LOW_CONTRAST = 4
    """The opacity is not clearly above its own standard deviation."""
    AT_BOUND = 8
    """Half width or opacity ended outside its physical range."""
    END = 16
    """The profile touches the ball's first or last image, where no semi-ellipse is expected."""
    OUTLIER = 32
    """The fit disagrees with its neighbours."""


class Colours:
    """The field `rgb` of a picture: what was given, else its mosaic demosaiced at first need.

    Most of a RAW shot is looked at only as the sensor measured it, and its colours would take three
    times its memory.
    """

    @overload
    def __get__(self, image: None, owner: type) -> None: ...
    @overload
    def __get__(self, image: "LinearImage", owner: type) -> Tensor: ...
    def __get__(self, image: "LinearImage | None", owner: type) -> Tensor | None:
        """Give the colours, or the field's default where the class itself is asked."""
        if image is None:
            return None
        if image.__dict__["rgb"] is None and image.mosaic is not None and image.pattern is not None:
            image.__dict__["rgb"] = _fill_in(image.mosaic, image.pattern)
        return cast(Tensor, image.__dict__["rgb"])

    def __set__(self, image: "LinearImage", rgb: Tensor | None) -> None:
        """Keep what is given."""
        image.__dict__["rgb"] = rgb


@dataclass(frozen=True, kw_only=True)
class LinearImage:
    """A picture in linear light, in sensor orientation, white = 1.

    Made of `rgb`, or of a `mosaic` and its `pattern`, from which `rgb` is filled in when somebody
    asks for it.
    """

    rgb: Colours = Colours()  # [B, 3, H, W] float32
    clipped: Tensor  # [B, 1, H, W] bool, True where any channel met white
    exposure: Tensor | None = None  # [B] s, None when the file does not tell
    mosaic: Tensor | None = None  # [B, 1, H, W] float32, as measured; beside it rgb is derived
    pattern: Pattern | None = None  # the mosaic's period: channel 0 R, 1 G, 2 B
    # left, top of this picture in its full frame, and that frame's width, height; None when the
    # file holds no larger frame
    crop: tuple[int, int, int, int] | None = None
    response: str = "linear"  # how stored brightness became light
    response_is_assumed: bool = False  # nobody named it, it was guessed from the file kind
    curve_doubt: CurveDoubt | None = None  # how a measured response may err; None: not measured
    frames: float = 1  # how many pictures were combined into this one (noise is smaller by that)

    def __post_init__(self) -> None:
        if self.__dict__["rgb"] is None and (self.mosaic is None or self.pattern is None):
            raise ShapeError("a picture needs rgb, or a mosaic and its pattern; give one of them")

    def measured(self) -> Tensor | None:
        """Say which channels were measured at each pixel [1, 3, H, W] bool; None when all were."""
        if self.mosaic is None or self.pattern is None:
            return None
        period = torch.tensor(self.pattern)
        repeats = [-(-side // len(period)) for side in (self.height, self.width)]
        measured = torch.stack([period == channel for channel in range(3)]).repeat(1, *repeats)
        return measured[None, :, : self.height, : self.width]

    def window(self, left: int, top: int, width: int, height: int) -> "LinearImage":
        """Cut out a part of the picture; its mosaic's pattern starts at the new corner."""
        area = (..., slice(top, top + height), slice(left, left + width))
        pattern = self.pattern
        if pattern is not None:
            rows = [pattern[(top + y) % len(pattern)] for y in range(len(pattern))]
            pattern = tuple(tuple(r[(left + x) % len(r)] for x in range(len(r))) for r in rows)
        return replace(
            self,
            rgb=self._colours_in(left, top, width, height),
            clipped=self.clipped[area],
            mosaic=None if self.mosaic is None else self.mosaic[area],
            pattern=pattern,
            crop=None,
        )

    def _colours_in(self, left: int, top: int, width: int, height: int) -> Tensor:
        """Cut out colours; where nobody needed all of them yet, only these are filled in."""
        rgb, mosaic, pattern = self.__dict__["rgb"], self.mosaic, self.pattern
        if rgb is None and mosaic is not None and pattern is not None:
            # from a whole number of periods before the part, so that the pattern stays
            step, margin = len(pattern), reach(pattern)
            first_row, first_column = (max(0, x - margin) // step * step for x in (top, left))
            rows = slice(first_row, top + height + margin)
            columns = slice(first_column, left + width + margin)
            rgb = _fill_in(mosaic[..., rows, columns], pattern)
            top, left = top - first_row, left - first_column
        return cast(Tensor, rgb[..., top : top + height, left : left + width])

    @property
    def recorded(self) -> Tensor:
        """What was recorded: the mosaic [B, 1, H, W], or colours where there is none."""
        return self.rgb if self.mosaic is None else self.mosaic

    def remade(
        self, recorded: Tensor, *, clipped: Tensor | None = None, frames: float | None = None
    ) -> "LinearImage":
        """Give the picture with other `recorded` values; its colours follow them."""
        return replace(
            self,
            rgb=recorded if self.mosaic is None else None,
            mosaic=None if self.mosaic is None else recorded,
            clipped=self.clipped if clipped is None else clipped,
            frames=self.frames if frames is None else frames,
        )

    @property
    def width(self) -> int:
        """Columns."""
        return self.clipped.shape[-1]

    @property
    def height(self) -> int:
        """Rows."""
        return self.clipped.shape[-2]


def _fill_in(mosaic: Tensor, pattern: Pattern) -> Tensor:
    """Demosaic pictures [B, 1, H, W] into [B, 3, H, W]."""
    colours = [torch.from_numpy(demosaic(one, pattern))[None] for one in mosaic[:, 0].numpy()]
    return colours[0] if len(colours) == 1 else torch.cat(colours)


@dataclass(frozen=True, slots=True, kw_only=True)
class NoiseModel:
    """Variance of one raw sample as a function of its level: read_variance + gain * level.

    `density` is the share of the pixels at which the sensor measured a channel (1/4, 1/2, 1/4
    behind a Bayer mosaic, 1 without one): demosaicing smooths the noise but adds no information, so
    that sums over many interpolated samples have the variance of raw samples divided by the
    density.
    """

    read_variance: Tensor  # [B, 3]
    gain: Tensor  # [B, 3]
    density: Tensor  # [3]

    def variance(self, level: Tensor, measured: Tensor | None = None) -> Tensor:
        """Give the variance per sample at `level` [B, 3, H, W], same shape.

        The level is averaged over 5 x 5 pixels first: a weight that follows the noise of its own
        pixel pulls every sum towards darker values.

        Args:
            level: picture whose noise is asked for.
            measured: channels the sensor measured at each pixel [1, 3, H, W] bool; elsewhere the
                variance is infinite, and the rest counts as raw samples.
        """
        # within the means, which nobody else holds: pictures are large
        means = box_mean(level, 5).clamp_min_(0)
        density = torch.ones(3) if measured is not None else self.density
        read, gain = (
            (v / density)[..., None, None].to(level.dtype) for v in (self.read_variance, self.gain)
        )
        variance = means.mul_(gain).add_(read)
        return variance if measured is None else torch.where(measured, variance, torch.inf)


@dataclass(frozen=True, slots=True, kw_only=True)
class Streak:
    """Where the ball's trail lies in the picture, and its rough axis."""

    mask: Tensor  # [B, 1, H, W] bool
    axis: Tensor  # [B, N, 2] px, from one tip to the other at equal spacing
    half_width: Tensor  # [B] px, rough
    travel: Tensor  # [B] px that the ball's centre went, rough: mostly a tenth to a third short

    @property
    def widths(self) -> float:
        """How many of its own widths the ball went, in the first picture."""
        return float(self.travel[0] / (2 * self.half_width[0]))


@dataclass(frozen=True, slots=True, kw_only=True)
class Profiles:
    """Pixels about the streak, sorted into lines across it.

    B picture, P profile, S place in it, Q signal channel.
    """

    origin: Tensor  # [B, P, 2] px, on the axis
    normal: Tensor  # [B, P, 2] unit, to the right of the motion along the axis
    position: Tensor  # [B, P] px, arc length of the origin along the axis
    offset: Tensor  # [B, P, S] px of the pixel from the origin, along the normal
    signal: Tensor  # [B, P, S, Q] what the estimator observed
    ground: Tensor  # [B, P, S, Q] the same without the ball
    smooth_ground: Tensor  # [B, P, S, Q] the ground averaged over pixels around, without its own
    variance: Tensor  # [B, P, S, Q] infinite where a channel was not measured
    is_filled: Tensor  # [B, P, S] bool, False where a profile has fewer pixels than others
    valid: Tensor  # [B, P, S] bool, False where clipped as well

    @property
    def direction(self) -> Tensor:
        """Angle of the motion in the image, radians, [B, P]."""
        return torch.atan2(-self.normal[..., 0], self.normal[..., 1])


@dataclass(frozen=True, slots=True, kw_only=True)
class Appearance:
    """What is known of a ball's looks that its estimator leaves open."""

    values: Tensor  # [A], as `AlphaEstimator.settled` takes them
    std: float  # of a guess; of what was fitted on, the one before the fit
    opacity_std: float  # relative: the error that all opacities share because of it


@dataclass(frozen=True, slots=True, kw_only=True)
class ProfileFit:
    """The semi-ellipse that fits each profile best."""

    origin: Tensor  # [B, P, 2] px, as in Profiles
    normal: Tensor  # [B, P, 2] unit
    position: Tensor  # [B, P] px
    centre: Tensor  # [B, P] px, offset of the semi-ellipse's centre along the normal
    half_width: Tensor  # [B, P] px
    opacity: Tensor  # [B, P] alpha at the centre
    skew: Tensor  # [B, P] relative rise of alpha from the centre to the right edge
    covariance: Tensor  # [B, P, 3, 3] of (centre, half_width, opacity)
    chi2_per_dof: Tensor  # [B, P]
    flags: Tensor  # [B, P] int64, bits of ProfileFlag
    blur: Tensor  # [B] px, standard deviation of everything that smooths a profile
    samples: Tensor  # [B, P] numbers compared in each profile
    iterations: int
    appearance: Appearance | None = None  # what the fit found of the ball's looks
    common_misfit: float = 1.0  # of all profiles alike, in variances of their mean; 1 is noise

    @property
    def good(self) -> Tensor:
        """Profiles without any flag, [B, P] bool."""
        return self.flags == 0

    @property
    def middle(self) -> Tensor:
        """Centre points, [B, P, 2] px."""
        return self.origin + self.centre[..., None] * self.normal

    @property
    def edges(self) -> Tensor:
        """Left and right edge points, [B, P, 2, 2] px."""
        ends = torch.stack([self.centre - self.half_width, self.centre + self.half_width], dim=-1)
        return self.origin[..., None, :] + ends[..., None] * self.normal[..., None, :]


@dataclass(frozen=True, slots=True, kw_only=True)
class Contours:
    """The two smooth outlines of one streak; side 0 is left of the axis, 1 right of it."""

    position: Tensor  # [N] px along the axis
    points: Tensor  # [2, N, 2] px
    tangents: Tensor  # [2, N, 2] unit, along the axis
    std: Tensor  # [2, N] px, across the contour
    opacity: Tensor  # [N]
    order: int  # coefficients a contour needed: 2 a line, 3 second order, more a spline


@dataclass(frozen=True, slots=True, kw_only=True)
class CrossSections:
    """Where the ball was, one entry for every pair of coupled contour points."""

    centre: Tensor  # [N, 3] m
    direction: Tensor  # [N, 3] unit
    opacity: Tensor  # [N]
