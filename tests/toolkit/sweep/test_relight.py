from dataclasses import dataclass, replace

import pytest
import torch

from plugins.uniform import Uniform
from toolkit import AlphaEstimator, measure, observe_colours
from toolkit.sweep.relight import joint_light

OFF = (0.02, -0.015, 0.01)


@dataclass(frozen=True, kw_only=True)
class Told(AlphaEstimator):
    """A shaded ball whose colour was told with errors; which is not plain, as those aren't."""

    colour: tuple[float, float, float]
    std: float
    is_open: bool = False
    is_known: bool = False

    def observe(self, image, background, noise):
        return observe_colours(image, background, noise)

    def unknowns(self):
        return 3 if self.is_open else 0

    def foreground(self, chord, appearance):
        colour = torch.tensor(self.colour).to(chord.offset)
        if appearance is not None:
            colour = colour + self.std * appearance.to(colour)
        # a slope of none keeps it from being taken for plain
        return colour.expand(*chord.offset.shape, 3) + 0 * chord.offset[..., None]

    def loosened(self):
        return None if self.is_known else replace(self, is_open=True)


def measured(shot, estimator):
    scene = shot.scene
    return measure(
        shot.image,
        shot.background,
        camera=scene.camera,
        ball_radius=scene.ball_radius,
        exposure=scene.exposure,
        estimator=estimator,
    )


@pytest.fixture
def told(streak):
    r, g, b = streak().scene.appearance.colour
    return Told(colour=(r + OFF[0], g + OFF[1], b + OFF[2]), std=0.02)


def test_light_told_with_errors_is_set_right_by_the_streak(streak, told):
    shot = streak().shot
    loose, blind = (measured(shot, one) for one in (told, replace(told, is_known=True)))
    error = torch.tensor(loose.position_m) - shot.position
    assert float((error.abs() / torch.tensor(loose.position_std_m)).max()) < 3
    codes = [{caution.code for caution in one.warnings} for one in (loose, blind)]
    assert codes[0] <= {"camera-uncertainty-unknown"}
    assert "shade-fitted" in codes[1]
    assert loose.position_std_m[2] < blind.position_std_m[2]


def test_errors_of_any_size_leave_an_unknown_colour(streak, told):
    """Where the light was told as good as not at all, the fit of an unknown colour is its judge."""
    shot = streak().shot
    open_colour = measured(shot, Uniform())
    loose = measured(shot, replace(told, std=0.3))
    std = torch.tensor(open_colour.position_std_m)
    apart = torch.tensor(loose.position_m) - torch.tensor(open_colour.position_m)
    assert float((apart.abs() / std).max()) < 0.1
    ratio = torch.tensor(loose.position_std_m) / std
    assert torch.allclose(ratio, torch.ones(3), atol=0.05)


def test_amounts_are_those_by_which_the_light_was_off(streak, told):
    fit = streak(replace(told, is_known=True)).clean().fit()
    loose = told.loosened()
    light = joint_light(fit, loose, torch.zeros(3, dtype=torch.float64))
    expected = -torch.tensor(OFF).double() / told.std
    std = torch.linalg.inv(light.information)[-3:, -3:].diagonal().sqrt()
    # held about none by a prior of 1, so that they fall short where little is known
    assert torch.allclose(light.step, expected * (1 - std**2), atol=0.1)
    assert light.gain > 1
