"""Small rendered streaks, and the exact model of each at its true motion."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from types import SimpleNamespace

import pytest
import torch
from torch import Tensor

from plugins.uniform import Uniform
from toolkit.alpha import AlphaEstimator
from toolkit.sweep.choose import Start
from toolkit.sweep.fit import SweepFit, fit_sweep, outline
from toolkit.sweep.model import SweepModel
from toolkit.sweep.paths import STRAIGHT, SweepPath
from toolkit.sweep.pixels import Frame, StreakPixels
from toolkit.synthetic import NoiseLevel, RenderedShot, benchmark_scene, render_shot

SMALL = {"width_px": 30, "length_widths": 1.5, "heading": 0.4, "noise": NoiseLevel(read=0.01)}


@dataclass(frozen=True, kw_only=True)
class Streak:
    """A rendered shot as the exact model sees it: colours, with the noise that they have."""

    shot: RenderedShot
    estimator: AlphaEstimator

    @property
    def scene(self):
        return self.shot.scene

    @property
    def noise(self) -> float:
        return self.scene.noise.read

    @property
    def travel(self) -> float:
        """Distance of the path's ends, m."""
        first, last = self.points(2)
        return float((last - first).norm())

    def again(self, seed: int) -> "Streak":
        """The same with other noise."""
        return replace(self, shot=self.shot.with_noise(seed))

    def clean(self) -> "Streak":
        """The same without any."""
        still = replace(self.shot.image, rgb=self.shot.clean_image[None])
        empty = replace(self.shot.background, rgb=self.shot.clean_background[None])
        return replace(self, shot=replace(self.shot, image=still, background=empty))

    def points(self, count: int = 65) -> Tensor:
        """True path [count, 3] m, over the exposure of the middle row."""
        low, high = self.scene.own_time(0.5) + self.scene.exposure * torch.tensor([-0.5, 0.5])
        return self.scene.path.position(torch.linspace(low, high, count, dtype=torch.float64))

    def model(self, path: SweepPath = STRAIGHT) -> SweepModel:
        scene, row = self.scene, self.scene.camera.project(self.points(3)[1])[1]
        return SweepModel(
            path=path,
            estimator=self.estimator,
            camera=scene.camera,
            ball_radius=scene.ball_radius,
            row_delay=scene.shutter.row_delay / scene.exposure,
            middle_row=float(row),
        )

    def looks(self) -> Tensor | None:
        known = torch.tensor(self.scene.appearance.colour, dtype=torch.float64)
        return known if self.estimator.unknowns() else None

    def start(self, **changes) -> Start:
        options = {"path": self.points(), "appearance": self.looks(), "blur": 0.76}
        return Start(**(options | changes))

    def truth(self, path: SweepPath = STRAIGHT) -> Tensor:
        """The true parameters [P]: path, spread, colour where it is open, gains and offsets."""
        time = torch.linspace(-0.5, 0.5, 65, dtype=torch.float64)
        spread = torch.tensor([self.scene.blur**2 + 1 / 12], dtype=torch.float64)
        looks = self.looks()
        channels = self.model(path).channels
        return torch.cat(
            [
                path.through(time, self.points()),
                spread,
                spread[:0] if looks is None else looks,
                torch.ones(channels, dtype=torch.float64),
                torch.zeros(channels, dtype=torch.float64),
            ]
        )

    def frame(self) -> Frame:
        light, ground = self.shot.image.rgb[0], self.shot.background.rgb[0]
        variance = torch.full_like(light, self.noise**2)
        return Frame(
            corner=(0, 0),
            usable=~self.shot.image.clipped[0, 0],
            signal=light,
            ground=ground,
            shot_variance=variance,
            ground_variance=variance,
            camera=self.scene.camera,
        )

    def pixels(self, side: int = 1, path: SweepPath = STRAIGHT) -> StreakPixels:
        middle, half_width = outline(self.model(path), self.truth(path))
        return self.frame().about(middle, half_width, side=side)

    def fit(self, path: SweepPath = STRAIGHT) -> SweepFit:
        return fit_sweep(self.model(path), self.truth(path), self.frame(), doubt=1.0)


@pytest.fixture(scope="session")
def streak() -> Callable[..., Streak]:
    """Make a small streak of the benchmark scene; what is given besides goes to it.

    `change` turns the scene into another one before it is rendered.
    """
    made: dict[object, RenderedShot] = {}

    def render(
        estimator: AlphaEstimator | None = None,
        change: Callable[..., object] | None = None,
        seed: int = 3,
        **options: object,
    ) -> Streak:
        key = (change, seed, *sorted(options.items()))
        if key not in made:
            scene = benchmark_scene(seed=seed, **(SMALL | options))
            made[key] = render_shot(scene if change is None else change(scene), seed=seed)
        shot = made[key]
        one = estimator or Uniform(colour=shot.scene.appearance.colour)
        return Streak(shot=shot, estimator=one)

    return render


@pytest.fixture(scope="session")
def differences() -> Callable[..., Tensor]:
    """Central differences of a function of a vector [K], one column for each entry."""

    def differences(function: Callable[[Tensor], Tensor], at: Tensor, steps: Tensor) -> Tensor:
        columns = []
        for index, step in enumerate(steps.tolist()):
            ahead, back = at.clone(), at.clone()
            ahead[index] += step
            back[index] -= step
            columns.append((function(ahead) - function(back)) / (2 * step))
        return torch.stack(columns, dim=-1)

    return differences


@pytest.fixture
def quiet_misfit() -> SimpleNamespace:
    """A misfit that widens nothing."""
    return SimpleNamespace(factor=1.0)
