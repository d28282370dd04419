"""How likely a picture is, and the equations of the most likely motion.

A pixel shows g B + o + alpha (F - g B - o): the background B in a light that may have changed by a
gain g and an offset o in each channel, behind the ball F for the share alpha of the exposure. Only
a noisy picture G of the background is known. Of all backgrounds the likeliest given both pictures
is taken for each pixel, which makes the cost the squared residual over v_shot + (1 - alpha)^2 g^2
v_background; its exact gradient is that of B held there. [derived]
"""

from dataclasses import dataclass

import torch
from torch import Tensor

from toolkit.least_squares import solve_information
from toolkit.sweep.colours import BallColours
from toolkit.sweep.model import Coverage, SweepModel
from toolkit.sweep.pixels import Beside, StreakPixels
from toolkit.sweep.shade import Shaded

HUBER = 3.5
"""Standard deviations beyond which a pixel's misfit counts linearly."""
GAIN_STD = 0.02
"""Prior standard deviation of the background's gain, about 1."""
OFFSET_STD = 0.005
"""The same of its offset, about 0, shares of white: both are known from beside the streak."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Comparison:
    """Model against picture for all N pixels."""

    cost: float
    gradient: Tensor  # [P] half of the cost's
    information: Tensor  # [P, P]
    residual: Tensor  # [Q, N] in standard deviations; 0 where nothing was measured
    coverage: Coverage
    contrast: Tensor  # [Q, N] of ball and background, over the standard deviation
    light: Tensor  # [Q, N] of the ball before each pixel, over the standard deviation
    J: tuple[Tensor, ...]  # for each channel [P_q, N], whitened
    columns: tuple[Tensor, ...]  # for each channel the parameters [P_q] these belong to

    @property
    def weight(self) -> Tensor:
        """Root of what each pixel counts for [Q, N], less than 1 where it is far off."""
        return (HUBER / self.residual.abs().clamp_min(HUBER)).sqrt()

    @property
    def pull(self) -> Tensor:
        """How much each pixel wants the opacity to rise [N], times `hold`."""
        return (self.residual * self.contrast).sum(0)

    @property
    def hold(self) -> Tensor:
        """Information of each pixel about its opacity [N]."""
        return (self.contrast * self.contrast).sum(0)

    def answer(self, change: Tensor) -> Tensor:
        """Give the change of the parameters [..., P] that a change of the whitened picture causes.

        Args:
            change: of the pixels, in standard deviations [..., Q, N].
        """
        pull = torch.zeros(*change.shape[:-2], len(self.gradient), dtype=torch.float64)
        for q, (J, at) in enumerate(zip(self.J, self.columns, strict=True)):
            pull[..., at] += change[..., q, :] @ J.mT
        return solve_information(self.information, pull)

    def step(
        self, damping: float = 0.0, held: tuple[int, float] | None = None
    ) -> tuple[Tensor, float]:
        """Give the Gauss-Newton step [P] and the chi-square that it promises.

        Args:
            damping: of the information scaled to a unit diagonal.
            held: a parameter and the step that it must take.
        """
        if held is None:
            step = solve_information(self.information, -self.gradient, damping)
            return step, float(-step @ self.gradient)
        index, size = held
        free = torch.arange(len(self.gradient)) != index
        pull = -self.gradient - self.information[:, index] * size
        step = torch.full_like(self.gradient, size)
        step[free] = solve_information(self.information[free][:, free], pull[free], damping)
        return step, float(step @ (-2 * self.gradient - self.information @ step))


def compare(
    model: SweepModel,
    x: Tensor,
    pixels: StreakPixels,
    *,
    covered: Coverage | None = None,
    huber: float = HUBER,
) -> Comparison:
    """Compare the model of parameters [P] with the pixels, whose opacity may be known already."""
    _, _, _, gain, offset = model.split(x)
    gains = torch.cat([gain - 1, offset])
    covered = covered or model.opacity(x, pixels)
    alpha, rest = covered.alpha, 1 - covered.alpha
    gain, offset = gain[:, None], offset[:, None]
    lit = pixels.ground * gain + offset
    empty = pixels.ground_variance * gain
    ball = model.colours(x, pixels, covered)
    residual = pixels.signal - lit - alpha * (ball.colour - lit) - pixels.mixed
    precision = 1 / (pixels.shot_variance + rest**2 * gain * empty)  # 0 where nothing was measured
    root = precision.sqrt()
    z = residual * root
    size = z.abs()
    cost = float((size * size).sum())
    is_far = size > huber
    if bool(is_far.any()):
        far = size[is_far]
        cost += float((huber * (2 * far - huber) - far * far).sum())
        root[is_far] *= (huber / far).sqrt()

    # derivatives hold the likeliest background
    likeliest = pixels.ground + empty * rest * residual * precision
    contrast = ball.colour - likeliest * gain - offset
    J_chord = None
    if ball.slopes is not None:
        J_chord = model.J_chord(x, pixels, covered, len(ball.slopes))
    channels, shared = len(pixels.signal), model.path.size + 1 + model.unknowns
    gradient = torch.zeros(len(x), dtype=torch.float64)
    information = torch.zeros(len(x), len(x), dtype=torch.float64)
    J = _whitened_J(covered, ball, J_chord, contrast, likeliest, root)
    pulls, grams = (J @ (residual * root)[..., None])[..., 0], J @ J.mT
    columns = []
    for q in range(channels):
        at = torch.tensor([*range(shared), shared + q, shared + channels + q])
        information[at[:, None], at] += grams[q]
        gradient[at] -= pulls[q]
        columns.append(at)
    cost += _add_beside(gradient, information, pixels.beside, gains)
    cost += _add_priors(gradient, information, gains)
    if isinstance(model.estimator, Shaded):
        last = slice(shared - model.estimator.shades, shared)
        cost += _add_shade_prior(gradient, information, x[last], last, model.shade_std)
    found = Comparison(
        cost=cost,
        gradient=gradient,
        information=information,
        residual=z,
        coverage=covered,
        contrast=contrast * precision.sqrt(),
        light=alpha * ball.colour * precision.sqrt(),
        J=tuple(J),
        columns=tuple(columns),
    )
    if model.cells is None:
        return found
    return model.cells.freed(found)


def _whitened_J(
    covered: Coverage,
    ball: BallColours,
    J_chord: Tensor | None,
    contrast: Tensor,
    ground: Tensor,
    root: Tensor,
) -> Tensor:
    """Give the whitened derivatives of each channel [Q, K + 1 + A + 2, N].

    They are those in path and spread, in the appearance, in gain and in offset; `root` whitens.
    """
    alpha, size = covered.alpha, len(covered.J)
    unknowns = 0 if ball.design is None else ball.design.shape[1]
    J = torch.empty(len(root), size + unknowns + 2, len(alpha), dtype=torch.float64)
    torch.mul(covered.J, (contrast * root)[:, None], out=J[:, :size])
    seen = alpha * root
    if J_chord is not None and ball.slopes is not None:
        for slope, J_number in zip(ball.slopes, J_chord, strict=True):
            J[:, : size - 1] += (slope * seen)[:, None] * J_number
    if ball.by_spread is not None:
        J[:, size - 1] += ball.by_spread * seen
    if ball.design is not None:
        torch.mul(ball.design, seen[:, None], out=J[:, size:-2])
    torch.mul(1 - alpha, root, out=J[:, -1])
    torch.mul(J[:, -1], ground, out=J[:, -2])
    return J


def _add_beside(gradient: Tensor, information: Tensor, beside: Beside, gains: Tensor) -> float:
    """Add what the pixels beside the streak say of gain and offset; return what they cost."""
    last = len(gains)
    gradient[-last:] += beside.gradient + beside.information @ gains
    information[-last:, -last:] += beside.information
    return beside.cost + float(gains @ (2 * beside.gradient + beside.information @ gains))


def _add_priors(gradient: Tensor, information: Tensor, gains: Tensor) -> float:
    """Hold gains about 1 and offsets about 0, weakly; return what this costs."""
    half = len(gains) // 2
    precision = torch.tensor([GAIN_STD**-2] * half + [OFFSET_STD**-2] * half, dtype=torch.float64)
    gradient[-2 * half :] += gains * precision
    information.diagonal()[-2 * half :] += precision
    return float(gains @ (gains * precision))


def _add_shade_prior(
    gradient: Tensor, information: Tensor, shade: Tensor, place: slice, std: float
) -> float:
    """Hold a shade about none; return what this costs."""
    gradient[place] += shade / std**2
    information.diagonal()[place] += std**-2
    return float(shade @ shade) / std**2
